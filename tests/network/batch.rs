//! The network over a whole sequence at once, under a banded causal mask: no cache, no ring, 64-bit
//! sums, indices written out. Every sum asserts that it would have fitted 32 bits.

use super::inputs::Sensor;
use slipsense::net::format::Dims;
use slipsense::params::{OUTPUTS, XL_FEATURES};
use slipsense_recording::model_file::ModelFile;

fn scale(acc: i64, multiplier: i32) -> i64 {
    assert!(i32::try_from(acc).is_ok(), "accumulator {acc} leaves 32 bits");
    // floor(x / 2^32 + 1/2), the rounding rule, in 128 bits.
    ((i128::from(acc) * i128::from(multiplier) + (1 << 31)).div_euclid(1 << 32)) as i64
}

struct Oracle<'m> {
    file: &'m ModelFile,
}

impl Oracle<'_> {
    fn accumulators(&self, layer: &str, x: &[i64]) -> Vec<i64> {
        let bias = self.file.tensor(layer, "bias");
        let weight = self.file.tensor(layer, "weight");
        let dot = |row: &[i32]| row.iter().zip(x).map(|(&w, &x)| i64::from(w) * x).sum::<i64>();
        bias.iter().zip(weight.chunks(x.len())).map(|(&bias, row)| i64::from(bias) + dot(row)).collect()
    }

    fn dense(&self, layer: &str, x: &[i64], low: i64, high: i64) -> Vec<i64> {
        let multiplier = self.file.tensor(layer, "multiplier");
        let acc = self.accumulators(layer, x);
        acc.iter().zip(multiplier).map(|(&acc, &m)| scale(acc, m).clamp(low, high)).collect()
    }

    /// One place of a convolution: the accumulator holds the bias and twice the products. The output has 14 bits if the
    /// next convolution takes it, 15 behind the last.
    fn convolution(&self, layer: &str, patch: &[i64]) -> Vec<i64> {
        let twice: Vec<i64> = patch.iter().map(|x| 2 * x).collect();
        let most = if layer == "piezo.conv3" { 32767 } else { 16383 };
        self.dense(layer, &twice, 0, most)
    }

    /// `x[row][col][channel]`, pooled after requantization, as the textbook has it.
    fn conv_block(&self, layer: &str, x: &[Vec<Vec<i64>>]) -> Vec<Vec<Vec<i64>>> {
        let side = x.len();
        let channels = x[0][0].len();
        let at = |row: isize, col: isize, channel: usize| {
            let inside = row >= 0 && col >= 0 && row < side as isize && col < side as isize;
            if inside { x[row as usize][col as usize][channel] } else { 0 }
        };
        let mut pooled = vec![vec![Vec::new(); side / 2]; side / 2];
        for (row, col) in (0..side).flat_map(|row| (0..side).map(move |col| (row, col))) {
            let mut patch = Vec::new();
            for (ky, kx) in (-1..=1).flat_map(|ky| (-1..=1).map(move |kx| (ky, kx))) {
                patch.extend((0..channels).map(|c| at(row as isize + ky, col as isize + kx, c)));
            }
            let outputs = self.convolution(layer, &patch);
            let most: &mut Vec<i64> = &mut pooled[row / 2][col / 2];
            // No output is negative.
            most.resize(outputs.len(), 0);
            most.iter_mut().zip(outputs).for_each(|(most, output)| *most = output.max(*most));
        }
        pooled
    }

    /// One sensor's embeddings over its whole sequence.
    fn piezo(&self, frames: &[&Sensor]) -> Vec<Option<Vec<i64>>> {
        // Per taxel, 1/16 count; none before the first scan and behind a gap.
        let mut average: Option<Vec<i64>> = None;
        let mut embeddings = Vec::new();
        for sensor in frames {
            let Some(frame) = &sensor.piezo else {
                average = None;
                embeddings.push(None);
                continue;
            };
            let x: Vec<i64> = frame.counts().iter().map(|&c| 16 * i64::from(c)).collect();
            let before = average.unwrap_or_else(|| x.clone());
            // Below 942 counts in all, a pad looks like nothing.
            let touched = i64::from(x.iter().sum::<i64>() >= 16 * 942);
            let cells: Vec<Vec<i64>> = x
                .iter()
                .zip(&before)
                .map(|(x, a)| vec![touched * x / 16, touched * (x - a).div_euclid(2).clamp(-16384, 16383)])
                .collect();
            average =
                Some(x.iter().zip(&before).map(|(x, a)| a + (2 * (x - a) + 8).div_euclid(16)).collect());
            let mut map: Vec<Vec<Vec<i64>>> = cells.chunks(32).map(<[_]>::to_vec).collect();
            for layer in ["piezo.conv1", "piezo.conv2", "piezo.conv3"] {
                map = self.conv_block(layer, &map);
            }
            let flat: Vec<i64> = map.into_iter().flatten().flatten().collect();
            embeddings.push(Some(self.dense("piezo.dense", &flat, -32768, 32767)));
        }
        embeddings
    }

    /// `frames`: the sequence of one sensor, `t` the frame asked for.
    fn xl(&self, frames: &[&Sensor], t: usize) -> Option<Vec<i64>> {
        frames[t].xl?;
        let mut x = Vec::new();
        for back in (0..self.file.dims().xl_kernel).rev() {
            let seen = t.checked_sub(back).and_then(|u| frames[u].xl).unwrap_or([0; XL_FEATURES]);
            x.extend(seen.map(i64::from));
        }
        let hidden = self.dense("xl.conv", &x, 0, 32767);
        let hidden = self.dense("xl.mix1", &hidden, 0, 32767);
        Some(self.dense("xl.mix2", &hidden, -32768, 32767))
    }

    fn attention(&self, block: &str, queries: &[Vec<i64>], others: &[Vec<i64>]) -> Vec<Vec<i64>> {
        let Dims { heads, window, .. } = *self.file.dims();
        let part = |name: &str| format!("{block}.{name}");
        let width = queries[0].len();
        let head = width / heads;
        let keys: Vec<_> = others.iter().map(|x| self.dense(&part("key"), x, -8191, 8191)).collect();
        let values: Vec<_> = others.iter().map(|x| self.dense(&part("value"), x, -32768, 32767)).collect();
        let bias = self.file.tensor(&part("score"), "bias");
        let score = self.file.tensor(&part("score"), "multiplier")[0];
        let mut out = Vec::new();
        for (t, x) in queries.iter().enumerate() {
            let query = self.dense(&part("query"), x, -8191, 8191);
            let seen = (t + 1).saturating_sub(window)..t + 1;
            let mut context = vec![0i64; width];
            for h in 0..heads {
                let columns = h * head..(h + 1) * head;
                let score = |u: usize| {
                    let acc = columns.clone().map(|i| query[i] * keys[u][i]).sum();
                    scale(acc, score) + i64::from(bias[h * window + t - u])
                };
                let scores: Vec<i64> = seen.clone().map(score).collect();
                for (weight, u) in softmax(&scores).into_iter().zip(seen.clone()) {
                    for i in columns.clone() {
                        context[i] += weight * values[u][i];
                    }
                }
            }
            for context in &mut context {
                assert!(i32::try_from(*context).is_ok(), "context {context} leaves 32 bits");
                *context = (*context + (1 << 14)).div_euclid(1 << 15).clamp(-32768, 32767);
            }
            out.push(self.add_and_norm(&part("out"), &part("norm"), &context, x));
        }
        out
    }

    fn add_and_norm(&self, layer: &str, norm: &str, context: &[i64], x: &[i64]) -> Vec<i64> {
        let multiplier = self.file.tensor(layer, "multiplier");
        let acc = self.accumulators(layer, context);
        let (low, high) = (-(1 << 21), (1 << 21) - 1);
        let factor = i64::from(self.file.tensor(norm, "residual")[0]);
        let asked = |x: i64| (x * factor + (1 << 15)).div_euclid(1 << 16);
        let sum: Vec<i64> =
            (0..x.len()).map(|i| (asked(x[i]) + scale(acc[i], multiplier[i])).clamp(low, high)).collect();
        let n = x.len() as i64;
        let mean = (2 * sum.iter().sum::<i64>() + n).div_euclid(2 * n);
        let variance = sum.iter().map(|v| ((v - mean) * (v - mean)) as u64).sum::<u64>() / n as u64
            + self.file.tensor(norm, "epsilon")[0] as u64;
        // The root's 32 bits and the reciprocal's 31, then 2^54 · 2^zeros / root in units of 2^-11.
        let root = (variance << 16).isqrt();
        let zeros = u128::from(root).leading_zeros() - 96;
        let reciprocal = i128::from((1u64 << 62) / (root << zeros)).min((1 << 31) - 1);
        let (unit, half) = (1i128 << (43 - zeros), 1i128 << (42 - zeros));
        let scale_out = self.file.tensor(norm, "multiplier")[0];
        let (gamma, beta) = (self.file.tensor(norm, "gamma"), self.file.tensor(norm, "beta"));
        let output = |i: usize| {
            let standard = (i128::from(sum[i] - mean) * reciprocal + half).div_euclid(unit);
            let standard = standard.clamp(-32768, 32767) as i64;
            scale(standard * i64::from(gamma[i]) + i64::from(beta[i]), scale_out).clamp(-32768, 32767)
        };
        (0..x.len()).map(output).collect()
    }
}

