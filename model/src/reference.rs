//! The network in float, one frame at a time, written out plainly: what the batched network must equal,
//! what the quantizer measures ranges on, and what the integer network is compared with.

use std::collections::VecDeque;

use slipsense::features::piezo::PiezoFrontEnd;
use slipsense::net::format::Dims;
use slipsense::params::{CLASSES, MEL_BINS, PIEZO_CHANNELS, TAXEL_ROWS, TAXELS};

use crate::float::NORM_EPSILON;
use crate::piezo::{self, PIEZO_INPUT_SCALE};
use crate::trace::Trace;
use crate::weights::Weights;

/// Activations in the order of their computation, each with one real scale, which the quantizer derives from
/// their ranges.
pub const ACTIVATIONS: [&str; 24] = [
    "taxels",
    "piezo.conv1",
    "piezo.conv2",
    "piezo.conv3",
    "piezo",
    "log_mel",
    "xl.conv",
    "xl.mix1",
    "xl",
    "cross_piezo.query",
    "cross_piezo.key",
    "cross_piezo.value",
    "cross_piezo.residual",
    "cross_xl.query",
    "cross_xl.key",
    "cross_xl.value",
    "cross_xl.residual",
    "fused",
    "temporal.query",
    "temporal.key",
    "temporal.value",
    "temporal.residual",
    "hidden",
    "logits",
];

/// Largest magnitude seen of every activation.
#[derive(Clone, Debug, Default)]
pub struct Ranges {
    largest: [f32; ACTIVATIONS.len()],
}

impl Ranges {
    fn see(&mut self, activation: &str, values: &[f32]) {
        let index = ACTIVATIONS.iter().position(|&a| a == activation);
        let largest = &mut self.largest[index.expect("activations are listed")];
        *largest = values.iter().fold(*largest, |m, x| m.max(x.abs()));
    }

    /// Largest magnitude seen of an activation, real units.
    ///
    /// # Panics
    /// If [`ACTIVATIONS`] does not list it.
    pub fn largest(&self, activation: &str) -> f32 {
        let index = ACTIVATIONS.iter().position(|&a| a == activation);
        self.largest[index.expect("activations are listed")]
    }

    /// Take in what another pass saw.
    pub fn merge(&mut self, other: &Self) {
        for (mine, other) in self.largest.iter_mut().zip(other.largest) {
            *mine = mine.max(other);
        }
    }
}

/// What one sensor delivers in one frame; `None` leaves the part out of the maximum.
#[derive(Clone, Copy, Debug, Default)]
pub struct SensorFrame<'a> {
    /// ADC counts, row-major.
    pub piezo: Option<&'a [u16; TAXELS]>,
    /// Standardised log-mel, Q2.13.
    pub log_mel: Option<&'a [i16; MEL_BINS]>,
}

/// A network and what it remembers.
#[derive(Clone, Debug)]
pub struct Reference<'w> {
    weights: &'w Weights,
    /// Per sensor what the network sees of the pad, by the microcontroller's own kernel.
    pads: Vec<PiezoFrontEnd>,
    /// Per sensor the last `xl_kernel` log-mel frames, oldest first.
    heard: Vec<VecDeque<[f32; MEL_BINS]>>,
    caches: [VecDeque<KeyValue>; 3],
    /// Ranges of all activations so far.
    pub ranges: Ranges,
    /// Where to write down all activations, if anywhere. Who reads them clears them.
    pub trace: Option<Trace>,
}

#[derive(Clone, Debug)]
struct KeyValue {
    key: Vec<f32>,
    value: Vec<f32>,
}

impl<'w> Reference<'w> {
    /// Before the first frame.
    pub fn new(weights: &'w Weights, sensors: usize) -> Self {
        let silence = VecDeque::from(vec![[0.0; MEL_BINS]; weights.dims.xl_kernel]);
        Self {
            weights,
            pads: vec![PiezoFrontEnd::new(); sensors],
            heard: vec![silence; sensors],
            caches: Default::default(),
            ranges: Ranges::default(),
            trace: None,
        }
    }

