//! Fully connected layer.

use super::model::Layer;
use crate::simd::{LANES, dense4};

/// `out[c] = requantize(bias[c] + Σ weight[c][i] · x[i], multiplier[c])`.
///
/// `x`: the layer's input in words, zeros behind it. `out`: `layer.outputs` activations. `requantize` is one of
/// [`super::requantize`]'s.
#[inline]
pub fn dense(layer: &Layer<'_>, x: &[u32], out: &mut [i16], requantize: impl Fn(i32, i32) -> i16) {
    let take = layer.outputs.min(out.len());
    let out = out.get_mut(..take).unwrap_or_default();
    for ((sums, multiplier), out) in accumulators(layer, x).zip(out.chunks_mut(LANES)) {
        for ((out, sum), &multiplier) in out.iter_mut().zip(sums).zip(multiplier) {
            *out = requantize(sum, multiplier);
        }
    }
}

/// The accumulators of a layer, four by four, with their multipliers: for what follows a layer without going
/// through `i16` first.
#[inline]
pub fn accumulators<'a>(
    layer: &Layer<'a>,
    x: &'a [u32],
) -> impl Iterator<Item = ([i32; LANES], &'a [i32; LANES])> + 'a {
    let words = layer.inputs.words();
    let x = x.get(..words).unwrap_or_default();
    let blocks = layer.weights.chunks_exact((LANES * words).max(1));
    let scales = layer.bias.as_chunks::<LANES>().0.iter().zip(layer.multiplier.as_chunks::<LANES>().0);
    // The model file's bound keeps every partial sum below 2^31, so the wrapping additions do not wrap.
    blocks.zip(scales).map(move |(weights, (bias, multiplier))| (dense4(*bias, x, weights), multiplier))
}