/// 2^(s − max) from the definition of the table, not from the table.
fn softmax(scores: &[i64]) -> Vec<i64> {
    let max = *scores.iter().max().unwrap();
    let power = |s: &i64| {
        let below = max - s;
        let fraction = (2f64.powf(15.0 - (below & 1023) as f64 / 1024.0) + 0.5).floor() as i64;
        fraction >> (below >> 10).min(31)
    };
    let powers: Vec<i64> = scores.iter().map(power).collect();
    let reciprocal = (1i64 << 31) / powers.iter().sum::<i64>();
    powers.iter().map(|p| ((p * reciprocal + (1 << 15)) >> 16).min(32767)).collect()
}

fn maximum(embeddings: impl Iterator<Item = Option<Vec<i64>>>, width: usize) -> Vec<i64> {
    let max = |a: Vec<i64>, b: Vec<i64>| a.into_iter().zip(b).map(|(a, b)| a.max(b)).collect();
    embeddings.flatten().reduce(max).unwrap_or(vec![0; width])
}

/// Outputs of every frame of a sequence.
pub fn outputs(file: &ModelFile, frames: &[Vec<Sensor>]) -> Vec<[i32; OUTPUTS]> {
    let oracle = Oracle { file };
    let width = file.dims().embed;
    let by_sensor: Vec<Vec<&Sensor>> =
        (0..frames[0].len()).map(|s| frames.iter().map(|frame| &frame[s]).collect()).collect();
    let pads: Vec<_> = by_sensor.iter().map(|sequence| oracle.piezo(sequence)).collect();
    let piezo = |t: usize| maximum(pads.iter().map(|embeddings| embeddings[t].clone()), width);
    let xl = |t: usize| maximum(by_sensor.iter().map(|sequence| oracle.xl(sequence, t)), width);
    let piezo: Vec<Vec<i64>> = (0..frames.len()).map(piezo).collect();
    let xl: Vec<Vec<i64>> = (0..frames.len()).map(xl).collect();
    let first = oracle.attention("cross_piezo", &piezo, &xl);
    let second = oracle.attention("cross_xl", &xl, &piezo);
    let fused: Vec<Vec<i64>> = first.into_iter().zip(second).map(|(a, b)| [a, b].concat()).collect();
    let hidden = oracle.attention("temporal", &fused, &fused);
    let outputs = |x: &Vec<i64>| {
        let outputs = oracle.dense("head", x, -32768, 32767);
        std::array::from_fn(|output| outputs[output] as i32)
    };
    hidden.iter().map(outputs).collect()
}
