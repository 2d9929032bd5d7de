//! The accelerometer samples of one frame, axis by axis: one of four predictors for the whole batch, and
//! frequencies that follow the size of the last differences.

use super::range::Coder;
use super::tables::{XL_CONTEXTS, XL_TABLES};
use super::value::{fold, half_octaves, unfold};
use crate::params::XL_AXES;
use crate::sensor::XlSample;

/// A sample is guessed as the one before plus so many halves of the step that led to that one.
const HALF_STEPS: [i32; 4] = [-1, 0, 1, 2];
const PREDICTOR_BITS: u32 = 2;
/// The first samples' scale, half octaves in twos: 16 of them.
const SCALE_BITS: u32 = 4;
const SAMPLE_BITS: u32 = 16;
/// The running size is this many times the mean of the last folded differences.
const RUNNING: u32 = 4;

/// Code a batch.
pub(super) fn code<C: Coder>(coder: &mut C, samples: &mut [XlSample]) {
    if samples.is_empty() {
        return;
    }
    for axis in 0..XL_AXES {
        let (predictor, scale) = choose(samples, axis);
        let predictor = coder.bits(PREDICTOR_BITS, predictor);
        let half_steps = HALF_STEPS.get(predictor as usize).copied().unwrap_or(0);
        let mut size = RUNNING << coder.bits(SCALE_BITS, scale);
        let mut values = samples.iter_mut().filter_map(|sample| sample.get_mut(axis));
        let Some(first) = values.next() else { return };
        *first = coder.bits(SAMPLE_BITS, u32::from(*first as u16)) as u16 as i16;
        let (mut last, mut step) = (i32::from(*first), 0);
        for value in values {
            let guess = last + ((half_steps * step) >> 1);
            // Modulo 2^16, so that the difference has 16 bits whatever the guess.
            let difference = i32::from(*value).wrapping_sub(guess) as i16;
            let context = half_octaves(size).min(XL_CONTEXTS - 1);
            let folded = coder.value(&XL_TABLES[context], fold(difference.into()));
            size = size - size / RUNNING + folded;
            let now = i32::from((guess + unfold(folded)) as i16);
            *value = now as i16;
            step = now - last;
            last = now;
        }
    }
}

/// The predictor with the smallest differences, and log2 of the mean of them folded. Means nothing in a decoder,
/// which is told.
fn choose(samples: &[XlSample], axis: usize) -> (u32, u32) {
    let mut values = samples.iter().filter_map(|sample| sample.get(axis)).map(|&value| i32::from(value));
    let Some(mut last) = values.next() else { return (1, 0) };
    let (mut step, mut sums) = (0, [0u32; HALF_STEPS.len()]);
    for value in values {
        let now = value - last;
        for (sum, half_steps) in sums.iter_mut().zip(HALF_STEPS) {
            *sum += (now - ((half_steps * step) >> 1)).unsigned_abs();
        }
        (last, step) = (value, now);
    }
    let smallest = sums.iter().copied().enumerate().min_by_key(|&(_, sum)| sum);
    let (predictor, sum) = smallest.unwrap_or((1, 0));
    let mean = 2 * sum / samples.len().max(2).saturating_sub(1) as u32;
    (predictor as u32, mean.max(1).ilog2().min((1 << SCALE_BITS) - 1))
}
