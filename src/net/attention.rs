//! Multi-head attention of one query frame over the cached keys and values of the last frames.
//!
//! A key and a value depend on their own frame only, so they are computed once and kept. A frame then
//! costs the same at any time, and a stream gives the bits of a whole sequence under a banded causal
//! mask.

use super::dense::dense;
use super::layer_norm::add_and_norm;
use super::model::Attention;
use super::observer::Observer;
use super::requantize;
use super::softmax::{WEIGHT_FRAC_BITS, softmax_base2};
use crate::fixed::{round_shift, saturate_i16, scale_q32};
use crate::params::limits::{EMBED, WINDOW};

/// Widest attention: the temporal one over the fused vector.
const WIDTH_MAX: usize = 2 * EMBED;

/// One frame's key and value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct KeyValue<const D: usize> {
    key: [i16; D],
    value: [i16; D],
}

impl<const D: usize> KeyValue<D> {
    const ZERO: Self = Self { key: [0; D], value: [0; D] };

    /// Project one frame of the sequence that is attended to.
    pub fn project(block: &Attention<'_>, x: &[i16], observer: &mut impl Observer) -> Self {
        let mut out = Self::ZERO;
        dense(&block.key, x, &mut out.key, requantize::query_key);
        dense(&block.value, x, &mut out.value, requantize::signed);
        observer.see_part(block.name, "key", out.key.get(..block.key.outputs).unwrap_or_default());
        observer.see_part(block.name, "value", out.value.get(..block.value.outputs).unwrap_or_default());
        out
    }
}

/// Keys and values of the last frames, newest overwriting oldest.
#[derive(Clone, Debug)]
pub struct KeyValueCache<const D: usize> {
    slots: [KeyValue<D>; WINDOW],
    /// Slots in use: the model's window.
    window: usize,
    /// Slot of the newest frame.
    newest: usize,
    /// Frames seen, up to the window.
    filled: usize,
}

impl<const D: usize> KeyValueCache<D> {
    /// Empty, for a model that looks back over `window` frames, the current one included.
    pub const fn new(window: usize) -> Self {
        let window = if window == 0 || window > WINDOW { WINDOW } else { window };
        Self { slots: [KeyValue::ZERO; WINDOW], window, newest: 0, filled: 0 }
    }

    /// Take the newest frame in; the one that leaves the window is forgotten.
    pub fn push(&mut self, entry: KeyValue<D>) {
        self.newest = if self.newest + 1 < self.window { self.newest + 1 } else { 0 };
        if let Some(slot) = self.slots.get_mut(self.newest) {
            *slot = entry;
        }
        self.filled = (self.filled + 1).min(self.window);
    }

    /// The cached frames, newest (lag 0) first.
    pub fn newest_first(&self) -> impl Iterator<Item = &KeyValue<D>> + Clone {
        let (recent, older) = self.slots.split_at((self.newest + 1).min(WINDOW));
        let older = older.get(..self.window.saturating_sub(self.newest + 1)).unwrap_or_default();
        recent.iter().rev().chain(older.iter().rev()).take(self.filled)
    }
}

/// `LayerNorm(x + Wo · context)`, where the context is the softmax-weighted sum of the values of
/// `frames`, newest first, at most [`WINDOW`] of them.
///
/// `x`, `out`: the block's width, at most 128 activations.
pub fn attend<'a, const D: usize>(
    block: &Attention<'_>,
    x: &[i16],
    frames: impl Iterator<Item = &'a KeyValue<D>> + Clone,
    out: &mut [i16],
    observer: &mut impl Observer,
) {
    let width = block.query.outputs.min(D).min(WIDTH_MAX);
    let head_width = (width / block.heads.max(1)).max(1);
    let mut query = [0i16; WIDTH_MAX];
    let mut context = [0i16; WIDTH_MAX];
    dense(&block.query, x, &mut query[..width], requantize::query_key);
    observer.see_part(block.name, "query", &query[..width]);

    let heads = query[..width].chunks_exact(head_width).zip(context[..width].chunks_exact_mut(head_width));
    for (head, (query, context)) in heads.enumerate() {
        let columns = head * head_width..(head + 1) * head_width;
        let mut scores = [0i32; WINDOW];
        let mut count = 0;
        for ((score, entry), bias) in scores.iter_mut().zip(frames.clone()).zip(block.bias.head(head)) {
            let key = entry.key.get(columns.clone()).unwrap_or_default();
            // head_width ≤ 32 products below 2^26: fits; the model file's dimensions are checked for it.
            let acc = query.iter().zip(key).fold(0i32, |acc, (&q, &k)| acc.wrapping_add(q as i32 * k as i32));
            *score = scale_q32(acc, block.score_multiplier) + bias as i32;
            count += 1;
        }
        let weights = &mut scores[..count];
        softmax_base2(weights);
        for (column, context) in columns.zip(context) {
            // Bounded by softmax_base2's contract: below 2^31.
            let acc = frames.clone().zip(weights.iter()).fold(0i32, |acc, (entry, &weight)| {
                acc.wrapping_add(weight * entry.value.get(column).copied().unwrap_or_default() as i32)
            });
            *context = saturate_i16(round_shift(acc as i64, WEIGHT_FRAC_BITS) as i32);
        }
    }
    add_and_norm(&block.out, &context[..width], x, &block.norm, out, |sum| {
        observer.see_residual(block.name, sum);
    });
}
