//! The scan while nothing disturbs it, computed where somebody looks instead of event by event.
//!
//! A slot of the scan is half a dozen events of the emulator, 245,760 slots a second: nearly all the time that a run
//! takes. Once the firmware starts TIM8 with everything else set up, all that follows is known: at any instant the
//! counts of timer and streams, the address, the flags; and a frame's codes when its last conversion ends. The timer
//! of the emulator then never starts. Each virtual instant is the one that the emulator's models give (timer: rounded
//! up from cycles since its clock last changed; ADC: rounded down from half cycles since the trigger), so a run with
//! `--slow`, event by event, is the same to the nanosecond and the instruction, and the test command compares the two.
//!
//! What the firmware's set-up does not need is not here: such a set-up runs event by event, and a write to what runs
//! here is reported.

use rigless::device::{DeviceContext, RegisterFile};
use rigless::soc::stm32h743::generated::adc3::Register as Adc;
use rigless::soc::stm32h743::generated::dma1::Register as Dma;
use rigless::soc::stm32h743::generated::dmamux1::Register as Mux;
use rigless::soc::stm32h743::generated::gpioa::Register as Port;
use rigless::soc::stm32h743::generated::tim1::Register as Tim;
use rigless::soc::{Bus, Layout, Width};
use rigless::time::EventId;
use slipsense::params::TAXELS;

use crate::arrays::{
    Arrays, CHANNELS, CONVERSION_HALF_CYCLES, DEAD_NS, FIRST_PIN, LINES, LINES_MODER, OUTPUTS, SETTLED_NS,
    Shared, lock,
};

/// Answers to reads of the address table, the index of two words added, and to a frame's writes.
const TABLE_TOKEN: u64 = 1 << 32;
pub const FRAME_TOKEN: u64 = TABLE_TOKEN - 1;
const PORT_BSRR: u64 = 0x5802_1018;
const ADC1_DR: u64 = 0x4002_2040;
const DMA1_LIFCR: u64 = 0x4002_0008;
/// RM0433, DMAMUX1: ADC1 and TIM8_UP.
const ADC1_REQUEST: u64 = 9;
const TIM8_UP_REQUEST: u64 = 51;
/// RM0433, ADC sampling times by code, and conversion of 12 bits, half cycles of the ADC clock.
const SAMPLING_HALF_CYCLES: [u64; 8] = [3, 5, 17, 33, 65, 129, 775, 1621];
const HTIF: [u64; 2] = [1 << 4, 1 << 20];
const TCIF: [u64; 2] = [1 << 5, 1 << 21];
/// DMA_SxCR: what both streams need apart from EN and priority, and what it must be.
const STREAM_MASK: u64 = 0x01FC_FFE0;
const CODES_STREAM: u64 = 1 << 8 | 1 << 10 | 0b01 << 11 | 0b01 << 13;
const ADDRESS_STREAM: u64 = 0b01 << 6 | 1 << 8 | 1 << 10 | 0b10 << 11 | 0b10 << 13;

/// How TIM8, ADC1, the two streams, their requests and the port are set up.
#[derive(Clone, Debug)]
pub struct Settings {
    slot: u64,
    trigger: u64,
    /// Sensor of each rank of the sequence, and half cycles of one conversion.
    sequence: Vec<usize>,
    half_cycles: u64,
    ring: u64,
    table: u64,
}

impl Settings {
    /// As the registers stand; `None`: not a scan of this kind.
    pub fn read(bus: &Bus) -> Option<Self> {
        let [timer, adc] = ["TIM8", "ADC1"].map(|name| bus.registers(name));
        let [one, two] = ["DMA1", "DMA2"].map(|name| bus.registers(name));
        let (timer, adc, one, two) = (timer?, adc?, one?, two?);
        let (mux, port) = (bus.registers("DMAMUX1")?, bus.registers("GPIOE")?);
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
            // DMNGT: circular; OVRMOD: preserved; 12 bits.
            && adc.get(Adc::Cfgr) & (1 << 12 | 0b11) == 0b11
            && matches!(adc.get(Adc::Cfgr) >> 2 & 7, 0b010 | 0b110);
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
        (same
            && one.get(Dma::S0ndtr) == codes
            && settings.ring.is_multiple_of(8)
            && settings.table.is_multiple_of(8))
        .then_some(settings)
    }

