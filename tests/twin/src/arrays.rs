//! The taxel arrays: an address on ten pins becomes a voltage at the ADC's inputs, and a timer's trigger starts the
//! ADC, which the emulator's model does not do.
//!
//! ```text
//! TIM8 TRGO ──> write to ADC1 that the bus carries ──> conversion (emulator's model, one sequence)
//! GPIOE ODR ──> address ──> settling ──> input at the end of sampling
//! ```

use std::sync::{Arc, Mutex, MutexGuard};

use rigless::device::{DeviceContext, ErasedDevice, Level, RegisterFile};
use rigless::soc::stm32h743::generated::adc3::Register as AdcRegister;
use rigless::soc::stm32h743::generated::gpioa::Register as PortRegister;
use rigless::soc::stm32h743::generated::tim1::Register;
use rigless::soc::stm32h743::peripherals::adc::{Adc, Channel};
use rigless::soc::stm32h743::peripherals::dma::Dma;
use rigless::soc::stm32h743::peripherals::gpio::Gpio;
use rigless::soc::stm32h743::peripherals::tim::{Advanced, Tim};
use rigless::soc::{Layout, Width};
use rigless::time::{EventId, VirtualNanos};
use slipsense::params::{MAX_SENSORS, TAXELS};
use slipsense_recording::Episode;

use crate::bus_tap::Tap;
use crate::fault_injection::{self, Fault, Kind};
use crate::scan_fast_path::{self, FastScan};

/// Inputs of ADC1 that the arrays are at: PA3, PC0, PB1 (`src/firmware/bin/app/pins.rs`).
pub const CHANNELS: [u8; MAX_SENSORS] = [15, 10, 5];
/// The address is on PE2 to PE11.
pub const FIRST_PIN: u32 = 2;
/// Their bits in ODR; in MODER, and what they are there as outputs.
pub const LINES: u64 = 0x3FF << FIRST_PIN;
pub const LINES_MODER: u64 = 0xF_FFFF << (2 * FIRST_PIN);
pub const OUTPUTS: u64 = 0x5555_5555;
/// ADC1_ISR, a write of 0 to which does nothing: the trigger line's way over the emulator's bus.
const ADC1_ISR: u64 = 0x4002_2000;
/// The answer to that write.
pub const TRIGGER_TOKEN: u64 = u64::MAX;
/// The emulator's ADC takes whole millivolts, coarser than a code: its reference is 4,095 V here, a code a volt, and
/// half a volt more so that rounding cannot lose one.
pub const REFERENCE_MV: u32 = 4_095_000;
/// Row driver and multiplexer switch: nothing changes before; then two time constants in a row, as one of their sum,
/// which is slower (`src/drivers/scan.rs`, `front_end`).
pub const DEAD_NS: u64 = 200;
const TAU_NS: f64 = 154.0;
/// From then on a full-scale step is within half a code: 9.02 time constants.
pub const SETTLED_NS: u64 = 1390;
/// RM0433, ADC timing: conversion of 12 bits after the end of sampling, ADC clock cycles, halves.
pub const CONVERSION_HALF_CYCLES: u64 = 13;

/// TIM_CR1 and TIM_EGR.
const CEN: u64 = 1 << 0;
const UG: u64 = 1 << 0;
/// ADC_CR and ADC_CFGR.
const ADSTART: u64 = 1 << 2;
const ADSTP: u64 = 1 << 4;
const EXTEN: u64 = 0b11 << 10;
const EXTEN_RISING: u64 = 0b01 << 10;
const EXTSEL: u64 = 0b11111 << 5;
/// External trigger 7 of the regular group is TIM8_TRGO.
const TIM8_TRGO: u64 = 7 << 5;

