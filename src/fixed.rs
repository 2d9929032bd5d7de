//! The one rounding rule of the project, and the few integer helpers every kernel shares.
//!
//! **Rounding**: wherever bits are dropped, the result is `floor(x + 1/2)`: to nearest, ties towards
//! plus infinity. On the MCU this is an add and an arithmetic shift (`smmulr` for a shift of 32).
//! There is no second rule anywhere between host and MCU.

/// A fixed-point number: the integer `T` with `F` fraction bits. Numbers cross a module's border so; within a kernel
/// they are plain integers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
#[repr(transparent)]
pub struct Q<T, const F: u32>(T);

/// A logit or the difference of two, nat.
pub type Logit = Q<i32, 10>;

impl<T: Copy, const F: u32> Q<T, F> {
    /// Fraction bits.
    pub const FRAC_BITS: u32 = F;

    /// From the integer.
    pub const fn from_bits(bits: T) -> Self {
        Self(bits)
    }

    /// The integer.
    pub const fn to_bits(self) -> T {
        self.0
    }

    /// The number, exact; for hosts.
    #[expect(clippy::float_arithmetic, reason = "not on the way of a frame")]
    pub fn to_f64(self) -> f64
    where
        T: Into<f64>,
    {
        self.0.into() / (1u64 << F) as f64
    }
}

/// `round(x / 2^shift)`, ties towards plus infinity. `shift` is 1 to 62 and `|x|` below 2^62.
#[inline]
pub const fn round_shift(x: i64, shift: u32) -> i64 {
    (x + (1 << (shift - 1))) >> shift
}

/// `round(acc · multiplier / 2^32)`: the requantization of an accumulator, one `smmulr` on the MCU. The multiplier is
/// `s_in · s_w / s_out · 2^32`, 0 to 2^31−1: real ratios below one half. The exporter refuses a layer whose ratio does
/// not fit. One of the clamps below follows.
#[inline]
pub const fn scale_q32(acc: i32, multiplier: i32) -> i32 {
    // |acc · multiplier| ≤ 2^62, so the sum stays in i64 and the result in i32.
    ((acc as i64 * multiplier as i64 + (1 << 31)) >> 32) as i32
}

/// `round((a + b) / 2)`, which never overflows.
#[inline]
pub const fn mean(a: i32, b: i32) -> i32 {
    // a + b is twice the common bits and once the others; (a | b) has the common and all the others.
    (a | b) - ((a ^ b) >> 1)
}

/// Clamp to the range of `i16`.
#[inline]
pub fn saturate_i16(x: i32) -> i16 {
    // Written so, the compiler knows it for one instruction, `ssat`.
    x.clamp(i16::MIN as i32, i16::MAX as i32) as i16
}

/// Largest magnitude of a query or key: 32 products of two of them still fit an `i32`.
pub const QUERY_KEY_MAX: i32 = 8_191;

/// Activation after ReLU, 0 to 32767.
#[inline]
pub fn relu_i16(scaled: i32) -> i16 {
    scaled.clamp(0, i16::MAX as i32) as i16
}

/// Query or key, ±[`QUERY_KEY_MAX`].
#[inline]
pub fn query_key_i16(scaled: i32) -> i16 {
    scaled.clamp(-QUERY_KEY_MAX, QUERY_KEY_MAX) as i16
}

/// Fraction bits of [`standardise`]'s output: Q4.11 covers ±16, and n values with mean 0 and
/// variance 1 never exceed √(n−1), so up to 256 values never clip.
pub const STANDARD_FRAC_BITS: u32 = 11;

/// `(x − mean) / sqrt(variance + epsilon)` of a vector, with `FRAC` fraction bits, in place of the
/// textbook float: the per-frame standardisation of the log-mel bins and the core of LayerNorm.
///
/// `x`: 1 to 256 values of magnitude below 2^22, any scale; overwritten with their deviations.
/// `epsilon`: in squared units of `x`, at least 1. Mean and result follow the rule of this module.
/// In between, variance, root and reciprocal are floors, as integer division and square root give
/// them: the root has 8 fraction bits (relative error below 2^-8 / sigma), the reciprocal 31 significant ones.
/// The result saturates to `i16`.
pub fn standardise<const FRAC: u32>(x: &mut [i32], epsilon: u64, out: &mut [i16]) {
    const { assert!(FRAC <= 15, "the result has 16 bits") };
    let n = x.len() as i32;
    if n == 0 {
        return;
    }
    // 256 · 2^22 = 2^30 at most: fits.
    let mean = round_div(x.iter().fold(0i32, |a, &v| a.wrapping_add(v)), n);
    let mut squares = 0u64;
    for v in x.iter_mut() {
        *v -= mean;
        // |deviation| < 2^23, 256 squares < 2^54.
        squares += (*v as i64 * *v as i64) as u64;
    }
    let variance = squares / n as u64 + epsilon;
    // variance < 2^47: 16 more bits give the root 8 fraction bits and keep it below 2^32.
    let sigma_q8 = (variance << 16).isqrt() as u32;
    // A variance of at least 1 makes the root at least 256; max() lets the compiler see it is not 0. Shifted up to
    // its 32 bits its reciprocal is 2^62 / root: 31 bits, but for a root of 2^31, which would give one more.
    let zeros = sigma_q8.max(1).leading_zeros();
    let reciprocal = ((1u64 << 62) / ((sigma_q8.max(1) as u64) << zeros)).min(i32::MAX as u64) as i64;
    // No deviation exceeds √n · sigma ≤ 16 · sigma, which is below 2^(28 − zeros).
    let shift = 3 + zeros;
    for (v, o) in x.iter().zip(out.iter_mut()) {
        // deviation / sigma = product · 2^(5 − 62). Dropping the low word first changes nothing of a floor.
        let high = (((*v << shift) as i64 * reciprocal) >> 32) as i32;
        *o = saturate_i16((high + (1 << (24 - FRAC))) >> (25 - FRAC));
    }
}

/// `round(x / d)` for positive `d`, ties towards plus infinity.
pub const fn round_div(x: i32, d: i32) -> i32 {
    ((2 * x as i64 + d as i64).div_euclid(2 * d as i64)) as i32
}
