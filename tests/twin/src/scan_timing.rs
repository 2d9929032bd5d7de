//! When each step of an undisturbed scan happens: how the registers set it up, and the instants that follow from it.

use rigless::soc::Bus;
use rigless::soc::stm32h743::generated::adc3::Register as Adc;
use rigless::soc::stm32h743::generated::dma1::Register as Dma;
use rigless::soc::stm32h743::generated::dmamux1::Register as Mux;
use rigless::soc::stm32h743::generated::gpioa::Register as Port;
use rigless::soc::stm32h743::generated::tim1::Register as Tim;
use rigless::time::EventId;
use slipsense::params::{MAX_SENSORS, TAXELS};

/// Inputs of ADC1 that the arrays are at: PA3, PC0, PB1 (`src/firmware/bin/app/pins.rs`).
pub const CHANNELS: [u8; MAX_SENSORS] = [15, 10, 5];
/// The address is on PE2 to PE11.
pub const FIRST_PIN: u32 = 2;
/// Their bits in ODR; in MODER, and what they are there as outputs.
pub const LINES: u64 = 0x3FF << FIRST_PIN;
pub const LINES_MODER: u64 = 0xF_FFFF << (2 * FIRST_PIN);
pub const OUTPUTS: u64 = 0x5555_5555;
/// The multiplexer switches: nothing changes before; then one exponential, as slow as the slowest transition of the
/// circuit (`src/drivers/scan.rs`, `ANALOG_NS`).
pub const DEAD_NS: u64 = 45;
/// From then on a full-scale step is within half a count of 4096: 9.02 time constants.
pub const SETTLED_NS: u64 = 1705;
/// RM0433, ADC timing: conversion of 16 bits after the end of sampling, ADC clock cycles, halves.
const CONVERSION_HALF_CYCLES: u64 = 17;
const PORT_BSRR: u64 = 0x5802_1018;
const ADC1_DR: u64 = 0x4002_2040;
/// RM0433, DMAMUX1: ADC1 and TIM8_UP.
const ADC1_REQUEST: u64 = 9;
const TIM8_UP_REQUEST: u64 = 51;
/// RM0433, ADC sampling times by code, half cycles of the ADC clock.
const SAMPLING_HALF_CYCLES: [u64; 8] = [3, 5, 17, 33, 65, 129, 775, 1621];
/// DMA_SxCR: what both streams need apart from EN and priority, and what it must be.
const STREAM_MASK: u64 = 0x01FC_FFE0;
const CODES_STREAM: u64 = 1 << 8 | 1 << 10 | 0b01 << 11 | 0b01 << 13;
const ADDRESS_STREAM: u64 = 0b01 << 6 | 1 << 8 | 1 << 10 | 0b10 << 11 | 0b10 << 13;

/// How TIM8, ADC1, the two streams, their requests and the port are set up.
#[derive(Clone, Debug, Default)]
pub struct Settings {
    pub(crate) slot: u64,
    pub(crate) trigger: u64,
    /// Sensor of each rank of the sequence, and half cycles of one conversion.
    pub(crate) sequence: Vec<usize>,
    pub(crate) half_cycles: u64,
    pub(crate) ring: u64,
    pub(crate) table: u64,
}

pub const PERIPHERALS: [&str; 6] = ["GPIOE", "TIM8", "ADC1", "DMA1", "DMA2", "DMAMUX1"];

impl Settings {
    /// As the registers of [`PERIPHERALS`] stand, which are in these slots; `None`: not a scan of this kind.
    pub fn read(bus: &Bus, slots: &[usize; PERIPHERALS.len()]) -> Option<Self> {
        let [port, timer, adc, one, two, mux] = slots.map(|slot| bus.slots()[slot].registers());
        let whole = timer.get(Tim::Dier) == 1 << 8
            && timer.get(Tim::Cr2) == 0b100 << 4
            && timer.get(Tim::Psc) == 0
            && timer.get(Tim::Rcr) == 0
            && timer.get(Tim::Smcr) == 0
            && timer.get(Tim::Ccmr1Output) & 0x0001_007F == 0b111 << 4
            && mux.get(Mux::DmamuxC0cr) == ADC1_REQUEST
            && mux.get(Mux::DmamuxC10cr) == TIM8_UP_REQUEST
            && port.get(Port::Moder) & LINES_MODER == LINES_MODER & OUTPUTS
            && one.get(Dma::S0cr) & (STREAM_MASK & !0x18 | 1) == CODES_STREAM | 1
            && two.get(Dma::S2cr) & (STREAM_MASK | 0x1E | 1) == ADDRESS_STREAM | 1
            && one.get(Dma::S0par) == ADC1_DR
            && two.get(Dma::S2par) == PORT_BSRR
            && two.get(Dma::S2ndtr) == TAXELS as u64
            // DMNGT: circular; OVRMOD: preserved; 16 bits.
            && adc.get(Adc::Cfgr) & (1 << 12 | 0b11) == 0b11
            && adc.get(Adc::Cfgr) >> 2 & 7 == 0;
        if !whole {
            return None;
        }
        let sqr = adc.get(Adc::Sqr1);
        let channels: Vec<u8> =
            (0..(sqr & 0xF) + 1).map(|rank| (sqr >> (6 + 6 * rank) & 0x1F) as u8).collect();
        let sequence = channels.iter().map(|channel| CHANNELS.iter().position(|known| known == channel));
        let sequence: Vec<usize> = sequence.collect::<Option<_>>()?;
        let code = |&channel: &u8| match channel {
            0..10 => adc.get(Adc::Smpr1) >> (3 * channel) & 7,
            _ => adc.get(Adc::Smpr2) >> (3 * (channel - 10)) & 7,
        };
        let sampling = code(channels.first()?);
        let settings = Self {
            slot: timer.get(Tim::Arr) + 1,
            trigger: timer.get(Tim::Ccr1),
            half_cycles: SAMPLING_HALF_CYCLES[sampling as usize] + CONVERSION_HALF_CYCLES,
            ring: one.get(Dma::S0m0ar),
            table: two.get(Dma::S2m0ar),
            sequence,
        };
        let codes = settings.codes();
        let same = channels.iter().all(|channel| code(channel) == sampling);
        (same && one.get(Dma::S0ndtr) == codes).then_some(settings)
    }

