//! The taxel scan: one timer, two DMA streams and the ADC, and no instruction per sample.
//!
//! ```text
//! TIM8 update ──> DMA2 stream 2 ──> GPIOE BSRR, address of the next taxel
//!      CC1 ─TRGO─> ADC1 converts one input per array ──> DMA1 stream 0 ──> ring of two frames in D2 SRAM
//!                                                        half, complete ──> interrupt: number, time, in step?
//! ```
//!
//! The timer starts a slot with an address and triggers the ADC when it has settled; order, addresses and times are in
//! [`slipsense::drivers::scan`]. While one half of the ring is read the other fills, for a whole frame.
//!
//! The interrupt asks whether the conversions still belong to the addresses and whether the ADC has lost any. If so,
//! or if no frame ends in time, the scan stops and starts again at the first taxel: one frame without counts.
//!
//! EXTSEL 7 is TIM8_TRGO on both chips: `LL_ADC_REG_TRIG_EXT_TIM8_TRGO` in ST's `stm32h7xx_ll_adc.h`, and RM0433's
//! table of external triggers of ADC1 and ADC2.

use core::sync::atomic::{AtomicU32, Ordering, compiler_fence};

use defmt::warn;
use embassy_stm32::adc::{Adc, AdcConfig, AnyAdcChannel, Resolution, RxDma};
use embassy_stm32::gpio::{AnyPin, Level, Output, Speed};
use embassy_stm32::interrupt;
use embassy_stm32::interrupt::{InterruptExt, Priority};
use embassy_stm32::pac::adc::vals::{Dmngt, Exten, Ovrmod, Pcsel, SampleTime};
use embassy_stm32::pac::dma::vals::{Dir, Dmdis, Pl, Size};
use embassy_stm32::pac::timer::vals::{Mms, OcmGp};
use embassy_stm32::timer::UpDma;
use embassy_stm32::timer::low_level::Timer;
use embassy_stm32::{Peri, pac, peripherals};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use embassy_time::{Duration, Instant, with_timeout};
use slipsense::board::TaxelScan;
use slipsense::drivers::scan::{
    ADDRESS_LINES, SlotTiming, address_table, address_word, frames_between, is_in_step,
};
use slipsense::firmware::clocks::{ADC_HZ, TIMER_HZ};
use slipsense::params::{FRAME_PERIOD_US, MAX_SENSORS, TAXELS};
use slipsense::pipeline::FrameStamp;

pub const TIMING: SlotTiming = SlotTiming::new(TIMER_HZ, ADC_HZ);
/// The address lines are the pins of port E from this one on.
const FIRST_PIN: u32 = 2;
const TIM8_TRGO: u8 = 7;
/// Longest wait for a frame.
const TIMEOUT: Duration = Duration::from_micros(2 * FRAME_PERIOD_US);
/// Reads of a register until what was switched off must be off: microseconds.
const SPINS: u32 = 10_000;

/// Reads of the streams until the inputs settle: more than a slot takes, each being some 100 ns.
const STEP_SPINS: u32 = 200;

/// Two frames of codes, as many arrays side by side as there are.
#[unsafe(link_section = ".sram_d2")]
static mut RING: [u16; 2 * TAXELS * MAX_SENSORS] = [0; 2 * TAXELS * MAX_SENSORS];
/// In RAM, so that a stalled flash cannot delay an address.
#[unsafe(link_section = ".sram_d2")]
static mut ADDRESSES: [u32; TAXELS] = [0; TAXELS];

/// What the interrupt says of a frame.
#[derive(Clone, Copy)]
struct Tick {
    time: Instant,
    /// The second half of the ring.
    second: bool,
    whole: bool,
    /// [`TICKS`] when it was sent.
    number: u32,
}

/// The last frame; one that nobody took is overwritten.
static TICK: Signal<CriticalSectionRawMutex, Tick> = Signal::new();
/// Frames that the interrupt has seen, wraps.
static TICKS: AtomicU32 = AtomicU32::new(0);
/// Arrays per slot, for the interrupt.
static ARRAYS: AtomicU32 = AtomicU32::new(1);

/// When the ADC is triggered, ticks after the address.
static TRIGGER_TICKS: AtomicU32 = AtomicU32::new(TIMING.trigger_ticks);

