//! The entropy coder: a range coder (Martin 1979; byte by byte as in Schindler's), with frequencies that do not
//! change while coding. Encoder and decoder differ in one trait only, so that what is modelled is written once.
//!
//! Both keep an interval of a number that the bytes spell. A symbol narrows it to the share that its frequency
//! gives it; leading bytes that are settled leave. A symbol of frequency f costs log2(4096 / f) bits, fractions
//! included: most taxels cost less than the whole bit that a Rice or Huffman code needs.

use super::tables::Table;
use super::value::{SYMBOLS, join, split};

/// log2 of the sum of the frequencies of a table.
pub(super) const FREQUENCY_BITS: u32 = 12;
/// Below this the interval gives up a byte.
const RANGE_MIN: u32 = 1 << 24;
/// Bytes that a decoder may look at beyond the end, as zeros: it holds four at a time.
const AHEAD: usize = 4;

/// One direction of coding. Every method takes the value to encode and returns the value coded, so a model that
/// goes on with what is returned runs in both directions; a decoder ignores what it is given.
pub trait Coder {
    /// A value of at most 16 bits, with the frequencies of this table.
    fn value(&mut self, table: &'static Table, value: u32) -> u32;

    /// The low `count` bits of a value, at most 16, all values as likely as each other.
    fn bits(&mut self, count: u32, value: u32) -> u32;
}

/// Writes into a slice. What does not fit is left out, and [`finish`](Encoder::finish) says so.
pub(super) struct Encoder<'a> {
    out: &'a mut [u8],
    at: usize,
    low: u32,
    range: u32,
    over: bool,
}

impl<'a> Encoder<'a> {
    pub(super) fn new(out: &'a mut [u8]) -> Self {
        Self { out, at: 0, low: 0, range: u32::MAX, over: false }
    }

    /// Bytes written so far; `None`: they did not fit.
    pub(super) const fn len(&self) -> Option<usize> {
        if self.over { None } else { Some(self.at) }
    }

    #[inline]
    fn narrow(&mut self, share: u32, start: u32, frequency: u32) {
        let (low, carry) = self.low.overflowing_add(share * start);
        self.low = low;
        self.range = share * frequency;
        if carry {
            self.carry();
        }
        // Twice at most: a share is 2^8 at least.
        while self.range < RANGE_MIN {
            self.range <<= 8;
            self.byte();
        }
    }

    #[inline]
    fn byte(&mut self) {
        match self.out.get_mut(self.at) {
            Some(out) => {
                *out = (self.low >> 24) as u8;
                self.at += 1;
            }
            None => self.over = true,
        }
        self.low <<= 8;
    }

    /// One more in what has been written. A byte is reached once at most in its life, because the interval never
    /// grows, so that all carries together visit no byte twice.
    #[cold]
    fn carry(&mut self) {
        for out in self.out.get_mut(..self.at).unwrap_or(&mut []).iter_mut().rev() {
            let (sum, carry) = out.overflowing_add(1);
            *out = sum;
            if !carry {
                return;
            }
        }
    }

    /// Settle what is left; `None` if it did not fit. Zeros at the end are not written: a decoder reads zeros
    /// there anyway.
    pub(super) fn finish(mut self) -> Option<usize> {
        // The number in the interval that ends with the most zeros: its top byte, rounded up, is always enough.
        let (low, carry) = self.low.overflowing_add(RANGE_MIN - 1);
        self.low = low & !(RANGE_MIN - 1);
        if carry {
            self.carry();
        }
        self.byte();
        let written = self.out.get(..self.at)?;
        let zeros = written.iter().rev().take_while(|&&byte| byte == 0).count();
        (!self.over).then_some(self.at - zeros)
    }
}

impl Coder for Encoder<'_> {
    #[inline]
    fn value(&mut self, table: &'static Table, value: u32) -> u32 {
        let (symbol, extra) = split(value);
        let [start, frequency] = table.get(symbol).copied().unwrap_or_default();
        self.narrow(self.range >> FREQUENCY_BITS, start.into(), frequency.into());
        if extra > 0 {
            self.bits(extra, value);
        }
        value
    }

    fn bits(&mut self, count: u32, value: u32) -> u32 {
        let value = value & ((1 << count) - 1);
        self.narrow(self.range >> count, value, 1);
        value
    }
}

/// Reads what an [`Encoder`] wrote. Of any bytes it makes some values: whether they are right, the check in the
/// message says.
pub(super) struct Decoder<'a> {
    bytes: &'a [u8],
    /// Bytes taken, zeros beyond the end included.
    at: usize,
    /// What the bytes spell, less the lower end of the interval.
    offset: u32,
    range: u32,
}

impl<'a> Decoder<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        let mut decoder = Self { bytes, at: 0, offset: 0, range: u32::MAX };
        (0..AHEAD).for_each(|_| decoder.byte());
        decoder
    }

    fn byte(&mut self) {
        let byte = self.bytes.get(self.at).copied().unwrap_or(0);
        self.at += 1;
        self.offset = self.offset << 8 | u32::from(byte);
    }

    /// Do the bytes end where the encoder's did? It settled all but [`AHEAD`] of the bytes taken, wrote one more,
    /// and left out zeros at the end.
    pub(super) fn is_at_end(&self) -> bool {
        self.bytes.len() < self.at + 2 - AHEAD && self.bytes.last() != Some(&0)
    }

    fn narrow(&mut self, share: u32, start: u32, frequency: u32) {
        self.offset = self.offset.wrapping_sub(share * start);
        self.range = share * frequency;
        while self.range < RANGE_MIN {
            self.range <<= 8;
            self.byte();
        }
    }
}

impl Coder for Decoder<'_> {
    fn value(&mut self, table: &'static Table, _: u32) -> u32 {
        let share = self.range >> FREQUENCY_BITS;
        let target = self.offset / share;
        // The last symbol whose share begins at or below; damage can point beyond the sum of all.
        let symbol =
            table.iter().rposition(|&[start, frequency]| frequency > 0 && u32::from(start) <= target);
        let symbol = symbol.unwrap_or(0).min(SYMBOLS - 1);
        let [start, frequency] = table.get(symbol).copied().unwrap_or([0, 1]);
        self.narrow(share, start.into(), frequency.into());
        let (value, extra) = join(symbol);
        if extra > 0 { value | self.bits(extra, 0) } else { value }
    }

    fn bits(&mut self, count: u32, _: u32) -> u32 {
        let share = self.range >> count;
        let value = (self.offset / share).min((1 << count) - 1);
        self.narrow(share, value, 1);
        value
    }
}
