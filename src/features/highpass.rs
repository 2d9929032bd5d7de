//! Step 1: the 10 Hz Butterworth high-pass that takes gravity and hand motion out, at 8 kHz per axis.
//!
//! Direct form I, because its state is the signal itself: the states have the bound of the output and
//! nothing inside can overflow first. The poles lie at a radius of 0.9945, where plainly rounding the
//! output would be amplified up to 16,000 times and leave half an LSB of false gravity; so the part
//! that rounding drops is added to the next sum (first-order error feedback), which gives the rounding
//! noise a zero at 0 Hz.

use crate::fixed::round_shift;

/// Fraction bits of the filtered signal, in LSB of the accelerometer.
pub const FILTERED_FRAC_BITS: u32 = 14;
/// Largest magnitude of a filtered sample, Q14: Σ|h| = 2.42346 times 2^15 LSB is 79,412 LSB, and the
/// rounding noise is below one. The window and the FFT rest on it.
pub const FILTERED_MAX: i32 = 79_500 << FILTERED_FRAC_BITS;
const COEFFICIENT_FRAC_BITS: u32 = 30;

/// Coefficients of `y = b0·(x − 2x₁ + x₂) − a1·y₁ − a2·y₂`, Q30. The numerator is one number, so the
/// zero at 0 Hz is exact whatever the rounding of the coefficients.
#[derive(Clone, Copy, Debug)]
pub struct HighPass {
    /// Gain of the second difference.
    pub b0_q30: i32,
    /// Feedback of the previous output.
    pub a1_q30: i32,
    /// Feedback of the output before.
    pub a2_q30: i32,
}

/// What the filter remembers of one axis.
#[derive(Clone, Copy, Debug)]
pub struct HighPassState {
    x: [i32; 2],
    y: [i32; 2],
    dropped: i32,
    primed: bool,
}

impl HighPassState {
    /// No sample seen yet.
    pub const fn new() -> Self {
        Self { x: [0; 2], y: [0; 2], dropped: 0, primed: false }
    }
}

impl Default for HighPassState {
    fn default() -> Self {
        Self::new()
    }
}

impl HighPass {
    /// Filter one sample of one axis; the result is in LSB, Q14.
    ///
    /// The first sample is taken as the value the axis has had forever, so gravity makes no step.
    ///
    /// The result is within [`FILTERED_MAX`] by the nature of the filter; the clamp, which no signal
    /// reaches, lets everything after it rely on that.
    #[inline]
    pub fn step(&self, state: &mut HighPassState, sample: i16) -> i32 {
        let x = sample as i32;
        if !state.primed {
            state.x = [x; 2];
            state.primed = true;
        }
        let [x1, x2] = state.x;
        let [y1, y2] = state.y;
        // |x − 2x₁ + x₂| ≤ 131,070, so it fits in i32 with its 14 fraction bits.
        let difference = (x - 2 * x1 + x2) << FILTERED_FRAC_BITS;
        // b0 · 2^31 + (|a1| + a2) · FILTERED_MAX, Q30, is 5.6 · 2^60, and `dropped` adds 2^29: no
        // partial sum reaches 2^63. The whole is the next output, 1.3 · 2^60 at most.
        let sum = self.b0_q30 as i64 * difference as i64
            - self.a1_q30 as i64 * y1 as i64
            - self.a2_q30 as i64 * y2 as i64
            + state.dropped as i64;
        let rounded = round_shift(sum, COEFFICIENT_FRAC_BITS);
        // −2^29 ≤ dropped < 2^29 by the rounding rule.
        state.dropped = (sum - (rounded << COEFFICIENT_FRAC_BITS)) as i32;
        let y = rounded.clamp(-FILTERED_MAX as i64, FILTERED_MAX as i64) as i32;
        state.x = [x, x1];
        state.y = [y, y1];
        y
    }
}
