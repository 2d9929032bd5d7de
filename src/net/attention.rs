//! Multi-head attention of one query frame over the cached keys and values of the last frames.
//!
//! A key and a value depend on their own frame only, so they are computed once and kept. A frame then
//! costs the same at any time, and a stream gives the bits of a whole sequence under a banded causal
//! mask.

use super::activations::Activations;
use super::dense::dense;
use super::layer_norm::add_and_norm;
use super::model::Attention;
use super::observer::Observer;
use super::requantize;
use super::softmax::{WEIGHT_FRAC_BITS, softmax_base2};
use crate::fixed::{round_shift, saturate_i16, scale_q32};
use crate::params::limits::WINDOW;
use crate::simd::{mla_high, mla_low, mla_pair};

/// One frame's key and value, in words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct KeyValue<const W: usize> {
    key: Activations<W>,
    value: Activations<W>,
}

impl<const W: usize> KeyValue<W> {
    const ZERO: Self = Self { key: Activations::new(), value: Activations::new() };

    /// Project one frame of the sequence that is attended to.
    pub fn project(block: &Attention<'_>, x: &Activations<W>, observer: &mut impl Observer) -> Self {
        let mut out = Self::ZERO;
        dense(&block.key, x.words(), out.key.values_mut(), requantize::query_key);
        dense(&block.value, x.words(), out.value.values_mut(), requantize::signed);
        observer.see_part(block.name, "key", out.key.values().get(..block.key.outputs).unwrap_or_default());
        let value = out.value.values().get(..block.value.outputs).unwrap_or_default();
        observer.see_part(block.name, "value", value);
        out
    }
}

/// Keys and values of the last frames, newest overwriting oldest.
#[derive(Clone, Debug)]
pub struct KeyValueCache<const W: usize> {
    slots: [KeyValue<W>; WINDOW],
    /// Slots in use: the model's window.
    window: usize,
    /// Slot of the newest frame.
    newest: usize,
    /// Frames seen, up to the window.
    filled: usize,
}

impl<const W: usize> KeyValueCache<W> {
    /// Empty, for a model that looks back over `window` frames, the current one included.
    pub const fn new(window: usize) -> Self {
        let window = if window == 0 || window > WINDOW { WINDOW } else { window };
        Self { slots: [KeyValue::ZERO; WINDOW], window, newest: 0, filled: 0 }
    }

    /// Take the newest frame in; the one that leaves the window is forgotten.
    pub fn push(&mut self, entry: KeyValue<W>) {
        self.newest = if self.newest + 1 < self.window { self.newest + 1 } else { 0 };
        if let Some(slot) = self.slots.get_mut(self.newest) {
            *slot = entry;
        }
        self.filled = (self.filled + 1).min(self.window);
    }

    /// Hand the cached frames to `each`, newest (lag 0) first: two straight runs through memory.
    #[inline]
    fn newest_first(&self, mut each: impl FnMut(usize, &KeyValue<W>)) {
        let (recent, older) = self.slots.split_at((self.newest + 1).min(WINDOW));
        let older = older.get(..self.window.saturating_sub(self.newest + 1)).unwrap_or_default();
        let recent = recent.get(recent.len().saturating_sub(self.filled)..).unwrap_or_default();
        let rest = self.filled - recent.len();
        let older = older.get(older.len().saturating_sub(rest)..).unwrap_or_default();
        let mut lag = 0;
        for run in [recent, older] {
            for entry in run.iter().rev() {
                each(lag, entry);
                lag += 1;
            }
        }
    }
}

