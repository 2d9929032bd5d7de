//! Step 6: the natural logarithm of a mel power, with the floor.

use super::power::POWER_FRAC_BITS;
use super::tables::{LN_2_Q24, LN_Q24};
use crate::fixed::round_shift;

/// Least power the logarithm sees, LSB²; applied to the sum over axes and bins, because a floor per axis
/// would break the invariance to rotation near silence.
///
/// No live sensor reaches it: rounding to 16 bits alone puts 3 axes · 1/12 LSB² · Σw² = 12 LSB² into every bin, the noise
/// of a real part (30 to 150 µg/√Hz at 0.24 to 0.49 mg/LSB) thousands.
pub const LOG_FLOOR_LSB2: u64 = 1;

/// Fraction bits of the logarithm.
pub const LN_FRAC_BITS: u32 = 16;
/// Fraction bits of [`LN_Q24`].
const TABLE_FRAC_BITS: u32 = 24;
/// Bits of the mantissa between two table entries that the interpolation uses.
const STEP_BITS: u32 = 14;

/// `ln(max(power, floor))`: power in LSB², Q16, result in nat, Q16, from 0 to 33.3.
///
/// Linear interpolation between 129 entries; the error, rounding included, is below 1.6e-5 nat.
#[inline]
pub fn ln_q16(power_q16: u64) -> i32 {
    let power = power_q16.max(LOG_FLOOR_LSB2 << POWER_FRAC_BITS);
    let zeros = power.leading_zeros();
    // The 32 most significant bits: a leading 1, 7 bits of table index, 14 of position, 10 unused.
    let mantissa = ((power << zeros) >> 32) as u32;
    let index = ((mantissa >> 24) & 0x7f) as usize;
    let position = (mantissa >> (24 - STEP_BITS)) & ((1 << STEP_BITS) - 1);
    let (left, right) = (LN_Q24[index], LN_Q24[index + 1]);
    // right − left ≤ 2^17, position < 2^14.
    let between = ((right - left) * position + (1 << (STEP_BITS - 1))) >> STEP_BITS;
    // The floor makes the octave 0 or more; 48 · ln 2 in Q24 is below 2^30.
    let octave = 63 - zeros - POWER_FRAC_BITS;
    round_shift((octave * LN_2_Q24 + left + between) as i64, TABLE_FRAC_BITS - LN_FRAC_BITS) as i32
}