pub struct Hardware {
    pub timer: Peri<'static, peripherals::TIM8>,
    pub adc: Peri<'static, peripherals::ADC1>,
    /// From the ADC to the ring.
    pub codes_dma: Peri<'static, peripherals::DMA1_CH0>,
    /// From the table to the port.
    pub address_dma: Peri<'static, peripherals::DMA2_CH2>,
    /// Neighbouring pins of port E from PE2 on, lowest first.
    pub address: [Peri<'static, AnyPin>; ADDRESS_LINES as usize],
    /// Outputs of the arrays, in their order.
    pub arrays: [AnyAdcChannel<'static, peripherals::ADC1>; MAX_SENSORS],
}

pub struct AdcScan {
    arrays: usize,
    ring: *const u16,
    last: Tick,
    sequence: u32,
    failing: bool,
}

// SAFETY: the ring is a static that only DMA writes; where it lies is all that the pointer says.
unsafe impl Send for AdcScan {}

impl AdcScan {
    /// Set everything up and start. `arrays`: 1 to 3.
    pub fn start(hardware: Hardware, arrays: usize) -> Self {
        let (ring, addresses) = ((&raw const RING).cast(), &raw mut ADDRESSES);
        // SAFETY: nothing else uses the table, and this runs once: it takes the only timer.
        unsafe { addresses.write(address_table(FIRST_PIN)) };
        ARRAYS.store(arrays as u32, Ordering::Relaxed);
        for pin in hardware.address {
            // Never dropped: that would release the pin.
            core::mem::forget(Output::new(pin, Level::Low, Speed::High));
        }
        let codes_request = RxDma::<peripherals::ADC1>::request(&*hardware.codes_dma);
        let address_request = UpDma::<peripherals::TIM8>::request(&*hardware.address_dma);
        set_up_adc(hardware.adc, &hardware.arrays[..arrays]);
        set_up_timer(hardware.timer);

        pac::DMAMUX1.ccr(0).write(|w| w.set_dmareq_id(codes_request));
        let codes = pac::DMA1.st(0);
        codes.par().write_value(pac::ADC1.dr().as_ptr() as u32);
        codes.m0ar().write_value(ring as u32);
        // Stream 2 of DMA2 is channel 10 of the request multiplexer.
        pac::DMAMUX1.ccr(10).write(|w| w.set_dmareq_id(address_request));
        let address = pac::DMA2.st(2);
        address.par().write_value(pac::GPIOE.bsrr().as_ptr() as u32);
        address.m0ar().write_value(addresses as u32);

        let last = Tick { time: Instant::now(), second: false, whole: false, number: 0 };
        let scan = Self { arrays, ring, last, sequence: 0, failing: false };
        scan.begin();
        // Above the executor of acquisition, so that a tick has the time at which it happened.
        interrupt::DMA1_STREAM0.set_priority(Priority::P5);
        // SAFETY: the handler below is ready for it.
        unsafe { interrupt::DMA1_STREAM0.enable() };
        scan
    }

    /// From the first taxel on. Everything is set up and stands still.
    fn begin(&self) {
        // What was written for the DMA is there before it starts.
        cortex_m::asm::dmb();
        pac::GPIOE.bsrr().write_value(pac::gpio::regs::Bsrr(address_word(0, FIRST_PIN)));
        let address = pac::DMA2.st(2);
        pac::DMA2.ifcr(0).write(|w| clear(w, 2));
        address.ndtr().write(|w| w.set_ndt(TAXELS as u16));
        address.fcr().write(|w| w.set_dmdis(Dmdis::ENABLED));
        address.cr().write(|w| {
            w.set_dir(Dir::MEMORY_TO_PERIPHERAL);
            w.set_msize(Size::BITS32);
            w.set_psize(Size::BITS32);
            w.set_minc(true);
            w.set_circ(true);
            w.set_pl(Pl::VERY_HIGH);
            w.set_en(true);
        });
        let codes = pac::DMA1.st(0);
        pac::DMA1.ifcr(0).write(|w| clear(w, 0));
        codes.ndtr().write(|w| w.set_ndt((2 * TAXELS * self.arrays) as u16));
        codes.fcr().write(|w| w.set_dmdis(Dmdis::ENABLED));
        codes.cr().write(|w| {
            w.set_dir(Dir::PERIPHERAL_TO_MEMORY);
            w.set_msize(Size::BITS16);
            w.set_psize(Size::BITS16);
            w.set_minc(true);
            w.set_circ(true);
            w.set_pl(Pl::HIGH);
            w.set_htie(true);
            w.set_tcie(true);
            w.set_teie(true);
            w.set_en(true);
        });
        let adc = pac::ADC1;
        adc.isr().write(|w| {
            w.set_eoc(true);
            w.set_eos(true);
            w.set_ovr(true);
        });
        // Armed: the trigger starts it.
        adc.cr().modify(|w| w.set_adstart(true));
        let timer = pac::TIM8;
        // Resets the counter. The request of the address DMA is off, so that no address is skipped.
        timer.egr().write(|w| w.set_ug(true));
        timer.sr().write(|w| w.set_uif(false));
        timer.dier().write(|w| w.set_ude(true));
        timer.cr1().modify(|w| w.set_cen(true));
    }

    /// From now on trigger the ADC so many ticks after the address, at most those of [`TIMING`].
    #[allow(dead_code, reason = "the settling curve of the bring-up program")]
    pub fn trigger_at(&mut self, ticks: u32) {
        TRIGGER_TICKS.store(ticks.min(TIMING.trigger_ticks), Ordering::Relaxed);
        self.restart();
    }

    /// Stop, then [`begin`](Self::begin) again.
    fn restart(&self) {
        let timer = pac::TIM8;
        timer.cr1().modify(|w| w.set_cen(false));
        timer.dier().write(|w| w.set_ude(false));
        let adc = pac::ADC1;
        if adc.cr().read().adstart() {
            adc.cr().modify(|w| w.set_adstp(pac::adc::vals::Adstp::STOP));
        }
        let (codes, address) = (pac::DMA1.st(0).cr(), pac::DMA2.st(2).cr());
        codes.modify(|w| w.set_en(false));
        address.modify(|w| w.set_en(false));
        let stopped = || !adc.cr().read().adstart() && !codes.read().en() && !address.read().en();
        if !(0..SPINS).any(|_| stopped()) {
            warn!("the taxel scan does not stop");
        }
        TICK.reset();
        // While the ADC is not armed: a trigger that moves below the standing counter is an edge at once.
        pac::TIM8.ccr(0).write(|w| w.set_ccr(TRIGGER_TICKS.load(Ordering::Relaxed) as u16));
        self.begin();
    }
}

impl TaxelScan for AdcScan {
    async fn wait_before(&mut self, lead_us: u64) {
        let wait_us = FRAME_PERIOD_US.saturating_sub(lead_us);
        embassy_time::Timer::at(self.last.time + Duration::from_micros(wait_us)).await;
    }

    async fn tick(&mut self) -> FrameStamp {
        let before = self.last.time;
        let tick = with_timeout(TIMEOUT, TICK.wait()).await.ok();
        let stood = tick.is_none();
        self.last = tick.unwrap_or_else(|| Tick {
            time: Instant::now(),
            second: false,
            whole: false,
            number: TICKS.load(Ordering::Relaxed),
        });
        if self.last.whole {
            self.failing = false;
        } else {
            // Once per failure: a scan that never runs must not fill the log.
            if !core::mem::replace(&mut self.failing, true) {
                warn!("the taxel scan starts again: {=str}", if stood { "it stood" } else { "out of step" });
            }
            self.restart();
        }
        let elapsed_us = (self.last.time - before).as_micros();
        self.sequence = self.sequence.wrapping_add(frames_between(elapsed_us));
        FrameStamp { sequence: self.sequence, timestamp_us: self.last.time.as_micros() }
    }

    fn codes(&self) -> Option<&[u16]> {
        let frame = TAXELS * self.arrays;
        let from = if self.last.second { frame } else { 0 };
        // SAFETY: within the ring. DMA writes the other half for a frame from the tick on, and who reads for longer
        // finds out by `is_untouched`; any bits are a code.
        self.last.whole.then(|| unsafe { core::slice::from_raw_parts(self.ring.add(from), frame) })
    }

    fn is_untouched(&self) -> bool {
        // The codes were read before this is.
        compiler_fence(Ordering::SeqCst);
        TICKS.load(Ordering::Relaxed) == self.last.number
    }
}

/// A frame's conversions are complete.
///
/// # Safety
/// Called by the hardware only.
#[interrupt]
unsafe fn DMA1_STREAM0() {
    let time = Instant::now();
    let flags = pac::DMA1.isr(0).read();
    pac::DMA1.ifcr(0).write(|w| clear(w, 0));
    let (half, complete) = (flags.htif(0), flags.tcif(0));
    let lost = flags.teif(0) || pac::ADC1.isr().read().ovr();
    // Both, if nobody came for a whole frame.
    let whole = half != complete && !lost && in_step();
    let number = TICKS.load(Ordering::Relaxed).wrapping_add(1);
    TICKS.store(number, Ordering::Relaxed);
    TICK.signal(Tick { time, second: complete, whole, number });
}

/// Asked while the inputs settle, which they do at most half a slot, 2 µs, from now.
fn in_step() -> bool {
    let left = || (pac::DMA2.st(2).ndtr().read().ndt(), pac::DMA1.st(0).ndtr().read().ndt());
    for _ in 0..STEP_SPINS {
        let (words, codes) = left();
        let ticks = pac::TIM8.cnt().read().cnt().into();
        let triggered = ticks >= TRIGGER_TICKS.load(Ordering::Relaxed);
        // Still settling, so nothing moved since.
        if !triggered && TIMING.is_settling(ticks) && (words, codes) == left() {
            return is_in_step(words.into(), codes.into(), ARRAYS.load(Ordering::Relaxed));
        }
    }
    false
}

/// All flags of a stream.
fn clear(flags: &mut pac::dma::regs::Ixr, stream: usize) {
    flags.set_feif(stream, true);
    flags.set_dmeif(stream, true);
    flags.set_teif(stream, true);
    flags.set_htif(stream, true);
    flags.set_tcif(stream, true);
}

/// embassy switches it on and calibrates; triggers and circular DMA are not in its driver (0.6).
fn set_up_adc(adc: Peri<'static, peripherals::ADC1>, arrays: &[AnyAdcChannel<'static, peripherals::ADC1>]) {
    let config = AdcConfig { resolution: Some(Resolution::BITS16), averaging: None };
    // Never dropped: that might switch it off.
    core::mem::forget(Adc::new_with_config(adc, config));
    let adc = pac::ADC1;
    for (rank, array) in arrays.iter().enumerate() {
        let channel = usize::from(array.get_hw_channel());
        adc.pcsel().modify(|w| w.set_pcsel(channel, Pcsel::PRESELECTED));
        adc.smpr(channel / 10).modify(|w| w.set_smp(channel % 10, SampleTime::CYCLES8_5));
        adc.sqr1().modify(|w| w.set_sq(rank, channel as u8));
    }
    adc.sqr1().modify(|w| w.set_l(arrays.len() as u8 - 1));
    adc.cfgr().modify(|w| {
        w.set_cont(false);
        w.set_extsel(TIM8_TRGO);
        w.set_exten(Exten::RISING_EDGE);
        // A code that is not fetched stops the scan, and is seen, instead of being overwritten.
        w.set_ovrmod(Ovrmod::PRESERVE);
        w.set_dmngt(Dmngt::DMA_CIRCULAR);
    });
}

/// Slots; channel 1 rises at the trigger and is what TRGO shows.
fn set_up_timer(timer: Peri<'static, peripherals::TIM8>) {
    // Switches its clock on. Never dropped: that would switch it off.
    core::mem::forget(Timer::new(timer));
    let timer = pac::TIM8;
    timer.psc().write_value(0);
    timer.arr().write(|w| w.set_arr(TIMING.slot_ticks as u16 - 1));
    timer.ccr(0).write(|w| w.set_ccr(TIMING.trigger_ticks as u16));
    timer.ccmr_output(0).modify(|w| w.set_ocm(0, OcmGp::PWM_MODE2));
    timer.cr2().modify(|w| w.set_mms(Mms::COMPARE_OC1));
}