/// `LayerNorm(x + Wo · context)`, where the context is the softmax-weighted sum of the values of the frames in
/// `cache`.
///
/// `x`, `out`: the block's width, at most `2 · W` activations.
pub fn attend<const W: usize>(
    block: &Attention<'_>,
    x: &Activations<W>,
    cache: &KeyValueCache<W>,
    out: &mut [i16],
    observer: &mut impl Observer,
) {
    let width = block.query.outputs.min(2 * W);
    let head_width = (width / block.heads.max(1)).max(1);
    let mut query = Activations::<W>::new();
    let mut context = Activations::<W>::new();
    dense(&block.query, x.words(), query.values_mut(), requantize::query_key);
    observer.see_part(block.name, "query", query.values().get(..width).unwrap_or_default());

    for head in 0..block.heads {
        let from = (head * head_width).min(width);
        let to = (from + head_width).min(width);
        let mut scores = [0i32; WINDOW];
        score(&query, cache, (from, to), &mut scores);
        let weights = scores.get_mut(..cache.filled).unwrap_or_default();
        for (score, &bias) in weights.iter_mut().zip(block.bias.head(head)) {
            *score = scale_q32(*score, block.score_multiplier) + bias as i32;
        }
        softmax_base2(weights);
        gather(cache, weights, (from, to), &mut context);
    }
    let x = x.values().get(..width).unwrap_or_default();
    add_and_norm(&block.out, context.words(), x, &block.norm, out, |sum| {
        observer.see_residual(block.name, sum);
    });
}

/// Products of the query with the key of every cached frame, over columns `from` to `to`.
///
/// A head is at most 32 columns wide and a product below 2^26: a sum fits. The model file's dimensions are checked
/// for it.
fn score<const W: usize>(
    query: &Activations<W>,
    cache: &KeyValueCache<W>,
    (from, to): (usize, usize),
    scores: &mut [i32; WINDOW],
) {
    if from % 2 == 0 && to % 2 == 0 {
        let words = from / 2..to / 2;
        let query = query.words().get(words.clone()).unwrap_or_default();
        cache.newest_first(|lag, entry| {
            let key = entry.key.words().get(words.clone()).unwrap_or_default();
            if let Some(score) = scores.get_mut(lag) {
                *score = query.iter().zip(key).fold(0, |acc, (&q, &k)| mla_pair(acc, q, k));
            }
        });
    } else {
        let query = query.values().get(from..to).unwrap_or_default();
        cache.newest_first(|lag, entry| {
            let key = entry.key.values().get(from..to).unwrap_or_default();
            if let Some(score) = scores.get_mut(lag) {
                let products = query.iter().zip(key).map(|(&q, &k)| q as i32 * k as i32);
                *score = products.fold(0, i32::wrapping_add);
            }
        });
    }
}

/// Words of the values that are summed at once: as many as sums fit the registers.
const GATHERED: usize = 4;

/// `context = Σ weight · value` over the cached frames, columns `from` to `to`.
///
/// Bounded by [`softmax_base2`]'s contract: below 2^31.
fn gather<const W: usize>(
    cache: &KeyValueCache<W>,
    weights: &[i32],
    (from, to): (usize, usize),
    context: &mut Activations<W>,
) {
    let rounded = |acc: i32| saturate_i16(round_shift(acc as i64, WEIGHT_FRAC_BITS) as i32);
    let mut column = from;
    while column < to {
        let whole = column % 2 == 0 && column + 2 * GATHERED <= to;
        if whole {
            let mut sums = [0i32; 2 * GATHERED];
            cache.newest_first(|lag, entry| {
                let weight = weights.get(lag).copied().unwrap_or_default() as u32;
                let values = entry.value.words().get(column / 2..).and_then(|v| v.first_chunk::<GATHERED>());
                for (sums, &value) in sums.as_chunks_mut::<2>().0.iter_mut().zip(values.unwrap_or(&[0; _])) {
                    *sums = [mla_low(sums[0], value, weight), mla_high(sums[1], value, weight)];
                }
            });
            let context = context.values_mut().get_mut(column..).unwrap_or_default();
            for (context, sum) in context.iter_mut().zip(sums) {
                *context = rounded(sum);
            }
            column += 2 * GATHERED;
        } else {
            let mut sum = 0i32;
            cache.newest_first(|lag, entry| {
                let weight = weights.get(lag).copied().unwrap_or_default();
                let value = entry.value.values().get(column).copied().unwrap_or_default();
                sum = sum.wrapping_add(weight * value as i32);
            });
            if let Some(context) = context.values_mut().get_mut(column) {
                *context = rounded(sum);
            }
            column += 1;
        }
    }
}
