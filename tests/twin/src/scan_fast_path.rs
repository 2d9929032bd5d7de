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

use rigless::device::{DeviceContext as Context, RegisterFile};
use rigless::soc::stm32h743::generated::dma1::Register as Dma;
use rigless::soc::stm32h743::generated::gpioa::Register as Port;
use rigless::soc::{Layout, Width};
use rigless::time::EventId;
use slipsense::params::TAXELS;

use crate::arrays::{Arrays, Shared, lock};
use crate::bus_tap::{FRAME_TOKEN, TABLE_TOKEN};
use crate::scan_timing::{CONVERSION_HALF_CYCLES, FIRST_PIN, FastScan, LINES, Scan, Settings};

const DMA1_LIFCR: u64 = 0x4002_0008;
const HTIF: [u64; 2] = [1 << 4, 1 << 20];
const TCIF: [u64; 2] = [1 << 5, 1 << 21];

/// The words of the address table, two at a time.
fn ask_for_table(table: u64, context: &mut Context<'_>) {
    for pair in 0..TAXELS as u64 / 2 {
        context.read_from(table + 8 * pair, Width::W64, TABLE_TOKEN + pair);
    }
}

/// TIM8 begins to count. `true`: here, and the emulator's model must not know.
pub fn start(shared: &Shared, context: &mut Context<'_>) -> bool {
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
pub fn frame_ended(shared: &Shared, event: EventId, context: &mut Context<'_>) -> bool {
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
pub fn answered(shared: &Shared, token: u64, value: u64, context: &mut Context<'_>) {
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
