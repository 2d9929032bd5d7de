//! Step 1: the 10 Hz Butterworth high-pass that takes gravity and hand motion out, at 8 kHz per axis.
//!
//! Direct form I: its states are the signal itself and have the bound of the output. The poles lie at a radius of
//! 0.9945, where rounding the output alone would be amplified up to 16,000 times and leave half an LSB of false gravity;
//! so what rounding drops is added to the next sum (first-order error feedback), which gives the noise a zero at 0 Hz.

/// Fraction bits of the filtered signal, in LSB of the accelerometer.
pub const FILTERED_FRAC_BITS: u32 = 14;
/// Largest magnitude of a filtered sample, Q14: Σ|h| = 2.42346 times 2^15 LSB is 79,412 LSB, the rounding noise below
/// one. Window and FFT rely on it.
pub const FILTERED_MAX: i32 = 79_500 << FILTERED_FRAC_BITS;

/// The filter `y = b0·(x − 2x₁ + x₂) − a1·y₁ − a2·y₂`. The numerator is one number, so the zero at 0 Hz is exact
/// whatever the rounding of the coefficients. They lie near 1, −2 and 1; here is what they are more, Q32.
#[derive(Clone, Copy, Debug)]
pub struct HighPass {
    /// Of the second difference: b0 − 1.
    pub difference_q32: i32,
    /// Of the previous output: −a1 − 2.
    pub y1_q32: i32,
    /// Of the output before: 1 − a2.
    pub y2_q32: i32,
}

/// What the filter remembers of one axis.
#[derive(Clone, Copy, Debug)]
pub struct HighPassState {
    x: [i32; 2],
    y: [i32; 2],
    /// What rounding dropped from the last output, 2^-32 of its last bit, and half a bit.
    fraction: u32,
}

impl HighPassState {
    /// At rest at `sample`: as if the axis had had this value forever, so that gravity makes no step.
    #[inline]
    pub const fn at_rest(sample: i16) -> Self {
        Self { x: [sample as i32; 2], y: [0; 2], fraction: 1 << 31 }
    }
}

impl HighPass {
    /// Filter one sample of one axis; the result is in LSB, Q14, within [`FILTERED_MAX`].
    #[inline]
    pub fn step(&self, state: &mut HighPassState, sample: i16) -> i32 {
        let x = sample as i32;
        let [x1, x2] = state.x;
        let [y1, y2] = state.y;
        // |x − 2x₁ + x₂| ≤ 131,070, so it fits in i32 with its 14 fraction bits.
        let difference = (x - 2 * x1 + x2) << FILTERED_FRAC_BITS;
        // The coefficients' small parts, below 2^-6, times below 2^31 each. The upper half of the sum is rounded by
        // the half in `fraction`; the lower half is the next `fraction`.
        let sum = state.fraction as i64
            + self.difference_q32 as i64 * difference as i64
            + self.y1_q32 as i64 * y1 as i64
            + self.y2_q32 as i64 * y2 as i64;
        state.fraction = sum as u32;
        // And their whole parts, exact. On the way the sum may leave i32 and wrap; the output does not.
        let y = difference.wrapping_add(y1.wrapping_mul(2)).wrapping_sub(y2).wrapping_add((sum >> 32) as i32);
        state.x = [x, x1];
        state.y = [y, y1];
        y
    }
}