    fn dims(&self) -> &'w Dims {
        &self.weights.dims
    }

    /// One frame to three logits, nat.
    pub fn step(&mut self, sensors: &[SensorFrame<'_>]) -> [f32; CLASSES] {
        let (mut piezo, mut xl): (Option<Vec<f32>>, Option<Vec<f32>>) = (None, None);
        for (index, sensor) in sensors.iter().enumerate() {
            match sensor.piezo {
                Some(counts) => keep_max(&mut piezo, self.embed_piezo(index, counts)),
                None => self.pads[index].reset(),
            }
            let mut frame = [0.0; MEL_BINS];
            for (real, &q13) in frame.iter_mut().zip(sensor.log_mel.into_iter().flatten()) {
                *real = log_mel_real(q13);
            }
            self.heard[index].pop_front();
            self.heard[index].push_back(frame);
            if sensor.log_mel.is_some() {
                keep_max(&mut xl, self.embed_xl(index));
            }
        }
        let nothing = || vec![0.0; self.dims().embed];
        let (piezo, xl) = (piezo.unwrap_or_else(nothing), xl.unwrap_or_else(nothing));
        let mut fused = self.attend(0, "cross_piezo", &piezo, &xl);
        fused.extend(self.attend(1, "cross_xl", &xl, &piezo));
        self.see("fused", &fused);
        let hidden = self.attend(2, "temporal", &fused, &fused);
        self.see("hidden", &hidden);
        let logits = self.dense("head", &hidden);
        self.see("logits", &logits);
        std::array::from_fn(|class| logits[class])
    }

    fn see(&mut self, activation: &str, values: &[f32]) {
        self.ranges.see(activation, values);
        if let Some(trace) = &mut self.trace {
            trace.see(activation, values.iter().copied());
        }
    }

    fn dense(&self, layer: &str, x: &[f32]) -> Vec<f32> {
        let bias = self.weights.get(layer, "bias");
        let rows = self.weights.get(layer, "weight").chunks_exact(x.len());
        rows.zip(bias).map(|(row, bias)| bias + dot(row, x)).collect()
    }

    fn dense_relu(&self, layer: &str, x: &[f32]) -> Vec<f32> {
        self.dense(layer, x).into_iter().map(|y| y.max(0.0)).collect()
    }

    fn embed_piezo(&mut self, sensor: usize, counts: &[u16; TAXELS]) -> Vec<f32> {
        let mut map = Vec::with_capacity(piezo::IMAGE);
        self.pads[sensor].push(counts, |_, cell| {
            map.extend(cell.map(|x| f32::from(x) * PIEZO_INPUT_SCALE));
        });
        self.see("taxels", &map);
        let (mut side, mut channels) = (TAXEL_ROWS, PIEZO_CHANNELS);
        for layer in piezo::LAYERS {
            map = self.conv_relu_pool(layer, &map, side, channels);
            self.see(layer, &map);
            side /= 2;
            channels = map.len() / (side * side);
        }
        let embedding = self.dense("piezo.dense", &map);
        self.see("piezo", &embedding);
        embedding
    }

    /// Maps are in row, column, channel order.
    fn conv_relu_pool(&self, layer: &str, map: &[f32], side: usize, channels: usize) -> Vec<f32> {
        let bias = self.weights.get(layer, "bias");
        let weight = self.weights.get(layer, "weight");
        let outputs = bias.len();
        let half = side / 2;
        let mut pooled = vec![0.0f32; half * half * outputs];
        let mut patch = vec![0.0; 9 * channels];
        for row in 0..side {
            for col in 0..side {
                for (tap, cell) in patch.chunks_exact_mut(channels).enumerate() {
                    let (r, c) = (row + tap / 3, col + tap % 3);
                    let inside = (1..=side).contains(&r) && (1..=side).contains(&c);
                    let from = ((r.max(1) - 1) * side + c.max(1) - 1) * channels;
                    if inside {
                        cell.copy_from_slice(&map[from..from + channels]);
                    } else {
                        cell.fill(0.0);
                    }
                }
                let cell = &mut pooled[(row / 2 * half + col / 2) * outputs..][..outputs];
                // Starting from 0, the maximum is the ReLU as well.
                for ((out, filter), bias) in cell.iter_mut().zip(weight.chunks_exact(9 * channels)).zip(bias)
                {
                    *out = out.max(bias + dot(filter, &patch));
                }
            }
        }
        pooled
    }

    fn embed_xl(&mut self, sensor: usize) -> Vec<f32> {
        let seen: Vec<f32> = self.heard[sensor].iter().flatten().copied().collect();
        self.see("log_mel", &seen);
        let hidden = self.dense_relu("xl.conv", &seen);
        self.see("xl.conv", &hidden);
        let hidden = self.dense_relu("xl.mix1", &hidden);
        self.see("xl.mix1", &hidden);
        let embedding = self.dense("xl.mix2", &hidden);
        self.see("xl", &embedding);
        embedding
    }

    fn attend(&mut self, cache: usize, block: &str, x: &[f32], seen: &[f32]) -> Vec<f32> {
        let name = |part: &str| format!("{block}.{part}");
        let query = self.dense(&name("query"), x);
        let key = self.dense(&name("key"), seen);
        let value = self.dense(&name("value"), seen);
        for (part, values) in [("query", &query), ("key", &key), ("value", &value)] {
            self.see(&name(part), values);
        }
        let frames = &mut self.caches[cache];
        frames.push_front(KeyValue { key, value });
        frames.truncate(self.weights.dims.window);
        let frames = &self.caches[cache];

        let heads = self.dims().heads;
        let head_width = x.len() / heads;
        let by_lag = self.weights.get(&name("score"), "bias");
        let mut context = vec![0.0; x.len()];
        for head in 0..heads {
            let columns = head * head_width..(head + 1) * head_width;
            let lags = by_lag[head * self.dims().window..].iter();
            let scores = frames.iter().zip(lags).map(|(frame, bias)| {
                dot(&query[columns.clone()], &frame.key[columns.clone()]) / (head_width as f32).sqrt() + bias
            });
            let weights = softmax(scores.collect());
            for (frame, weight) in frames.iter().zip(weights) {
                for column in columns.clone() {
                    context[column] += weight * frame.value[column];
                }
            }
        }
        let projected = self.dense(&name("out"), &context);
        let sum: Vec<f32> = x.iter().zip(projected).map(|(x, y)| x + y).collect();
        self.see(&name("residual"), &sum);
        let norm = name("norm");
        layer_norm(&sum, self.weights.get(&norm, "gamma"), self.weights.get(&norm, "beta"))
    }
}

