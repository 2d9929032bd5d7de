//! From 16 to 8 kHz: a half-band filter, then every second sample.
//!
//! 47 taps (`HALF_BAND_Q15`), all but the centre at odd offsets, so 12 products per axis and sample. Measured on
//! the rounded coefficients (`tests/drivers/decimate.rs` asserts it): up to 3,300 Hz within ±0.012 dB, −6 dB at
//! 4 kHz as any half-band filter, from 4,700 Hz on at least 59 dB down. What lies between 4,000 and 4,700 Hz folds
//! onto 3,300 to 4,000 Hz with less damping: the upper half of the last mel triangle. The samples come 23 samples
//! of the part, 1.44 ms, late.
//!
//! Integers: coefficients Q15, sums in 32 bits (the absolute coefficients sum to less than 2, a sample has 16 bits),
//! rounded once by floor(x + 1/2) and saturated to 16 bits.

use super::decimate_table::HALF_BAND_Q15;
use crate::sensor::XlSample;

/// Taps, and samples that are remembered.
pub const TAPS: usize = 4 * HALF_BAND_Q15.len() - 1;
/// Samples of the part between a sample and the middle of the filter.
pub const DELAY_SAMPLES: usize = TAPS / 2;
/// The next power of two, so that positions wrap.
const RING: usize = TAPS.next_power_of_two();
const ROUND: i32 = 1 << 14;

/// The filter's memory for one accelerometer.
#[derive(Clone, Debug)]
pub struct Decimator {
    ring: [XlSample; RING],
    /// Where the next sample goes.
    at: usize,
}

impl Decimator {
    /// As if `sample` had lasted for ever, so that gravity does not come as a step.
    pub const fn primed(sample: XlSample) -> Self {
        Self { ring: [sample; RING], at: 0 }
    }

    /// Take a sample; where `keep`, which is every second time, give one.
    pub fn push(&mut self, sample: XlSample, keep: bool) -> Option<XlSample> {
        self.ring[self.at % RING] = sample;
        self.at = (self.at + 1) % RING;
        keep.then(|| core::array::from_fn(|axis| self.filtered(axis)))
    }

    /// The output whose last tap is on the newest sample.
    fn filtered(&self, axis: usize) -> i16 {
        let newest = self.at + RING - 1;
        let tap = |back: usize| i32::from(self.ring[(newest - back) % RING][axis]);
        let centre = tap(DELAY_SAMPLES) * (1 << 14);
        let sides = HALF_BAND_Q15.iter().zip((1..).step_by(2));
        let sum = sides.fold(centre + ROUND, |sum, (&coefficient, offset)| {
            sum + coefficient * (tap(DELAY_SAMPLES - offset) + tap(DELAY_SAMPLES + offset))
        });
        (sum >> 15).clamp(i16::MIN.into(), i16::MAX.into()) as i16
    }
}

/// The sum of the absolute coefficients, with the centre, Q15.
const GAIN_MAX_Q15: i64 = {
    let mut sum = 1 << 14;
    let mut i = 0;
    while i < HALF_BAND_Q15.len() {
        sum += 2 * HALF_BAND_Q15[i].unsigned_abs() as i64;
        i += 1;
    }
    sum
};
const _: () = assert!(GAIN_MAX_Q15 * 32_768 + (ROUND as i64) <= i32::MAX as i64, "the sums fit in 32 bits");