    /// Codes of the ring.
    fn codes(&self) -> u64 {
        (2 * TAXELS * self.sequence.len()) as u64
    }

    /// Inputs have settled when they are sampled, and the ADC is ready for each trigger.
    fn is_sound(&self, timer_hz: u64, adc_hz: u64) -> bool {
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
#[derive(Debug)]
struct Scan {
    settings: Settings,
    /// Timer cycles since its clock last changed, at the start.
    start_cycle: u64,
    /// Words of the address table, one per slot.
    words: Vec<u32>,
    /// Frames that are in the ring.
    frames: u64,
    event: Option<EventId>,
    /// Flags that the next look at DMA1 finds.
    flags: u64,
    /// Updates and conversions at the last look at DMA2, or when the timer was stopped.
    looked: u64,
    stopped: Option<(u64, u64)>,
}

/// What the taps share of it.
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
    scan: Option<Scan>,
}

impl FastScan {
    /// Does the timer run here?
    pub fn runs(&self) -> bool {
        self.scan.as_ref().is_some_and(|scan| scan.stopped.is_none())
    }

    fn cycles(&self, now: u64) -> u64 {
        let (since, hz) = self.timer;
        (u128::from(now - since) * u128::from(hz) / 1_000_000_000) as u64
    }

    /// When the timer has made so many cycles since its clock changed.
    fn instant(&self, cycle: u64) -> u64 {
        let (since, hz) = self.timer;
        since + (u128::from(cycle) * 1_000_000_000).div_ceil(u128::from(hz)) as u64
    }

    /// From a trigger to the end of its `nth` conversion, from 1 on.
    fn converted_ns(&self, settings: &Settings, nth: u64) -> u64 {
        nth * settings.half_cycles * 1_000_000_000 / (2 * self.adc_hz)
    }

