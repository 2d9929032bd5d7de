//! The entropy coder: a range coder (Martin 1979), 16 bits at a time, with frequencies that do not change while coding.
//!
//! Encoder and decoder keep an interval of the number that the bytes are. A symbol narrows it to its frequency's share;
//! leading bits that are settled are output. A symbol of frequency f costs log2(4096 / f) bits, fractions included: most
//! taxels cost less than the whole bit that a Rice or Huffman code needs. An interval as narrow as 2^16 costs 0.004 bits
//! a symbol more than 2^24 would, and halves the number of outputs.
//!
//! A range coder, not an asymmetric numeral system: it needs no second pass over the symbols, and on the Cortex-M7 a
//! symbol is one multiplication and one multiply-accumulate to 64 bits, carry included, without a division.

use super::value::{DIRECT, SYMBOLS, Table, join, split};

/// log2 of the sum of the frequencies of a table.
const FREQUENCY_BITS: u32 = 12;
/// What leaves, or is taken in, at once.
const UNIT_BITS: u32 = 16;
/// Below this the interval gives up a unit. A share is 1 at least then, whatever is coded: up to 16 plain bits.
const RANGE_MIN: u32 = 1 << UNIT_BITS;
/// Units that the interval's ends have.
const UNITS: u32 = u32::BITS / UNIT_BITS;
/// A unit, low byte first.
type Unit = [u8; UNIT_BITS as usize / 8];

/// Takes the values of a frame: the encoder, or a count of symbols to learn tables from.
pub trait Sink {
    /// Values of at most 16 bits, each with the frequencies of its table.
    fn values(&mut self, values: &[(&'static Table, u32)]);

    /// The low `count` bits of a value, at most 16, all values as likely as each other.
    fn bits(&mut self, count: u32, value: u32);
}

/// Writes into a slice. What does not fit is left out, and [`finish`](Encoder::finish) says so.
pub(super) struct Encoder<'a> {
    out: &'a mut [Unit],
    interval: Interval,
}

/// Apart from the slice, so that it is in registers while values are coded.
#[derive(Clone, Copy)]
struct Interval {
    /// Units that have left, also those that did not fit.
    at: usize,
    /// Lower end, and above its 32 bits a carry into what has left.
    low: u64,
    range: u32,
}

impl Interval {
    #[inline(always)]
    fn value(&mut self, out: &mut [Unit], table: &Table, value: u32) {
        let share = self.range >> FREQUENCY_BITS;
        if value < DIRECT {
            let [start, frequency] = table[value as usize];
            self.narrow(out, share, start.into(), frequency.into());
        } else {
            let (symbol, extra) = split(value);
            let [start, frequency] = table.get(symbol).copied().unwrap_or_default();
            self.narrow(out, share, start.into(), frequency.into());
            self.bits(out, extra, value);
        }
    }

    #[inline(always)]
    fn bits(&mut self, out: &mut [Unit], count: u32, value: u32) {
        self.narrow(out, self.range >> count, value & ((1 << count) - 1), 1);
    }

    #[inline(always)]
    fn narrow(&mut self, out: &mut [Unit], share: u32, start: u32, frequency: u32) {
        // Never more than one carry: the upper end of the interval only falls.
        self.low += u64::from(share) * u64::from(start);
        self.range = share * frequency;
        if self.range < RANGE_MIN {
            self.range <<= UNIT_BITS;
            self.unit(out);
        }
    }

    #[inline(always)]
    fn unit(&mut self, out: &mut [Unit]) {
        let unit = (self.low >> UNIT_BITS) as u32;
        if unit >= RANGE_MIN {
            carry(out, self.at);
        }
        if let Some(out) = out.get_mut(self.at) {
            *out = (unit as u16).to_le_bytes();
        }
        self.at += 1;
        self.low = u64::from((self.low as u32) << UNIT_BITS);
    }
}

/// One more in the units that have been written. A unit is reached once at most in its life, because the interval
/// never grows, so that all carries together visit no unit twice.
#[cold]
#[inline(never)]
fn carry(out: &mut [Unit], written: usize) {
    for out in out.iter_mut().take(written).rev() {
        let (sum, carry) = u16::from_le_bytes(*out).overflowing_add(1);
        *out = sum.to_le_bytes();
        if !carry {
            return;
        }
    }
}

impl<'a> Encoder<'a> {
    pub(super) fn new(out: &'a mut [u8]) -> Self {
        Self { out: out.as_chunks_mut().0, interval: Interval { at: 0, low: 0, range: u32::MAX } }
    }

    /// Bytes written so far; `None`: they did not fit.
    pub(super) const fn len(&self) -> Option<usize> {
        let at = self.interval.at;
        if at > self.out.len() { None } else { Some(at * size_of::<Unit>()) }
    }

    /// Settle what is left; `None` if it did not fit. It is written as far as a decoder reads, though less would do:
    /// so a decoder that reads to the end, and no further, was given all of it.
    pub(super) fn finish(mut self) -> Option<usize> {
        for _ in 0..UNITS {
            self.interval.unit(self.out);
        }
        self.len()
    }
}

impl Sink for Encoder<'_> {
    #[inline(never)]
    fn values(&mut self, values: &[(&'static Table, u32)]) {
        let mut interval = self.interval;
        for &(table, value) in values {
            interval.value(self.out, table, value);
        }
        self.interval = interval;
    }

    fn bits(&mut self, count: u32, value: u32) {
        self.interval.bits(self.out, count, value);
    }
}

/// Reads what an [`Encoder`] wrote. Of any bytes it makes some values: whether they are right, the check in the
/// message and [`is_at_end`](Decoder::is_at_end) say.
pub(super) struct Decoder<'a> {
    units: &'a [Unit],
    /// Bytes after the last whole unit.
    is_odd: bool,
    /// Units taken, zeros beyond the end included.
    at: usize,
    /// What the bytes spell, less the lower end of the interval.
    offset: u32,
    range: u32,
}

impl<'a> Decoder<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        let (units, rest) = bytes.as_chunks();
        let mut decoder = Self { units, is_odd: !rest.is_empty(), at: 0, offset: 0, range: u32::MAX };
        (0..UNITS).for_each(|_| decoder.unit());
        decoder
    }

