//! The board: an STM32H743 whose FDCANs and watchdog are ours, an 8 MHz clock from the ST-LINK, 3.3 V.

use std::num::{NonZeroU32, NonZeroU64};
use std::sync::Arc;

use rigless::device::{Device, ErasedDevice, Level, RegisterFile, ResetCause};
use rigless::machine::{Board, Target, armv7m};
use rigless::mcu::{Mcu, Operate};
use rigless::snapshot::Store;
use rigless::soc::stm32h743::Stm32h743;
use rigless::soc::stm32h743::generated::rcc::{Register, cr, rsr};
use rigless::soc::stm32h743::peripherals::adc::Adc;
use rigless::soc::stm32h743::peripherals::dma::Dma;
use rigless::soc::stm32h743::peripherals::gpio::{Gpio, Pin};
use rigless::soc::stm32h743::peripherals::rcc::IWDG_INSTANCE;
use rigless::soc::stm32h743::peripherals::spi::Select;
use rigless::soc::stm32h743::peripherals::tim::{Advanced, Tim};
use rigless::soc::{Bus, Error, Window};
use rigless::time::VirtualNanos;

use crate::adxl380::Adxl380;
use crate::array_taps::{AddressLines, Streams, Trigger, TriggeredInputs};
use crate::arrays::{Arrays, REFERENCE_MV, Shared};
use crate::bench::{self, DeskFault};
use crate::bus_tap::Tapped;
use crate::campaign::processor::{Handle, injected};
use crate::fdcan::Fdcan;
use crate::fdcan::message_ram::{self, MessageRam, RamWindow};
use crate::fitted::Fitted;
use crate::icm42688::Icm42688;
use crate::iwdg::Iwdg;
use crate::scan_timing::{PERIPHERALS, Settings};
use crate::shared::lock;
use crate::xl::{Readouts, Xl};

/// The core's clock that `clocks.rs` sets, and with one instruction per cycle its rate. A choice, not a
/// measurement: the silicon issues up to two, and waits for flash and buses.
pub const CORE_HZ: NonZeroU64 = NonZeroU64::new(480_000_000).expect("not zero");
/// HSE of the NUCLEO: the ST-LINK's MCO.
pub const HSE_HZ: u64 = 8_000_000;
const RAIL_MV: u32 = 3300;
const FDCANS: [&str; 2] = ["FDCAN1", "FDCAN2"];

/// Chip selects of the accelerometers on SPI1 (`src/firmware/bin/app/pins.rs`).
const CHIP_SELECTS: [(&str, u8); 3] = [("GPIOD", 14), ("GPIOD", 15), ("GPIOG", 12)];
const XL_SPI: usize = 0;
/// Peripherals that the firmware does not use. They have no model here, because the emulator would pass each DMA request
/// to all of them, which takes time. A run in which the firmware does use one names it and fails.
const UNUSED_PERIPHERALS: &str = "ADC3 ADC3_Common BDMA DMAMUX2 SPI2 SPI3 SPI4 SPI5 SPI6 TIM1 TIM3 TIM4 TIM5 TIM6 TIM7 \
                                  TIM12 TIM13 TIM14 TIM15 TIM16 TIM17";

/// What answers at a slot of the bus.
#[derive(Clone, Copy, Debug)]
enum Model {
    /// The emulator's own.
    Part,
    /// Nothing: one of [`UNUSED_PERIPHERALS`].
    Unused,
    Rcc,
    Fdcan(usize),
    MessageRam,
    Watchdog,
    Port,
    Timer,
    Adc,
    Stream(usize),
}

#[derive(Debug)]
pub struct Mcu743 {
    /// All but these.
    pub part: Stm32h743,
    pub fdcan: [Fdcan; 2],
    iwdg: Iwdg,
    ram: RamWindow,
    /// Models of the emulator with the arrays or the scan at them; what the part has in their place is never reached.
    port: Tapped<Gpio, AddressLines>,
    timer: Tapped<Tim<Advanced>, Trigger>,
    adc: Tapped<Adc, TriggeredInputs>,
    streams: [Tapped<Dma, Streams>; 2],
    /// Of [`PERIPHERALS`]; the first five are tapped.
    scan_slots: [usize; PERIPHERALS.len()],
    arrays: Shared,
    /// By slot.
    models: Vec<Model>,
    has_hse: bool,
    /// The next reset is a brown-out's.
    pub is_brown_out: bool,
}

