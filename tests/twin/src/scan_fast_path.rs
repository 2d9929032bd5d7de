//! The scan while nothing disturbs it, computed where somebody looks instead of event by event.
//!
//! A slot of the scan is half a dozen events of the emulator, 245,760 slots a second: nearly all the time that a run
//! takes. Once the firmware starts TIM8 with everything else set up, all that follows is known: at any instant the
//! counts of timer and streams, the address, the flags; and a frame's codes when its last conversion ends. The timer
//! of the emulator then never starts. Each virtual instant is the one that the emulator's models give (timer: rounded
//! up from cycles since its clock last changed; ADC: rounded down from half cycles since the trigger), so a run with
//! `--slow`, event by event, is the same to the nanosecond and the instruction, and the test command compares the two.
//!
//! What the firmware's set-up does not need is not here: such a set-up runs event by event, which fails a run of the
//! firmware, and a write to what runs here is reported.

use rigless::device::{DeviceContext as Context, RegisterFile};
use rigless::soc::stm32h743::generated::dma1::Register as Dma;
use rigless::soc::stm32h743::generated::gpioa::Register as Port;
use rigless::soc::{Layout, Width};
use rigless::time::{EventId, VirtualNanos};
use slipsense::params::TAXELS;

use crate::arrays::Arrays;
use crate::bus_tap::{FRAME_TOKEN, TABLE_TOKEN};
use crate::scan_timing::{FIRST_PIN, FastScan, LINES, Scan};

const DMA1_LIFCR: u64 = 0x4002_0008;
const HTIF: [u64; 2] = [1 << 4, 1 << 20];
const TCIF: [u64; 2] = [1 << 5, 1 << 21];

/// The widest aligned access at this offset, of so many bytes in all. Ring and table lie at multiples of two and four
/// bytes, wherever the linker puts them.
fn widest(base: u64, offset: u64, bytes: u64) -> Option<Width> {
    [Width::W64, Width::W32, Width::W16].into_iter().find(|width| {
        let width = u64::from(width.bytes());
        (base + offset).is_multiple_of(width) && offset + width <= bytes
    })
}

/// Those accesses one after the other, with their offsets.
fn accesses(base: u64, bytes: u64) -> impl Iterator<Item = (u64, Width)> {
    let mut offset = 0;
    std::iter::from_fn(move || {
        let (from, width) = (offset, widest(base, offset, bytes)?);
        offset += u64::from(width.bytes());
        Some((from, width))
    })
}

fn ask_for_table(table: u64, context: &mut Context<'_>) {
    for (offset, width) in accesses(table, 4 * TAXELS as u64) {
        context.read_from(table + offset, width, TABLE_TOKEN + offset / 4);
    }
}

impl FastScan {
    /// TIM8 begins to count. `true`: here, and the emulator's model must not know.
    pub fn start(&mut self, context: &mut Context<'_>) -> bool {
        let fresh = std::mem::take(&mut self.fresh);
        let Some(settings) = self.settings.clone() else { return false };
        let sound = self.adc_hz > 0 && self.timer.1 > 0 && settings.is_sound(self.timer.1, self.adc_hz);
        if !self.enabled || !fresh || !self.armed || !sound {
            return false;
        }
        ask_for_table(settings.table, context);
        let start_cycle = self.cycles(context.now().0);
        let mut scan = Scan { settings, start_cycle, words: vec![0; TAXELS], ..Scan::default() };
        scan.event = Some(context.schedule(VirtualNanos(self.frame_end(&scan))));
        self.scan = Some(scan);
        true
    }

    pub fn reset(&mut self) {
        (self.scan, self.settings, self.fresh, self.armed) = (None, None, false, false);
    }

    /// TIM8's counter, while it runs here.
    pub fn count(&self, now: u64) -> Option<u64> {
        let scan = self.scan.as_ref().filter(|scan| scan.stopped.is_none())?;
        Some(self.counts(scan, now).0)
    }

    /// Before anybody looks at GPIOE.
    pub fn show_port(&self, registers: &mut RegisterFile, now: u64) {
        let Some(scan) = self.scan.as_ref() else { return };
        let (_, updates, _) = self.counts(scan, now);
        if let Some(lines) = scan.lines(updates) {
            registers.set(Port::Odr, registers.get(Port::Odr) & !LINES | lines);
        }
    }

    /// Before anybody looks at DMA1 or DMA2.
    pub fn show_stream(&mut self, codes: bool, registers: &mut RegisterFile, now: u64) {
        let Some(mut scan) = self.scan.take() else { return };
        let (_, updates, conversions) = self.counts(&scan, now);
        let flags = if codes {
            let size = scan.settings.codes();
            registers.set(Dma::S0ndtr, size - conversions % size);
            std::mem::take(&mut scan.flags)
        } else {
            let words = TAXELS as u64;
            registers.set(Dma::S2ndtr, words - updates % words);
            let passed = |offset: u64| (updates + offset) / words > (scan.looked + offset) / words;
            let half = if passed(words / 2) { HTIF[1] } else { 0 };
            let complete = if passed(0) { TCIF[1] } else { 0 };
            scan.looked = updates;
            half | complete
        };
        registers.set(Dma::Lisr, registers.get(Dma::Lisr) | flags);
        self.scan = Some(scan);
    }

