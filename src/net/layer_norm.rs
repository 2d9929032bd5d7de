//! Residual sum and LayerNorm.

use super::dense::{GROUP, scaled};
use super::model::{Layer, Norm};
use crate::fixed::{STANDARD_FRAC_BITS, saturate_i16, scale_q32, standardise};

/// Fraction bits of the factor that brings an activation to the scale of the residual sum.
pub const RESIDUAL_FACTOR_BITS: u32 = 16;
/// A residual sum has 22 bits; [`standardise`] asks for a magnitude below 2^22.
pub const RESIDUAL_BITS: u32 = 22;
/// `LayerNorm(x + layer(context))`, to the scale of `norm`.
///
/// `x`, `out`: `layer.outputs` activations, at most `WIDTH_MAX`. The sum has a scale of its own
/// and is not cut to 16 bits before it is normalised; `record_sum` is shown it.
pub fn add_and_norm<const WIDTH_MAX: usize>(
    layer: &Layer<'_>,
    context: &[u32],
    x: &[i16],
    norm: &Norm<'_>,
    out: &mut [i16],
    record_sum: impl FnOnce(&[i32]),
) {
    let mut sum = [0i32; WIDTH_MAX];
    let mut standard = [0i16; WIDTH_MAX];
    let width = x.len().min(WIDTH_MAX);
    let sum = &mut sum[..width];
    for (group, sum) in sum.chunks_mut(GROUP).enumerate() {
        let x = x.get(group * GROUP..).unwrap_or_default();
        let mut values = [0; GROUP];
        scaled(layer, context, group * GROUP, &mut values);
        for ((sum, &x), &value) in sum.iter_mut().zip(x).zip(&values) {
            // Each is at most 2^30 in magnitude, a scaled accumulator below.
            let residual = scale_q32((x as i32) << (32 - RESIDUAL_FACTOR_BITS), norm.residual) + value;
            *sum = residual.clamp(-(1 << (RESIDUAL_BITS - 1)), (1 << (RESIDUAL_BITS - 1)) - 1);
        }
    }
    record_sum(sum);
    standardise::<STANDARD_FRAC_BITS>(sum, norm.epsilon, &mut standard[..width]);
    let affine = norm.gamma.iter().zip(norm.beta.iter());
    for ((out, &n), (&gamma, &beta)) in out.iter_mut().zip(&standard[..width]).zip(affine) {
        // The model file's bound keeps |n · gamma + beta| below 2^31.
        *out = saturate_i16(scale_q32(beta.wrapping_add(n as i32 * gamma as i32), norm.multiplier));
    }
}