impl Mcu743 {
    fn new(fitted: &Arc<Fitted>) -> Result<Self, Error> {
        let mut part = Stm32h743::new()?;
        let size = NonZeroU64::new(4 * message_ram::WORDS as u64).expect("not zero");
        let window = Window::new("FDCANRAM", message_ram::BASE, size);
        let ram_slot = part.bus_mut().add_window(window)?;
        let slot = |name| part.bus().slot(name).expect("the part has these peripherals");
        let scan_slots = PERIPHERALS.map(slot);
        let mut models = vec![Model::Part; part.bus().slots().len()];
        UNUSED_PERIPHERALS.split(' ').for_each(|name| models[slot(name)] = Model::Unused);
        let [port, timer, adc, codes, addresses, _] = scan_slots;
        for (slot, model) in [
            (slot("RCC"), Model::Rcc),
            (slot(FDCANS[0]), Model::Fdcan(0)),
            (slot(FDCANS[1]), Model::Fdcan(1)),
            (ram_slot, Model::MessageRam),
            (slot(IWDG_INSTANCE), Model::Watchdog),
            (port, Model::Port),
            (timer, Model::Timer),
            (adc, Model::Adc),
            (codes, Model::Stream(0)),
            (addresses, Model::Stream(1)),
        ] {
            models[slot] = model;
        }
        let table = part.bus().slots()[ram_slot].peripheral().registers;
        let ram = MessageRam::default();
        let fdcan = [Fdcan::new(ram.clone()), Fdcan::new(ram.clone())];
        let arrays = Arrays::new(fitted);
        // A second part, for its models of these: the emulator's own are fields that cannot be built from outside.
        let spare = Stm32h743::new()?;
        let [_, _, _, _, port, ..] = spare.gpio;
        let [_, timer] = spare.advanced;
        let [adc, ..] = spare.adc;
        let [codes, addresses] = spare.dma;
        let stream = |device, codes| Tapped { device, tap: Streams { shared: arrays.clone(), codes } };
        let mut mcu = Self {
            part,
            fdcan,
            iwdg: Iwdg::new(),
            ram: RamWindow { ram, table },
            port: Tapped { device: port, tap: AddressLines(arrays.clone()) },
            timer: Tapped { device: timer, tap: Trigger { shared: arrays.clone(), high: false, pulses: 0 } },
            adc: Tapped { device: adc, tap: TriggeredInputs::new(arrays.clone()) },
            streams: [stream(codes, true), stream(addresses, false)],
            scan_slots,
            arrays,
            models,
            has_hse: fitted.hse_hz != 0,
            is_brown_out: false,
        };
        mcu.adc.device.set_reference(REFERENCE_MV);
        mcu.show_fdcans();
        Ok(mcu)
    }

    /// Scans that began event by event, though nothing asked for it.
    pub fn scans_by_events(&self) -> usize {
        lock(&self.arrays).fast_scan.by_events
    }

    fn show_fdcans(&mut self) {
        for (fdcan, name) in self.fdcan.iter().zip(FDCANS) {
            fdcan.show(registers(&mut self.part, name));
        }
    }
}

/// What the registers of this peripheral hold.
pub fn registers<'a>(part: &'a mut Stm32h743, name: &'static str) -> &'a mut RegisterFile {
    let slot = part.bus().slot(name).expect("the part has these peripherals");
    part.bus_mut().slot_mut(slot).registers_mut()
}

impl Mcu for Mcu743 {
    fn bus(&self) -> &Bus {
        self.part.bus()
    }

    fn bus_mut(&mut self) -> &mut Bus {
        self.part.bus_mut()
    }

    fn reset(&mut self, at: VirtualNanos, cause: ResetCause) {
        self.part.reset(at, cause);
        if std::mem::take(&mut self.is_brown_out) {
            // The emulator has no brown-out. Its flag joins those of the pin, which every reset pulls, and of the core;
            // those that stood are gone with the supply (RM0433, table of reset sources against flags).
            let flags = rsr::BORRSTF.mask() | rsr::PINRSTF.mask() | rsr::CPURSTF.mask();
            let rcc = registers(&mut self.part, "RCC");
            for register in [Register::Rsr, Register::C1Rsr] {
                rcc.set(register, flags);
            }
        }
        for fdcan in &mut self.fdcan {
            Device::reset(fdcan);
        }
        self.iwdg = Iwdg::new();
        ErasedDevice::reset(&mut self.port);
        ErasedDevice::reset(&mut self.timer);
        ErasedDevice::reset(&mut self.adc);
        self.streams.iter_mut().for_each(ErasedDevice::reset);
        self.show_fdcans();
    }

    fn poll(&mut self, _now: VirtualNanos) {
        // Only serial ports look outside when polled, and nothing is at ours. Asking every model at every event would
        // take a third of the time.
    }

    fn split(&mut self, slot: usize) -> (&mut Bus, Option<&mut dyn ErasedDevice>) {
        let device: &mut dyn ErasedDevice = match self.models[slot] {
            Model::Part => return self.part.split(slot),
            Model::Unused => return (self.part.bus_mut(), None),
            Model::Rcc => {
                if !self.has_hse {
                    // In the emulator an oscillator without a crystal is ready at 0 Hz. On the part HSERDY says that the
                    // clock is there and steady (RM0433, RCC_CR), and without one never comes.
                    registers(&mut self.part, "RCC").restore(Register::Cr, cr::HSERDY.mask(), 0);
                }
                return self.part.split(slot);
            }
            Model::Fdcan(nth) => &mut self.fdcan[nth],
            Model::MessageRam => &mut self.ram,
            Model::Watchdog => &mut self.iwdg,
            Model::Port => &mut self.port,
            Model::Timer => {
                let fast_scan = &mut lock(&self.arrays).fast_scan;
                if fast_scan.enabled && !fast_scan.runs() {
                    fast_scan.settings = Settings::read(self.part.bus(), &self.scan_slots);
                }
                &mut self.timer
            }
            Model::Adc => &mut self.adc,
            Model::Stream(nth) => &mut self.streams[nth],
        };
        (self.part.bus_mut(), Some(device))
    }
}