    /// A stream that the firmware switched off: what it had left is history.
    pub fn stream_written(&mut self, codes: bool, registers: &RegisterFile) {
        let on = registers.get(if codes { Dma::S0cr } else { Dma::S2cr }) & 1 != 0;
        self.scan.take_if(|scan| !on && scan.stopped.is_some());
    }

    /// Is the register of a stream in use, so that a write to it cannot be honoured here?
    pub fn is_in_use(&self, codes: bool, row: usize) -> bool {
        let first = if codes { Dma::S0cr } else { Dma::S2cr }.index();
        (first..first + 6).contains(&row) && self.runs()
    }

    /// A word of the table, or two.
    pub fn answered(&mut self, token: u64, value: u64, context: &mut Context<'_>) {
        let (Some(scan), Some(first)) = (self.scan.as_mut(), token.checked_sub(TABLE_TOKEN)) else { return };
        let width = widest(scan.settings.table, 4 * first, 4 * TAXELS as u64);
        let words = width.map_or(0, Width::bytes) as usize / 4;
        for (index, word) in [value as u32, (value >> 32) as u32].into_iter().take(words).enumerate() {
            let (set, clear) = (u64::from(word) & LINES, u64::from(word >> 16) & LINES);
            if set ^ clear != LINES || u64::from(word) & !(LINES | LINES << 16) != 0 {
                context.tell(
                    "ARR",
                    "a word of the address table that does not set all lines and no other: --slow",
                );
            }
            if let Some(slot) = scan.words.get_mut(first as usize + index) {
                *slot = word;
            }
        }
    }
}

impl Arrays {
    /// TIM8 stops: addresses are as they are now, the streams keep their counts until they are disabled.
    pub fn stop_scan(&mut self, now: u64) {
        let Some(mut scan) = self.fast_scan.scan.take_if(|scan| scan.stopped.is_none()) else { return };
        let (_, updates, conversions) = self.fast_scan.counts(&scan, now);
        for slot in scan.frames * TAXELS as u64..=updates {
            self.scan_addressed(&scan, slot, now);
        }
        (scan.stopped, scan.event) = (Some((updates, conversions)), None);
        self.fast_scan.scan = Some(scan);
    }

    /// An event of TIM8: if the frame has ended, its codes go to the ring and DMA1 gets its flag.
    pub fn frame_ended(&mut self, event: EventId, context: &mut Context<'_>) -> bool {
        let Some(mut scan) = self.fast_scan.scan.take_if(|scan| scan.event == Some(event)) else {
            return false;
        };
        let codes = self.frame_of_codes(&scan);
        let half = scan.frames % 2;
        let base = scan.settings.ring + half * 2 * codes.len() as u64;
        for (offset, width) in accesses(base, 2 * codes.len() as u64) {
            let from = offset as usize / 2;
            let some = &codes[from..from + width.bytes() as usize / 2];
            let value = some.iter().rev().fold(0, |value, code| value << 16 | u64::from(*code));
            context.write_to(base + offset, width, value, FRAME_TOKEN);
        }
        // The table as it is for the next frame.
        ask_for_table(scan.settings.table, context);
        context.write_to(DMA1_LIFCR, Width::W32, 0, FRAME_TOKEN);
        scan.flags |= if half == 0 { HTIF[0] } else { TCIF[0] };
        scan.frames += 1;
        scan.event = Some(context.schedule(VirtualNanos(self.fast_scan.frame_end(&scan))));
        self.fast_scan.scan = Some(scan);
        true
    }

    /// From this slot on the address is as the table has it; in the first of all it is as it was.
    fn scan_addressed(&mut self, scan: &Scan, slot: u64, now: u64) {
        if let Some(lines) = scan.lines(slot) {
            self.addressed(lines as usize >> FIRST_PIN, now);
        }
    }

    /// A frame's codes in the order of conversions; the addresses go on as the table has them.
    fn frame_of_codes(&mut self, scan: &Scan) -> Vec<u16> {
        let settings = &scan.settings;
        let mut codes = Vec::with_capacity(TAXELS * settings.sequence.len());
        let first = scan.frames * TAXELS as u64;
        for number in first..first + TAXELS as u64 {
            let begin = scan.start_cycle + number * settings.slot;
            self.scan_addressed(scan, number, self.fast_scan.instant(begin));
            let trigger = self.fast_scan.instant(begin + settings.trigger);
            for (rank, sensor) in settings.sequence.iter().enumerate() {
                let end = trigger + self.fast_scan.converted_ns(settings, rank as u64 + 1);
                codes.push(self.code(*sensor, end - self.fast_scan.conversion_ns()) as u16);
            }
        }
        codes
    }
}

#[cfg(test)]
mod tests {
    use super::accesses;

    #[test]
    fn accesses_are_aligned_and_leave_no_gap() {
        for base in [0, 2, 4, 6] {
            let mut end = 0;
            for (offset, width) in accesses(base, 2048) {
                let bytes = u64::from(width.bytes());
                assert_eq!(offset, end, "base {base}");
                assert!((base + offset).is_multiple_of(bytes), "base {base}, offset {offset}, {bytes} bytes");
                end += bytes;
            }
            assert_eq!(end, 2048, "base {base}");
        }
    }
}
