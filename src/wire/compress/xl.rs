//! The accelerometer samples of one frame, axis by axis: one of four predictors for the whole batch, and
//! frequencies that follow the size of the last differences.

use super::range::{Decoder, Sink};
use super::tables::XL_TABLES;
use super::value::{BySize, Table, fold, unfold};
use crate::params::XL_AXES;
use crate::sensor::XlSample;
use crate::wire::raw::RAW_XL_MAX;

/// A sample is guessed as the one before plus this many halves of the step that led to that one.
const HALF_STEPS: [i32; 4] = [-1, 0, 1, 2];
const PREDICTOR_BITS: u32 = 2;
/// The first samples' scale, half octaves in twos: 15 of them, and one that says something else.
const SCALE_BITS: u32 = 4;
/// In place of a scale: all samples are the first. As they are of a part that has stopped.
const STEADY: u32 = (1 << SCALE_BITS) - 1;
const SAMPLE_BITS: u32 = 16;
/// The running size is this many times the mean of the last folded differences.
const RUNNING: u32 = 4;

static TABLES: BySize = BySize::new(&XL_TABLES);

/// Code a batch of at most [`RAW_XL_MAX`] samples.
pub(super) fn encode(sink: &mut impl Sink, samples: &[XlSample]) {
    let Some((first, others)) = samples.split_first() else { return };
    let mut values = [(&XL_TABLES[0], 0); RAW_XL_MAX];
    for (axis, &first) in first.iter().enumerate() {
        let (predictor, scale) = choose(samples, axis);
        sink.bits(PREDICTOR_BITS, predictor);
        sink.bits(SCALE_BITS, scale);
        sink.bits(SAMPLE_BITS, u32::from(first as u16));
        if scale == STEADY {
            continue;
        }
        let mut prediction = Prediction::new(predictor, scale, first);
        for (value, &sample) in values.iter_mut().zip(others.iter().filter_map(|sample| sample.get(axis))) {
            let (table, guess) = prediction.expect();
            // Modulo 2^16, so that the difference has 16 bits whatever the guess.
            let folded = fold((i32::from(sample) - guess) as i16 as i32);
            *value = (table, folded);
            prediction.step_to(sample, folded);
        }
        sink.values(values.get(..others.len()).unwrap_or(&values));
    }
}

/// The reverse.
pub(super) fn decode(decoder: &mut Decoder<'_>, samples: &mut [XlSample]) {
    for axis in 0..XL_AXES {
        let mut values = samples.iter_mut().filter_map(|sample| sample.get_mut(axis));
        let Some(first) = values.next() else { return };
        let (predictor, scale) = (decoder.bits(PREDICTOR_BITS), decoder.bits(SCALE_BITS));
        *first = decoder.bits(SAMPLE_BITS) as u16 as i16;
        let first = *first;
        if scale == STEADY {
            values.for_each(|value| *value = first);
            continue;
        }
        let mut prediction = Prediction::new(predictor, scale, first);
        for value in values {
            let (table, guess) = prediction.expect();
            let folded = decoder.value(table);
            *value = (guess + unfold(folded)) as i16;
            prediction.step_to(*value, folded);
        }
    }
}

/// State of the predictor of an axis.
struct Prediction {
    half_steps: i32,
    /// Of the last differences.
    size: u32,
    last: i32,
    step: i32,
}

impl Prediction {
    fn new(predictor: u32, scale: u32, first: i16) -> Self {
        let half_steps = HALF_STEPS.get(predictor as usize).copied().unwrap_or(0);
        Self { half_steps, size: RUNNING << scale, last: first.into(), step: 0 }
    }

    /// Table of the next sample, and what it may be; in 18 bits.
    #[inline(always)]
    const fn expect(&self) -> (&'static Table, i32) {
        (TABLES.get(self.size), self.last + ((self.half_steps * self.step) >> 1))
    }

    #[inline(always)]
    fn step_to(&mut self, sample: i16, folded: u32) {
        self.size = self.size - self.size / RUNNING + folded;
        let sample = i32::from(sample);
        (self.step, self.last) = (sample - self.last, sample);
    }
}

/// The predictor with the smallest differences, and log2 of the mean of them folded, or [`STEADY`].
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
    if sums.iter().all(|&sum| sum == 0) {
        return (0, STEADY);
    }
    let mean = 2 * sum / samples.len().max(2).saturating_sub(1) as u32;
    (predictor as u32, mean.max(1).ilog2().min(STEADY - 1))
}
