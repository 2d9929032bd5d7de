//! What changed on a pad against its own recent past: the second channel that the network sees of an array.
//!
//! A slip moves load between neighbouring taxels by a few counts within a few frames, on top of hundreds of
//! counts that stay. Each taxel keeps a running average of its counts; the difference from it has that
//! motion alone, at eight times the gain.
//!
//! Per taxel, with `x = 16 · count` and `a` the average before this frame, both in 1/16 count:
//! `change = floor((x − a) / 2)`, then `a ← a + round((x − a) / 8)`: a time constant of 8 frames, 33 ms.

use crate::fixed::round_shift;
use crate::params::{COUNT_MAX, TAXELS};

/// Fraction bits of the average.
const AVERAGE_FRAC_BITS: u32 = 4;
/// The average moves by `2^-AVERAGE_SHIFT` of the difference each frame.
pub const AVERAGE_SHIFT: u32 = 3;
/// Units of the change in one count: it is as many times the count's scale.
pub const CHANGE_GAIN: i32 = 1 << (AVERAGE_FRAC_BITS - 1);

const _: () = assert!((COUNT_MAX as u32) << AVERAGE_FRAC_BITS <= u16::MAX as u32, "the average fits");

/// The running averages of one array.
#[derive(Clone, Debug)]
pub struct TaxelChange {
    /// Row-major, 1/16 count.
    average: [u16; TAXELS],
    /// Has there been a scan since the start or the last gap?
    started: bool,
}

impl TaxelChange {
    /// Before the first scan, whose change is 0 everywhere.
    pub const fn new() -> Self {
        Self { average: [0; TAXELS], started: false }
    }

    /// Take a scan in and hand every taxel's index, count and change to `take`, row-major: the change in
    /// 1/8 count, −32760 to 32760.
    #[inline]
    pub fn push(&mut self, counts: &[u16; TAXELS], mut take: impl FnMut(usize, u16, i16)) {
        let started = self.started;
        self.started = true;
        for (index, (average, &count)) in self.average.iter_mut().zip(counts).enumerate() {
            let x = (count.min(COUNT_MAX) as i32) << AVERAGE_FRAC_BITS;
            if !started {
                *average = x as u16;
            }
            let difference = x - *average as i32;
            // Between the old average and x, so within u16 and, halved, within i16.
            *average = (*average as i32 + round_shift(difference as i64, AVERAGE_SHIFT) as i32) as u16;
            take(index, count, (difference >> 1) as i16);
        }
    }

    /// A scan is missing: what comes after the gap is not compared with what was before it.
    pub fn forget(&mut self) {
        self.started = false;
    }
}

impl Default for TaxelChange {
    fn default() -> Self {
        Self::new()
    }
}
