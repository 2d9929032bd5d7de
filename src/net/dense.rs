//! Fully connected layer, and the dot product that every kernel rests on.

use super::model::Layer;

/// Sum of products of activations and weights; stops at the shorter of the two.
///
/// The model file's bound keeps every partial sum below 2^31, so the additions cannot wrap; they are
/// written as wrapping so that no build adds a check to them.
#[inline]
pub fn dot(x: &[i16], weights: &[u8]) -> i32 {
    x.iter().zip(weights).fold(0, |acc: i32, (&x, &w)| acc.wrapping_add(x as i32 * (w as i8) as i32))
}

/// `out[c] = requantize(bias[c] + Σ weight[c][i] · x[i], multiplier[c])`.
///
/// `x`: `layer.inputs` activations. `out`: `layer.outputs` activations. `requantize` is one of
/// [`super::requantize`]'s.
#[inline]
pub fn dense(layer: &Layer<'_>, x: &[i16], out: &mut [i16], requantize: impl Fn(i32, i32) -> i16) {
    for (acc, out) in accumulators(layer, x).zip(out) {
        *out = requantize(acc.0, acc.1);
    }
}

/// The accumulators of a layer, each with its multiplier: for what follows a layer without going
/// through `i16` first.
#[inline]
pub fn accumulators<'a>(layer: &Layer<'a>, x: &'a [i16]) -> impl Iterator<Item = (i32, i32)> + 'a {
    layer
        .weights
        .chunks_exact(layer.inputs.max(1))
        .zip(layer.bias.iter())
        .zip(layer.multiplier.iter())
        .map(move |((weights, bias), multiplier)| (bias.wrapping_add(dot(x, weights)), multiplier))
}