#[derive(Debug)]
pub struct Twin {
    pub mcu: Mcu743,
    pub readouts: [Readouts; CHIP_SELECTS.len()],
    slow: bool,
    pub injection: Option<Handle>,
}

/// Name of the machine and of its one target.
pub const NAME: &str = "slipsense-h743";

impl Twin {
    pub fn new(fitted: &Arc<Fitted>) -> Result<Self, Error> {
        let mut mcu = Mcu743::new(fitted)?;
        let hse_hz = match fitted.desk.and_then(|desk| desk.fault) {
            Some(DeskFault::HseAbsent) => 0,
            Some(DeskFault::HseOff) => bench::OFF_HZ,
            Some(DeskFault::HseWrong) => bench::WRONG_HZ,
            _ => fitted.hse_hz,
        };
        mcu.part.rcc.attach_crystals(hse_hz, 0);
        mcu.part.set_supply(RAIL_MV);
        mcu.part.set_analog_supply(RAIL_MV);
        for converter in &mut mcu.part.adc {
            converter.set_reference(RAIL_MV);
        }
        mcu.fdcan[0].wire.faults = fitted.faults.clone();
        mcu.fdcan[0].wire.has_transceiver = !bench::has(fitted.desk, DeskFault::NoTransceiver);
        let sensors = fitted.episode.as_ref().map_or(0, |episode| episode.sensors);
        let sensors = fitted.desk.map_or(sensors, |desk| desk.sensors);
        let readouts: [Readouts; CHIP_SELECTS.len()] = Default::default();
        for (sensor, (port, pin)) in CHIP_SELECTS.into_iter().enumerate().take(sensors) {
            let pin = Pin::new(pin).expect("a port has sixteen pins");
            let select = Select { port, pin, active: Level::Low };
            let (spi, readouts) = (&mut mcu.part.spi[XL_SPI], readouts[sensor].clone());
            match fitted.xl {
                Xl::Adxl380 => spi.attach_selected(Adxl380::new(fitted, sensor, readouts), select),
                Xl::Icm42688 => {
                    let part = Icm42688::new(fitted.episode.clone(), sensor, readouts);
                    spi.attach_selected(part, select);
                }
            }
        }
        Ok(Self { mcu, readouts, slow: fitted.slow, injection: None })
    }
}

impl Store for Twin {}

impl Board for Twin {
    fn name(&self) -> &'static str {
        NAME
    }

    fn target_names(&self) -> Vec<&'static str> {
        vec![NAME]
    }

    fn mcu(&mut self, target: usize) -> Option<&mut dyn Mcu> {
        (target == 0).then_some(&mut self.mcu)
    }

    fn targets(&mut self) -> Vec<Target<'_>> {
        let mut core = core(&self.mcu, self.slow).spec();
        if let Some(injection) = &self.injection {
            core = injected(core, injection);
        }
        vec![Target::new(NAME, &mut self.mcu, core)]
    }
}

/// The Cortex-M7 as the emulator's own bench of this part has it, at our rate: r1p1, double-precision FPU, 16 MPU
/// regions, 16 KB caches, vector table at the start of flash.
///
/// With the MPU on, the emulator checks each access to memory that only the default map grants, one by one: a third of
/// the time that a run takes. So there is one with `slow` only. All that the firmware's regions refuse is address
/// space without memory, which is reported as unmapped; the caches that they are for are not modelled.
fn core(mcu: &Mcu743, slow: bool) -> armv7m::Config {
    let lines = u32::from(Operate::cpu(mcu).interrupt_lines);
    let core = armv7m::Core {
        variant: armv7m::Variant::M7,
        clock_hz: CORE_HZ,
        interrupt_lines: NonZeroU32::new(lines).expect("the part has interrupts"),
        priority_bits: 4,
        refclk_divider: NonZeroU32::new(8).expect("not zero"),
        instructions_per_second: CORE_HZ,
        boot: "flash",
    };
    let mut config = armv7m::Config::new(core, &rigless::cpu::armv7m::windows(Mcu::bus(mcu)));
    config.fpu = armv7m::Fpu::FpV5Dp;
    config.mpu_regions = if slow { armv7m::MpuRegions::Sixteen } else { armv7m::MpuRegions::None };
    config.cpuid = 0x411F_C271;
    config.caches =
        Some(armv7m::Caches { clidr: 0x0900_0003, ctr: 0x8303_C003, ccsidr: &[0xF00F_E019, 0xF01F_E009] });
    config.branch_prediction = armv7m::BranchPrediction::Always;
    config.vector_table = Some(0x0800_0000);
    config
}