    /// Codes of the ring.
    pub(crate) fn codes(&self) -> u64 {
        (2 * TAXELS * self.sequence.len()) as u64
    }

    /// Inputs have settled when they are sampled, and the ADC is ready for each trigger.
    pub(crate) fn is_sound(&self, timer_hz: u64, adc_hz: u64) -> bool {
        let ns = |cycles: u64, hz: u64| cycles * 1_000_000_000 / hz;
        let sampling = ns(self.half_cycles - CONVERSION_HALF_CYCLES, 2 * adc_hz);
        let all = ns(self.half_cycles * self.sequence.len() as u64, 2 * adc_hz);
        let sampled = ns(self.trigger, timer_hz) + all - ns(CONVERSION_HALF_CYCLES, 2 * adc_hz);
        ns(self.trigger, timer_hz) + sampling > DEAD_NS + SETTLED_NS + 20
            && sampled < ns(self.slot, timer_hz)
            && all < ns(self.slot, timer_hz)
            && self.trigger < self.slot
    }
}

/// A scan that runs, or that ran and whose streams still stand as it left them.
#[derive(Debug, Default)]
pub struct Scan {
    pub(crate) settings: Settings,
    /// Timer cycles since its clock last changed, at the start.
    pub(crate) start_cycle: u64,
    /// Words of the address table, one per slot.
    pub(crate) words: Vec<u32>,
    /// Frames that are in the ring.
    pub(crate) frames: u64,
    pub(crate) event: Option<EventId>,
    /// Flags that the next look at DMA1 finds.
    pub(crate) flags: u64,
    /// Updates and conversions at the last look at DMA2, or when the timer was stopped.
    pub(crate) looked: u64,
    pub(crate) stopped: Option<(u64, u64)>,
}

impl Scan {
    /// The address lines, from the second slot on.
    pub(crate) fn lines(&self, updates: u64) -> Option<u64> {
        let last = updates.checked_sub(1)? as usize % TAXELS;
        self.words.get(last).map(|word| u64::from(*word) & LINES)
    }
}

#[derive(Debug, Default)]
pub struct FastScan {
    /// Not with `--slow`.
    pub enabled: bool,
    /// Of the registers at the last access to TIM8.
    pub settings: Option<Settings>,
    /// When the timer's clock last changed, and its rate.
    pub timer: (u64, u64),
    pub adc_hz: u64,
    /// ADC1 waits for TIM8's trigger.
    pub armed: bool,
    /// The timer was set to zero and has not run since.
    pub fresh: bool,
    /// Scans that began event by event, though `enabled`.
    pub by_events: usize,
    pub(crate) scan: Option<Scan>,
}

impl FastScan {
    pub fn runs(&self) -> bool {
        self.scan.as_ref().is_some_and(|scan| scan.stopped.is_none())
    }

    pub(crate) fn cycles(&self, now: u64) -> u64 {
        let (since, hz) = self.timer;
        (u128::from(now - since) * u128::from(hz) / 1_000_000_000) as u64
    }

    /// When the timer reaches this number of cycles since its clock changed.
    pub(crate) fn instant(&self, cycle: u64) -> u64 {
        let (since, hz) = self.timer;
        since + (u128::from(cycle) * 1_000_000_000).div_ceil(u128::from(hz)) as u64
    }

    /// From the end of sampling to the end of a conversion; 0 while the ADC has no clock.
    pub(crate) fn conversion_ns(&self) -> u64 {
        (CONVERSION_HALF_CYCLES * 500_000_000).checked_div(self.adc_hz).unwrap_or(0)
    }

    /// From a trigger to the end of its `nth` conversion, from 1 on.
    pub(crate) fn converted_ns(&self, settings: &Settings, nth: u64) -> u64 {
        nth * settings.half_cycles * 1_000_000_000 / (2 * self.adc_hz)
    }

    /// The count of the timer, updates, conversions that have ended.
    pub(crate) fn counts(&self, scan: &Scan, now: u64) -> (u64, u64, u64) {
        let settings = &scan.settings;
        let ticks = self.cycles(now) - scan.start_cycle;
        let (updates, count) = (ticks / settings.slot, ticks % settings.slot);
        if let Some((updates, conversions)) = scan.stopped {
            return (0, updates, conversions);
        }
        let triggers = (ticks + settings.slot - settings.trigger) / settings.slot;
        let length = settings.sequence.len() as u64;
        let conversions = triggers.checked_sub(1).map_or(0, |last| {
            let at = self.instant(scan.start_cycle + last * settings.slot + settings.trigger);
            let done =
                (1..=length).take_while(|nth| at + self.converted_ns(settings, *nth) <= now).count() as u64;
            last * length + done
        });
        (count, updates, conversions)
    }

    /// End of the last conversion of the frame that fills.
    pub(crate) fn frame_end(&self, scan: &Scan) -> u64 {
        let settings = &scan.settings;
        let last = (scan.frames + 1) * TAXELS as u64 - 1;
        let at = self.instant(scan.start_cycle + last * settings.slot + settings.trigger);
        at + self.converted_ns(settings, settings.sequence.len() as u64)
    }
}
