//! Step 2: the latest 128 filtered samples of one axis, and the Hann window over them.

use super::highpass::FILTERED_FRAC_BITS;
use super::tables::HANN_Q30;
use crate::fixed::round_shift;
use crate::params::XL_WINDOW;

/// Fraction bits of the windowed signal, in LSB: what the first stage of the FFT has room for.
pub const WINDOWED_FRAC_BITS: u32 = 13;
const WINDOW_SHIFT: u32 = FILTERED_FRAC_BITS + 30 - WINDOWED_FRAC_BITS;

/// Ring of the latest samples of one axis, LSB in Q14; zeros before the first.
#[derive(Clone, Debug)]
pub struct Ring {
    samples: [i32; XL_WINDOW],
    /// Where the next sample goes, which is where the oldest lies; below 128.
    next: usize,
}

impl Ring {
    /// Silence.
    pub const fn new() -> Self {
        Self { samples: [0; XL_WINDOW], next: 0 }
    }

    /// Put a sample, at most [`super::highpass::FILTERED_MAX`] in magnitude, in the place of the oldest.
    #[inline]
    pub fn push(&mut self, sample: i32) {
        self.samples[self.next % XL_WINDOW] = sample;
        self.next = (self.next + 1) % XL_WINDOW;
    }

    /// The samples under a periodic Hann window, oldest first, in LSB, Q13: at most 79,500 times the
    /// weight, which is what the FFT asks for.
    pub fn windowed(&self) -> [i32; XL_WINDOW] {
        let mut out = [0; XL_WINDOW];
        for (i, (out, &weight)) in out.iter_mut().zip(&HANN_Q30).enumerate() {
            let sample = self.samples[(self.next + i) % XL_WINDOW];
            *out = round_shift(sample as i64 * weight as i64, WINDOW_SHIFT) as i32;
        }
        out
    }
}

impl Default for Ring {
    fn default() -> Self {
        Self::new()
    }
}