    fn unit(&mut self) {
        let unit = self.units.get(self.at).copied().unwrap_or_default();
        self.at += 1;
        self.offset = self.offset << UNIT_BITS | u32::from(u16::from_le_bytes(unit));
    }

    /// Were these all the bytes of an encoder, and no others? Bytes cut off or appended never pass: up to where they
    /// end the decoder does the same as with the right ones, of which it takes each.
    pub(super) const fn is_at_end(&self) -> bool {
        self.units.len() == self.at && !self.is_odd
    }

    fn narrow(&mut self, share: u32, start: u32, frequency: u32) {
        self.offset = self.offset.wrapping_sub(share * start);
        self.range = share * frequency;
        if self.range < RANGE_MIN {
            self.range <<= UNIT_BITS;
            self.unit();
        }
    }

    pub(super) fn value(&mut self, table: &Table) -> u32 {
        let share = self.range >> FREQUENCY_BITS;
        let target = self.offset / share;
        // The last symbol whose share begins at or below; damage can point beyond the sum of all.
        let symbol =
            table.iter().rposition(|&[start, frequency]| frequency > 0 && u32::from(start) <= target);
        let symbol = symbol.unwrap_or(0).min(SYMBOLS - 1);
        let [start, frequency] = table.get(symbol).copied().unwrap_or([0, 1]);
        self.narrow(share, start.into(), frequency.into());
        let (value, extra) = join(symbol);
        if extra > 0 { value | self.bits(extra) } else { value }
    }

    pub(super) fn bits(&mut self, count: u32) -> u32 {
        let share = self.range >> count;
        let value = (self.offset / share).min((1 << count) - 1);
        self.narrow(share, value, 1);
        value
    }
}
