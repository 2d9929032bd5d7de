//! Softmax to the base 2, by table.
//!
//! Scores arrive in log2 units with 10 fraction bits (the exporter folds log2(e) and 1/√d into the
//! score's multiplier), so `2^(s − max)` is a table look-up of the fraction and a shift.

use super::tables::EXP2_Q15;

/// Fraction bits of a score.
pub const SCORE_FRAC_BITS: u32 = 10;
/// Fraction bits of a weight; the weights of one softmax sum to 2^15 but for rounding.
pub const WEIGHT_FRAC_BITS: u32 = 15;

/// Largest magnitude of `Σ weight · value` of `i16` values under the weights of one softmax.
pub const WEIGHTED_SUM_MAX: i64 = (1 << 30) + (1 << 20);

/// Replace scores by their weights, each 0 to 32767.
///
/// `scores`: 1 to 64 values of magnitude below 2^31 / 2. A weight is off by less than 2^-14 of the sum
/// plus the table's 0.03 %; rounding adds at most half a unit each, so n weights sum to at most
/// 2^15 + n/2 and `Σ weight · value` of `i16` values stays below [`WEIGHTED_SUM_MAX`].
pub fn softmax_base2(scores: &mut [i32]) {
    let max = scores.iter().copied().fold(i32::MIN, i32::max);
    let mut sum = 0u32;
    for score in scores.iter_mut() {
        // At most 2^31: wrapping arithmetic in u32 is exact.
        let below_max = max.wrapping_sub(*score) as u32;
        let shift = (below_max >> SCORE_FRAC_BITS).min(31);
        let power = EXP2_Q15[(below_max % (1 << SCORE_FRAC_BITS)) as usize] as u32 >> shift;
        *score = power as i32;
        sum += power;
    }
    // The largest power is 2^15, so the sum is never 0 and the reciprocal at most 2^16 · 2^15 / 2^15.
    let reciprocal_q31 = (1u32 << 31) / sum.max(1);
    for score in scores.iter_mut() {
        // A power is at most 2^15, so the product is at most 2^31.
        let weight = (*score as u32).wrapping_mul(reciprocal_q31).wrapping_add(1 << 15) >> 16;
        *score = weight.min(i16::MAX as u32) as i32;
    }
}
