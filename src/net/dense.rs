//! Fully connected layer.

use super::model::Layer;
use crate::simd::{self, LayerParams};

/// Outputs that are computed before they are cut to their range.
pub(super) const GROUP: usize = 32;

/// `out[c] = cut((bias[c] + Σ weight[c][i] · x[i]) · multiplier[c])`.
///
/// `x`: the layer's input in words, zeros behind it. `out`: `layer.outputs` activations. `cut` is one of
/// [`crate::fixed`]'s.
#[inline]
pub fn dense(layer: &Layer<'_>, x: &[u32], out: &mut [i16], cut: impl Fn(i32) -> i16) {
    let out = out.get_mut(..layer.outputs.min(out.len())).unwrap_or_default();
    for (group, out) in out.chunks_mut(GROUP).enumerate() {
        let mut values = [0; GROUP];
        scaled(layer, x, group * GROUP, &mut values);
        for (out, &value) in out.iter_mut().zip(&values) {
            *out = cut(value);
        }
    }
}

/// The outputs from `first` on, a multiple of four, scaled but not cut: for what follows a layer without going
/// through `i16` first. Values behind the last output are left as they are.
#[inline]
pub fn scaled(layer: &Layer<'_>, x: &[u32], first: usize, values: &mut [i32; GROUP]) {
    let words = layer.inputs.words();
    let x = x.get(..words).unwrap_or_default();
    let params = LayerParams {
        weights: layer.weights.get(first * words..).unwrap_or_default(),
        bias: layer.bias.get(first..).unwrap_or_default(),
        multiplier: layer.multiplier.get(first..).unwrap_or_default(),
    };
    // The model file's bound keeps every partial sum below 2^31, so the wrapping additions do not wrap.
    simd::dense(x, params, values);
}