/// What the three taps share.
#[derive(Debug)]
pub struct Arrays {
    episode: Option<Arc<Episode>>,
    faults: Vec<Fault>,
    /// Address now and before, and since when.
    address: usize,
    before: usize,
    since_ns: u64,
    /// Frame of the episode that is scanned, and was at the address before.
    frame: usize,
    frame_before: usize,
    triggered: bool,
    /// The scan that needs no event per slot.
    pub fast_scan: FastScan,
    /// Triggers that came while a sequence was running.
    pub lost_triggers: u64,
    /// Conversions whose input had not settled to within half a code.
    pub unsettled: u64,
}

/// Shared among models.
pub type Shared = Arc<Mutex<Arrays>>;

impl Arrays {
    /// Arrays under the pressure of the episode; none without an episode.
    pub fn new(episode: Option<Arc<Episode>>, faults: Vec<Fault>) -> Shared {
        Arc::new(Mutex::new(Self {
            episode,
            faults,
            address: 0,
            before: 0,
            since_ns: 0,
            frame: 0,
            frame_before: 0,
            triggered: false,
            fast_scan: FastScan::default(),
            lost_triggers: 0,
            unsettled: 0,
        }))
    }

    fn count(&self, frame: usize, address: usize, sensor: usize) -> f64 {
        let Some(episode) = self.episode.as_ref().filter(|episode| sensor < episode.sensors) else {
            return 0.0;
        };
        // Over and over.
        f64::from(episode.piezo(frame % episode.frames(), sensor).counts()[address])
    }

    /// The last taxel's address gives way to the first's: the next frame of the episode.
    pub fn addressed(&mut self, address: usize, now_ns: u64) {
        if address == self.address {
            return;
        }
        (self.before, self.frame_before) = (self.address, self.frame);
        if self.address == TAXELS - 1 && address == 0 {
            self.frame += 1;
        }
        (self.address, self.since_ns) = (address, now_ns);
    }

    /// Code at the input of a sensor's array at an instant.
    pub fn code(&mut self, sensor: usize, at_ns: u64) -> u32 {
        if fault_injection::active(&self.faults, at_ns).any(|kind| kind == Kind::AdcStuck) {
            return 1234;
        }
        let old = self.count(self.frame_before, self.before, sensor);
        if at_ns < self.since_ns + DEAD_NS {
            return old as u32;
        }
        let new = self.count(self.frame, self.address, sensor);
        if at_ns > self.since_ns + DEAD_NS + SETTLED_NS {
            return new as u32;
        }
        let left = (-((at_ns - self.since_ns - DEAD_NS) as f64) / TAU_NS).exp();
        let value = new + (old - new) * left;
        if (value - new).abs() > 0.5 {
            self.unsettled += 1;
        }
        value.round() as u32
    }
}

/// The arrays.
pub fn lock(shared: &Shared) -> MutexGuard<'_, Arrays> {
    shared.lock().expect("no holder of the arrays panics")
}

/// On port E: the address.
#[derive(Debug)]
pub struct AddressLines(pub Shared);

impl Tap<Gpio> for AddressLines {
    fn show(&mut self, registers: &mut RegisterFile, now: VirtualNanos) {
        scan_fast_path::show_port(&self.0, registers, now.0);
    }

    /// A set/reset of address lines alone stays here: the emulator would tell every edge to thirty models that can
    /// listen to a pin, which takes longer than all the rest of a slot, and none of them listens to these.
    fn write(
        &mut self,
        port: &mut Gpio,
        row: usize,
        value: u64,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        let outputs = registers.get(PortRegister::Moder) & LINES_MODER == LINES_MODER & OUTPUTS;
        if row == PortRegister::Bsrr.index() && outputs && value & !(LINES | LINES << 16) == 0 {
            // BSRR: the low half sets, the high half clears, setting wins (RM0433, GPIO bit set/reset register).
            let lines = registers.get(PortRegister::Odr) & !(value >> 16) | value & 0xFFFF;
            registers.set(PortRegister::Odr, lines);
        } else {
            ErasedDevice::write(port, row, value, registers, context);
        }
    }