/// Q2.13 to real.
pub fn log_mel_real(q13: i16) -> f32 {
    f32::from(q13) / (1 << slipsense::features::STANDARDISED_FRAC_BITS) as f32
}

fn dot(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

pub(crate) fn keep_max(best: &mut Option<Vec<f32>>, new: Vec<f32>) {
    match best {
        None => *best = Some(new),
        Some(best) => best.iter_mut().zip(new).for_each(|(best, new)| *best = best.max(new)),
    }
}

fn softmax(mut scores: Vec<f32>) -> Vec<f32> {
    let max = scores.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    scores.iter_mut().for_each(|s| *s = (*s - max).exp());
    let sum: f32 = scores.iter().sum();
    scores.iter_mut().for_each(|s| *s /= sum);
    scores
}

fn layer_norm(x: &[f32], gamma: &[f32], beta: &[f32]) -> Vec<f32> {
    let n = x.len() as f32;
    let mean = x.iter().sum::<f32>() / n;
    let variance = x.iter().map(|x| (x - mean).powi(2)).sum::<f32>() / n;
    let scale = 1.0 / (variance + NORM_EPSILON as f32).sqrt();
    x.iter().zip(gamma.iter().zip(beta)).map(|(x, (gamma, beta))| (x - mean) * scale * gamma + beta).collect()
}
