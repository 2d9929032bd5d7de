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
    softmax_base2_with_max(scores, max);
}

/// [`softmax_base2`] of scores whose largest is known to be `max`.
#[inline]
pub(super) fn softmax_base2_with_max(scores: &mut [i32], max: i32) {
    let mut sum = 0u32;
    for score in scores.iter_mut() {
        // Never negative, whatever the scores. Shifting and cutting to five bits are one instruction, `usat`.
        let below_max = max.saturating_sub(*score);
        let shift = (below_max >> SCORE_FRAC_BITS).clamp(0, 31);
        let power = EXP2_Q15[below_max as usize % (1 << SCORE_FRAC_BITS)] as u32 >> shift;
        *score = power as i32;
        sum += power;
    }
    // The largest power is 2^15, so the sum is never 0. A power that is all of it has the reciprocal cut, and so its
    // weight, to 15 bits.
    let reciprocal_q31 = ((1u32 << 31) / sum.max(1)).min(2 * i16::MAX as u32);
    for score in scores.iter_mut() {
        // A power is at most 2^15, so this stays below 2^31.
        *score = ((*score as u32).wrapping_mul(reciprocal_q31).wrapping_add(1 << 15) >> 16) as i32;
    }
}
