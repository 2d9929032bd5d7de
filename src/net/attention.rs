//! Multi-head attention of one query frame over the cached keys and values of the last frames.
//!
//! A key and a value depend on their own frame only: computed once and kept, they make every frame cost the same, and a
//! stream gives the bits of a whole sequence under a banded causal mask.

use core::ops::Range;

use super::activations::Activations;
use super::dense::dense;
use super::layer_norm::add_and_norm;
use super::model::Attention;
use super::observer::Observer;
use super::softmax::{WEIGHT_FRAC_BITS, softmax_base2_with_max};
use crate::fixed::{query_key_i16, saturate_i16, scale_q32};
use crate::params::limits::{EMBED, WINDOW};
use crate::simd::{dots, weighted_sums};

/// Keys and values of the last frames, newest overwriting oldest.
#[derive(Clone, Debug)]
pub struct KeyValueCache<const W: usize> {
    keys: [[u32; W]; WINDOW],
    values: [[u32; W]; WINDOW],
    /// Slot of the next frame.
    next: usize,
    /// Frames seen, up to the window.
    filled: usize,
}

impl<const W: usize> KeyValueCache<W> {
    /// Empty.
    pub const fn new() -> Self {
        Self { keys: [[0; W]; WINDOW], values: [[0; W]; WINDOW], next: 0, filled: 0 }
    }

    /// Add key and value of the newest frame `x`; the one that leaves the window is overwritten. Block and window must be
    /// the same at every call. `window`: frames that the model looks back over, the newest included, 1 to [`WINDOW`].
    pub fn push(
        &mut self,
        block: &Attention<'_>,
        x: &Activations<W>,
        window: usize,
        observer: &mut impl Observer,
    ) {
        if let (Some(key), Some(value)) = (self.keys.get_mut(self.next), self.values.get_mut(self.next)) {
            let key: &mut [i16] = bytemuck::must_cast_slice_mut(key);
            let value: &mut [i16] = bytemuck::must_cast_slice_mut(value);
            dense(&block.key, x.words(), key, query_key_i16);
            dense(&block.value, x.words(), value, saturate_i16);
            observer.record_part(block.name, "key", key.get(..block.key.outputs).unwrap_or_default());
            observer.record_part(block.name, "value", value.get(..block.value.outputs).unwrap_or_default());
        }
        let window = window.min(WINDOW);
        self.next = if self.next + 1 < window { self.next + 1 } else { 0 };
        self.filled = (self.filled + 1).min(window);
    }

    /// Split `by_lag`, newest (lag 0) first: the first part, reversed, belongs to the first slots, up to the newest
    /// frame's; the second, reversed, to the slots after it.
    #[inline]
    fn split<'b, T>(&self, by_lag: &'b [T]) -> [&'b [T]; 2] {
        let by_lag = by_lag.get(..self.filled).unwrap_or_default();
        let slots_up_to_newest = if self.next == 0 { self.filled } else { self.next };
        by_lag.split_at_checked(slots_up_to_newest).unwrap_or((by_lag, &[])).into()
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
    dense(&block.query, x.words(), query.values_mut(), query_key_i16);
    observer.record_part(block.name, "query", query.values().get(..width).unwrap_or_default());

    let mut scores = [0i32; WINDOW];
    for head in 0..block.heads {
        let from = (head * head_width).min(width);
        let to = (from + head_width).min(width);
        let weights = scores.get_mut(..cache.filled).unwrap_or_default();
        score(&query, cache, from..to, weights);
        let (mut unbiased, mut max) = (&mut *weights, i32::MIN);
        for part in cache.split(block.bias.head(head)) {
            let Some((scores, rest)) = unbiased.split_at_mut_checked(part.len()) else { break };
            max = scale_and_bias(scores, block.score_multiplier, part).max(max);
            unbiased = rest;
        }
        softmax_base2_with_max(weights, max);
        gather(cache, weights, from..to, &mut context);
    }
    let x = x.values().get(..width).unwrap_or_default();
    let see = |sum: &[i32]| observer.record_residual(block.name, sum);
    // By width, because the buffers are zeroed first.
    match width {
        0..=32 => add_and_norm::<32>(&block.out, context.words(), x, &block.norm, out, see),
        33..=64 => add_and_norm::<64>(&block.out, context.words(), x, &block.norm, out, see),
        _ => add_and_norm::<{ 2 * EMBED }>(&block.out, context.words(), x, &block.norm, out, see),
    }
}

/// `score = score · multiplier + bias`, scaled by [`scale_q32`]; the largest. Scores in the order of slots, biases in the
/// reverse, newest first.
#[inline]
fn scale_and_bias(scores: &mut [i32], multiplier: i32, biases: &[i16]) -> i32 {
    let mut max = i32::MIN;
    let mut each = |score: &mut i32, bias: i16| {
        *score = scale_q32(*score, multiplier) + bias as i32;
        max = max.max(*score);
    };
    // Four at a time: the loop itself costs half of the work.
    let (fours, rest) = scores.as_chunks_mut::<4>();
    let (rest_biases, four_biases) = biases.as_rchunks::<4>();
    for ([a, b, c, d], &[bias_d, bias_c, bias_b, bias_a]) in fours.iter_mut().zip(four_biases.iter().rev()) {
        each(a, bias_a);
        each(b, bias_b);
        each(c, bias_c);
        each(d, bias_d);
    }
    for (score, &bias) in rest.iter_mut().zip(rest_biases.iter().rev()) {
        each(score, bias);
    }
    max
}

/// Products of the query with the key of every cached frame, slot after slot, over some columns.
///
/// A head is at most 32 columns wide (checked in the model file) and a product below 2^26: a sum fits.
fn score<const W: usize>(
    query: &Activations<W>,
    cache: &KeyValueCache<W>,
    columns: Range<usize>,
    scores: &mut [i32],
) {
    let Range { start: from, end: to } = columns;
    if from % 2 == 0 && to % 2 == 0 {
        let query = query.words().get(from / 2..to / 2).unwrap_or_default();
        dots(query, cache.keys.as_flattened().get(from / 2..).unwrap_or_default(), W, scores);
    } else {
        let query = query.values().get(from..to).unwrap_or_default();
        for (score, key) in scores.iter_mut().zip(&cache.keys) {
            let key: &[i16] = bytemuck::must_cast_slice(key);
            let products = query.iter().zip(key.get(from..).unwrap_or_default());
            *score = products.fold(0, |sum, (&q, &k)| sum.wrapping_add(q as i32 * k as i32));
        }
    }
}

/// `context = Σ weight · value` over the cached frames, slot after slot, over some columns.
///
/// Bounded by [`softmax_base2`]'s contract: below 2^31, and so no sum wraps; a weight fits 16 bits.
fn gather<const W: usize>(
    cache: &KeyValueCache<W>,
    weights: &[i32],
    columns: Range<usize>,
    context: &mut Activations<W>,
) {
    let Range { start: from, end: to } = columns;
    // Eight columns at a time, from an even one on; those of another head are skipped.
    for start in (from & !1..to).step_by(8) {
        let rows = cache.values.as_flattened().get(start / 2..).unwrap_or_default();
        let sums = weighted_sums(weights, rows, W);
        let (skipped, end) = (from.saturating_sub(start), to.saturating_sub(start));
        let context = context.values_mut().get_mut(start..).unwrap_or_default().iter_mut();
        for (context, &sum) in context.zip(&sums).take(end).skip(skipped) {
            // 2^30 and half a unit: fits.
            *context = saturate_i16((sum + (1 << (WEIGHT_FRAC_BITS - 1))) >> WEIGHT_FRAC_BITS);
        }
    }
}