    fn after(&mut self, _: &mut Gpio, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        let lines = registers.get(PortRegister::Odr) >> FIRST_PIN;
        let mut arrays = lock(&self.0);
        if !arrays.fast_scan.runs() {
            arrays.addressed(lines as usize % TAXELS, context.now().0);
        }
    }
}

/// On TIM8: a rising TRGO.
#[derive(Debug)]
pub struct Trigger {
    pub shared: Shared,
    pub high: bool,
    pub pulses: u64,
}

impl Tap<Tim<Advanced>> for Trigger {
    fn read_instead(&mut self, row: usize, registers: &RegisterFile, now: VirtualNanos) -> Option<u64> {
        let count = scan_fast_path::count(&self.shared, now.0)?;
        let file = || Register::from_index(row).map_or(0, |register| registers.get(register));
        Some(if row == Register::Cnt.index() { count } else { file() })
    }

    fn write(
        &mut self,
        timer: &mut Tim<Advanced>,
        row: usize,
        value: u64,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        let runs = lock(&self.shared).fast_scan.runs();
        let starts = row == Register::Cr1.index() && value & CEN != 0;
        if !runs && starts && scan_fast_path::start(&self.shared, context) {
            return;
        }
        if runs && (starts || row != Register::Cr1.index()) {
            context.tell("CR1", "a write to the timer of a scan that runs: needs --slow");
        }
        if runs {
            scan_fast_path::stop(&self.shared, context.now().0);
        }
        if row == Register::Egr.index() {
            lock(&self.shared).fast_scan.fresh = value & UG != 0 && registers.get(Register::Cr1) & CEN == 0;
        }
        ErasedDevice::write(timer, row, value, registers, context);
    }

    fn event_instead(&mut self, event: EventId, context: &mut DeviceContext<'_>) -> bool {
        scan_fast_path::frame_ended(&self.shared, event, context)
    }

    fn answered(&mut self, token: u64, value: u64, context: &mut DeviceContext<'_>) {
        scan_fast_path::answered(&self.shared, token, value, context);
    }

    fn on_clock(&mut self, hz: u64, now: VirtualNanos) {
        lock(&self.shared).fast_scan.timer = (now.0, hz);
    }

    fn reset(&mut self) {
        scan_fast_path::reset(&self.shared);
    }

    fn after(&mut self, timer: &mut Tim<Advanced>, _: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        let (level, pulses) = timer.trigger_output();
        let high = level == Level::High;
        if high && !self.high || pulses != self.pulses {
            lock(&self.shared).triggered = true;
            context.write_to(ADC1_ISR, Width::W32, 0, TRIGGER_TOKEN);
        }
        (self.high, self.pulses) = (high, pulses);
    }
}

/// On ADC1: external triggers (RM0433, conversion on external trigger), and the inputs.
///
/// The emulator's model never sees EXTEN and EXTSEL, and ADSTART only when a trigger comes.
#[derive(Debug)]
pub struct TriggeredInputs {
    pub shared: Shared,
    clock_hz: u64,
    external: u64,
    armed: bool,
}

impl TriggeredInputs {
    /// No trigger selected.
    pub const fn new(shared: Shared) -> Self {
        Self { shared, clock_hz: 0, external: 0, armed: false }
    }

    fn start(&mut self, adc: &mut Adc, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        if registers.get(AdcRegister::Cr) & ADSTART != 0 {
            lock(&self.shared).lost_triggers += 1;
            context.tell("ADC_CR", "a trigger while the sequence before still runs is lost");
            return;
        }
        let value = registers.get(AdcRegister::Cr) | ADSTART;
        registers.set(AdcRegister::Cr, value);
        ErasedDevice::write(adc, AdcRegister::Cr.index(), value, registers, context);
    }
}