    /// The count of the timer, updates, conversions that have ended.
    fn counts(&self, scan: &Scan, now: u64) -> (u64, u64, u64) {
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
    fn frame_end(&self, scan: &Scan) -> u64 {
        let settings = &scan.settings;
        let last = (scan.frames + 1) * TAXELS as u64 - 1;
        let at = self.instant(scan.start_cycle + last * settings.slot + settings.trigger);
        at + self.converted_ns(settings, settings.sequence.len() as u64)
    }

    /// The address lines, from the second slot on.
    fn lines(scan: &Scan, updates: u64) -> Option<u64> {
        let last = updates.checked_sub(1)? as usize % TAXELS;
        scan.words.get(last).map(|word| u64::from(*word) & LINES)
    }
}

/// The words of the address table, two at a time.
fn ask_for_table(table: u64, context: &mut DeviceContext<'_>) {
    for pair in 0..TAXELS as u64 / 2 {
        context.read_from(table + 8 * pair, Width::W64, TABLE_TOKEN + pair);
    }
}

/// TIM8 begins to count. `true`: here, and the emulator's model must not know.
pub fn start(shared: &Shared, context: &mut DeviceContext<'_>) -> bool {
    let fast_scan = &mut lock(shared).fast_scan;
    let now = context.now().0;
    let fresh = std::mem::take(&mut fast_scan.fresh);
    let Some(settings) = fast_scan.settings.clone() else { return false };
    let sound = fast_scan.adc_hz > 0
        && fast_scan.timer.1 > 0
        && settings.is_sound(fast_scan.timer.1, fast_scan.adc_hz);
    if !fast_scan.enabled || !fresh || !fast_scan.armed || !sound {
        return false;
    }
    ask_for_table(settings.table, context);
    let mut scan = Scan {
        start_cycle: fast_scan.cycles(now),
        words: vec![0; TAXELS],
        frames: 0,
        event: None,
        flags: 0,
        looked: 0,
        stopped: None,
        settings,
    };
    scan.event = Some(context.schedule(rigless::time::VirtualNanos(fast_scan.frame_end(&scan))));
    fast_scan.scan = Some(scan);
    true
}

/// TIM8 stops: addresses are as they are now, the streams keep their counts until they are disabled.
pub fn stop(shared: &Shared, now: u64) {
    let mut arrays = lock(shared);
    let Some(scan) = arrays.fast_scan.scan.as_ref().filter(|scan| scan.stopped.is_none()) else { return };
    let (_, updates, conversions) = arrays.fast_scan.counts(scan, now);
    let (words, from) = (scan.words.clone(), scan.frames * TAXELS as u64);
    for slot in from.max(1)..=updates {
        arrays.addressed(address(words[(slot - 1) as usize % TAXELS]), now);
    }
    if let Some(scan) = &mut arrays.fast_scan.scan {
        scan.stopped = Some((updates, conversions));
        scan.event = None;
    }
}

/// After a reset of the part.
pub fn reset(shared: &Shared) {
    let fast_scan = &mut lock(shared).fast_scan;
    (fast_scan.scan, fast_scan.settings, fast_scan.fresh, fast_scan.armed) = (None, None, false, false);
}

/// TIM8's counter, while it runs here.
pub fn count(shared: &Shared, now: u64) -> Option<u64> {
    let fast_scan = &lock(shared).fast_scan;
    let scan = fast_scan.scan.as_ref().filter(|scan| scan.stopped.is_none())?;
    Some(fast_scan.counts(scan, now).0)
}

/// Before anybody looks at GPIOE.
pub fn show_port(shared: &Shared, registers: &mut RegisterFile, now: u64) {
    let fast_scan = &lock(shared).fast_scan;
    let Some(scan) = fast_scan.scan.as_ref() else { return };
    let (_, updates, _) = fast_scan.counts(scan, now);
    if let Some(lines) = FastScan::lines(scan, updates) {
        registers.set(Port::Odr, registers.get(Port::Odr) & !LINES | lines);
    }
}

/// Before anybody looks at DMA1 or DMA2.
pub fn show_stream(shared: &Shared, codes: bool, registers: &mut RegisterFile, now: u64) {
    let fast_scan = &mut lock(shared).fast_scan;
    let Some(scan) = fast_scan.scan.as_ref() else { return };
    let (_, updates, conversions) = fast_scan.counts(scan, now);
    let size = scan.settings.codes();
    let Some(scan) = fast_scan.scan.as_mut() else { return };
    if codes {
        registers.set(Dma::S0ndtr, size - conversions % size);
        registers.set(Dma::Lisr, registers.get(Dma::Lisr) | std::mem::take(&mut scan.flags));
        return;
    }
    let words = TAXELS as u64;
    registers.set(Dma::S2ndtr, words - updates % words);
    let passed = |offset: u64| (updates + offset) / words > (scan.looked + offset) / words;
    let half = if passed(words / 2) { HTIF[1] } else { 0 };
    let complete = if passed(0) { TCIF[1] } else { 0 };
    registers.set(Dma::Lisr, registers.get(Dma::Lisr) | half | complete);
    scan.looked = updates;
}

/// A stream that the firmware switched off: what it had left is history.
pub fn stream_written(shared: &Shared, codes: bool, registers: &RegisterFile) {
    let fast_scan = &mut lock(shared).fast_scan;
    let on = registers.get(if codes { Dma::S0cr } else { Dma::S2cr }) & 1 != 0;
    if !on && fast_scan.scan.as_ref().is_some_and(|scan| scan.stopped.is_some()) {
        fast_scan.scan = None;
    }
}

/// Is the register of a stream in use, or of the timer, so that a write to it cannot be honoured here?
pub fn is_in_use(shared: &Shared, codes: bool, row: usize) -> bool {
    let first = if codes { Dma::S0cr } else { Dma::S2cr }.index();
    (first..first + 6).contains(&row) && lock(shared).fast_scan.runs()
}

/// An event of TIM8: if the frame has ended, its codes go to the ring and DMA1 gets its flag.
pub fn frame_ended(shared: &Shared, event: EventId, context: &mut DeviceContext<'_>) -> bool {
    let mut arrays = lock(shared);
    let Some(scan) = arrays.fast_scan.scan.as_ref().filter(|scan| scan.event == Some(event)) else {
        return false;
    };
    let (settings, words, frame) = (scan.settings.clone(), scan.words.clone(), scan.frames);
    let start = scan.start_cycle;
    let codes = arrays.frame_of_codes(&settings, &words, start, frame);
    let bytes = 2 * codes.len() as u64;
    let base = settings.ring + frame % 2 * bytes;
    for (index, four) in codes.chunks_exact(4).enumerate() {
        let value = four.iter().rev().fold(0, |value, code| value << 16 | u64::from(*code));
        context.write_to(base + 8 * index as u64, Width::W64, value, FRAME_TOKEN);
    }
    // The table as it is for the next frame.
    ask_for_table(settings.table, context);
    context.write_to(DMA1_LIFCR, Width::W32, 0, FRAME_TOKEN);
    if let Some(scan) = &mut arrays.fast_scan.scan {
        scan.flags |= if frame % 2 == 0 { HTIF[0] } else { TCIF[0] };
        scan.frames += 1;
    }
    let fast_scan = &mut arrays.fast_scan;
    let next = fast_scan.scan.as_ref().map(|scan| fast_scan.frame_end(scan));
    if let (Some(at), Some(scan)) = (next, fast_scan.scan.as_mut()) {
        scan.event = Some(context.schedule(rigless::time::VirtualNanos(at)));
    }
    true
}

/// Two words of the table.
pub fn answered(shared: &Shared, token: u64, value: u64, context: &mut DeviceContext<'_>) {
    let fast_scan = &mut lock(shared).fast_scan;
    let (Some(scan), Some(pair)) = (fast_scan.scan.as_mut(), token.checked_sub(TABLE_TOKEN)) else { return };
    for (half, word) in [value as u32, (value >> 32) as u32].into_iter().enumerate() {
        let (set, clear) = (u64::from(word) & LINES, u64::from(word >> 16) & LINES);
        if set ^ clear != LINES || u64::from(word) & !(LINES | LINES << 16) != 0 {
            context
                .tell("ARR", "a word of the address table that does not set all lines and no other: --slow");
        }
        if let Some(slot) = scan.words.get_mut(2 * pair as usize + half) {
            *slot = word;
        }
    }
}

fn address(word: u32) -> usize {
    (u64::from(word) & LINES) as usize >> FIRST_PIN
}

impl Arrays {
    /// A frame's codes in the order of conversions; the addresses go on as the table has them.
    fn frame_of_codes(&mut self, settings: &Settings, words: &[u32], start: u64, frame: u64) -> Vec<u16> {
        let mut codes = Vec::with_capacity(TAXELS * settings.sequence.len());
        for slot in 0..TAXELS as u64 {
            let number = frame * TAXELS as u64 + slot;
            let begin = start + number * settings.slot;
            if number > 0 {
                let at = self.fast_scan.instant(begin);
                self.addressed(address(words[(number - 1) as usize % TAXELS]), at);
            }
            let trigger = self.fast_scan.instant(begin + settings.trigger);
            for (rank, sensor) in settings.sequence.iter().enumerate() {
                let end = trigger + self.fast_scan.converted_ns(settings, rank as u64 + 1);
                let conversion = CONVERSION_HALF_CYCLES * 500_000_000 / self.fast_scan.adc_hz;
                codes.push(self.code(*sensor, end - conversion) as u16);
            }
        }
        codes
    }
}
