//! Residual sum and LayerNorm.

use super::dense::accumulators;
use super::model::{Layer, Norm};
use super::requantize;
use crate::fixed::{STANDARD_FRAC_BITS, scale_q32, standardise};
use crate::params::limits::EMBED;
use crate::simd::LANES;

/// Extra fraction bits of the residual sum over the activation it adds to.
pub const RESIDUAL_EXTRA_BITS: u32 = 4;
/// Largest magnitude of a residual sum; [`standardise`] asks for less than 2^22.
const RESIDUAL_MAX: i32 = (1 << 21) - 1;
/// Widest vector: the fused one.
const WIDTH_MAX: usize = 2 * EMBED;

/// `LayerNorm(x + layer(context))`, to the scale of `norm`.
///
/// `x`, `out`: `layer.outputs` activations, at most 128. The sum keeps 4 bits more than `x`
/// and is not cut to 16 bits before it is normalised; `see_sum` is shown it.
pub fn add_and_norm(
    layer: &Layer<'_>,
    context: &[u32],
    x: &[i16],
    norm: &Norm<'_>,
    out: &mut [i16],
    see_sum: impl FnOnce(&[i32]),
) {
    let mut sum = [0i32; WIDTH_MAX];
    let mut standard = [0i16; WIDTH_MAX];
    let width = x.len().min(WIDTH_MAX);
    let sum = &mut sum[..width];
    let blocks = sum.chunks_mut(LANES).zip(x.chunks(LANES)).zip(accumulators(layer, context));
    for ((sum, x), (accs, multipliers)) in blocks {
        for (((sum, &x), acc), &multiplier) in sum.iter_mut().zip(x).zip(accs).zip(multipliers) {
            let residual = ((x as i32) << RESIDUAL_EXTRA_BITS) + scale_q32(acc, multiplier);
            *sum = residual.clamp(-RESIDUAL_MAX, RESIDUAL_MAX);
        }
    }
    see_sum(sum);
    standardise::<STANDARD_FRAC_BITS>(sum, norm.epsilon, &mut standard[..width]);
    let affine = norm.gamma.iter().zip(norm.beta.iter());
    for ((out, &n), (&gamma, &beta)) in out.iter_mut().zip(&standard[..width]).zip(affine) {
        // The model file's bound keeps |n · gamma + beta| below 2^31.
        *out = requantize::signed(beta.wrapping_add(n as i32 * gamma as i32), norm.multiplier);
    }
}