impl Tap<Adc> for TriggeredInputs {
    fn before(&mut self, adc: &mut Adc, now: VirtualNanos) {
        let conversion_ns = (CONVERSION_HALF_CYCLES * 500_000_000).checked_div(self.clock_hz).unwrap_or(0);
        let mut arrays = lock(&self.shared);
        for (sensor, channel) in CHANNELS.into_iter().enumerate() {
            let code = arrays.code(sensor, now.0.saturating_sub(conversion_ns));
            if let Some(channel) = Channel::new(channel) {
                adc.set_input(channel, code * 1000 + 500);
            }
        }
    }

    fn write(
        &mut self,
        adc: &mut Adc,
        row: usize,
        value: u64,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        let mut value = value;
        if row == AdcRegister::Cfgr.index() {
            self.external = value & (EXTEN | EXTSEL);
            value &= !(EXTEN | EXTSEL);
            registers.set(AdcRegister::Cfgr, value);
            if self.external & EXTEN != 0 && self.external & EXTSEL != TIM8_TRGO {
                context.tell("ADC_CFGR", "an external trigger that the twin has no line for");
            }
        } else if row == AdcRegister::Cr.index() && self.external & EXTEN != 0 {
            if value & ADSTP != 0 && self.armed {
                self.armed = false;
                if registers.get(AdcRegister::Cr) & ADSTART == 0 {
                    // Nothing runs that would have to be stopped.
                    value &= !ADSTP;
                }
            } else if value & ADSTART != 0 {
                self.armed = true;
            }
            value &= !ADSTART;
            registers
                .set(AdcRegister::Cr, registers.get(AdcRegister::Cr) & !(ADSTART | ADSTP) | value & ADSTP);
        }
        {
            let fast_scan = &mut lock(&self.shared).fast_scan;
            fast_scan.armed = self.armed && self.external == EXTEN_RISING | TIM8_TRGO;
            if fast_scan.runs() && row != AdcRegister::Isr.index() {
                context.tell("CR", "a write to the ADC of a scan that runs: needs --slow");
            }
        }
        ErasedDevice::write(adc, row, value, registers, context);
        let triggered = row == AdcRegister::Isr.index() && std::mem::take(&mut lock(&self.shared).triggered);
        if triggered && self.armed && self.external & EXTEN == EXTEN_RISING {
            self.start(adc, registers, context);
        }
    }

    fn read(&mut self, row: usize, value: Option<u64>, registers: &RegisterFile) -> Option<u64> {
        if row == AdcRegister::Cfgr.index() {
            return Some(value.unwrap_or_else(|| registers.get(AdcRegister::Cfgr)) | self.external);
        }
        if row == AdcRegister::Cr.index() && self.armed {
            return Some(value.unwrap_or_else(|| registers.get(AdcRegister::Cr)) | ADSTART);
        }
        value
    }

    fn on_clock(&mut self, hz: u64, _now: VirtualNanos) {
        self.clock_hz = hz;
        lock(&self.shared).fast_scan.adc_hz = hz;
    }

    fn reset(&mut self) {
        (self.external, self.armed) = (0, false);
    }
}

/// On DMA1 and DMA2: the two streams of the scan.
#[derive(Debug)]
pub struct Streams {
    pub shared: Shared,
    /// DMA1, whose stream 0 fetches the codes; else DMA2, whose stream 2 writes the addresses.
    pub codes: bool,
}

impl Tap<Dma> for Streams {
    fn show(&mut self, registers: &mut RegisterFile, now: VirtualNanos) {
        scan_fast_path::show_stream(&self.shared, self.codes, registers, now.0);
    }

    fn write(
        &mut self,
        dma: &mut Dma,
        row: usize,
        value: u64,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        if scan_fast_path::is_in_use(&self.shared, self.codes, row) {
            context.tell("CR", "a write to a stream of a scan that runs: needs --slow");
        }
        ErasedDevice::write(dma, row, value, registers, context);
        scan_fast_path::stream_written(&self.shared, self.codes, registers);
    }
}
