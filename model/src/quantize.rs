//! Float weights and measured ranges to the integers of the model file.
//!
//! Activations are 16 bits, those that a convolution takes 14, with one real scale per tensor, weights up to 16 bits
//! (a sum of three in a convolution) with one scale per output channel, as fine as the channel's 32-bit accumulator
//! allows, biases 32 bits at the accumulator's scale. What cannot be represented is refused by name; nothing is clipped
//! in silence.

use std::collections::BTreeMap;

use anyhow::{Result, ensure};
use slipsense::fixed::{Logit, QUERY_KEY_MAX, STANDARD_FRAC_BITS};
use slipsense::net::format::Dims;
use slipsense::net::layer_norm::{RESIDUAL_BITS, RESIDUAL_FACTOR_BITS};
use slipsense::net::model::ACTIVATION_MAX;
use slipsense::net::packing::Inputs;
use slipsense::net::softmax::SCORE_FRAC_BITS;
use slipsense::params::CONV_INPUT_MAX;
use slipsense_recording::model_file::ModelFile;

use crate::float::NORM_EPSILON;
use crate::piezo::{self, PIEZO_INPUT_SCALE};
use crate::trace::{ACTIVATIONS, Ranges};
use crate::tract::xl_real;
use crate::weights::Weights;

/// Room above the largest magnitude seen in calibration, for activations that grow with the pressure on the pads. The
/// largest come from contacts that begin at once; with the shipped weights a pad pressed to the end of its range gives 0.2 to 0.7 of them, one that
/// is pressed so from one frame to the next 0.7 to 2. What is above is cut. Every factor 2 costs a bit.
const PRESSURE_MARGIN: f64 = 1.5;
/// The same for activations behind LayerNorm or standardised log-mel bins, whose size has an end.
const BOUNDED_MARGIN: f64 = 2.0;
/// The same for sums before LayerNorm, which have bits to spare.
const RESIDUAL_MARGIN: f64 = 8.0;
/// The same for queries and keys, or what the scores' multiplier leaves ([`MULTIPLIER_RATIO_MAX`]), as the product of
/// their scales is that of the scores. Where it leaves less than was seen, the largest are cut: down to half of them,
/// because scores of that size leave one frame all the weight, cut or not.
const QUERY_KEY_MARGIN: f64 = 2.0;
/// Largest real ratio that a multiplier takes.
const MULTIPLIER_RATIO_MAX: f64 = I32_MAX / TWO_32;
/// Largest magnitude of an activation after requantization.
const I16_MAX: f64 = i16::MAX as f64;
/// Largest weight; −32768 is left unused so that a sign never changes the magnitude.
const WEIGHT_MAX: f64 = 32_767.0;
/// Largest magnitude that an accumulator may reach, and a number of 32 bits.
const I32_MAX: f64 = i32::MAX as f64;
/// Largest residual sum that LayerNorm takes.
const RESIDUAL_MAX: f64 = ((1 << (RESIDUAL_BITS - 1)) - 1) as f64;
/// Largest bias: half of the accumulator, the rest is for the products.
const BIAS_MAX: f64 = (1u32 << 30) as f64;
const TWO_32: f64 = 4_294_967_296.0;
/// Integers of a score per nat; scores are to the base 2.
const SCORE_UNITS_PER_NAT: f64 = std::f64::consts::LOG2_E * (1 << SCORE_FRAC_BITS) as f64;

/// Real value of one unit of every one of [`ACTIVATIONS`] after calibration on `ranges`. Refuses one that was always 0.
pub fn activation_scales(dims: &Dims, ranges: &Ranges) -> Result<BTreeMap<String, f64>> {
    let needs = |activation: &str, margin: f64, largest_int: f64| {
        let largest = f64::from(ranges.largest(activation)) * margin;
        ensure!(
            largest.is_finite() && largest > 0.0,
            "activation {activation}: largest magnitude in calibration is {largest}, must be positive"
        );
        Ok(largest / largest_int)
    };
    let scale = |activation: &str| match activation {
        "taxels" => Ok(f64::from(PIEZO_INPUT_SCALE)),
        "log_mel" => Ok(f64::from(xl_real(1))),
        "logits" => Ok(1.0 / f64::from(1 << Logit::FRAC_BITS)),
        other if other.ends_with(".residual") => needs(other, RESIDUAL_MARGIN, RESIDUAL_MAX),
        other if other.ends_with(".query") || other.ends_with(".key") => {
            needs(other, QUERY_KEY_MARGIN, f64::from(QUERY_KEY_MAX))
        }
        // The third one's map goes to a dense layer.
        map if piezo::LAYERS[..2].contains(&map) => needs(map, PRESSURE_MARGIN, f64::from(CONV_INPUT_MAX)),
        // What the accelerometers ask for are the pads' embeddings.
        "piezo.conv3" | "piezo" | "cross_xl.value" => needs(activation, PRESSURE_MARGIN, I16_MAX),
        other => needs(other, BOUNDED_MARGIN, I16_MAX),
    };
    let scales = ACTIVATIONS.iter().map(|&activation| Ok((activation.to_owned(), scale(activation)?)));
    let mut scales = scales.collect::<Result<BTreeMap<_, _>>>()?;
    for (block, width) in [("cross_piezo", 1), ("cross_xl", 1), ("temporal", 2)] {
        let parts = ["query", "key"].map(|part| format!("{block}.{part}"));
        let ratio = score_ratio(parts.each_ref().map(|part| scales[part]), width * dims.embed / dims.heads);
        // Both give up the same share of their room.
        let share = (MULTIPLIER_RATIO_MAX / ratio).sqrt().clamp(0.5 / QUERY_KEY_MARGIN, 1.0);
        for (_, scale) in scales.iter_mut().filter(|(name, _)| parts.contains(name)) {
            *scale *= share;
        }
    }
    Ok(scales)
}

/// What the product of a query's and a key's integers is in units of a score, by the real value of one unit of each.
fn score_ratio([query, key]: [f64; 2], head_width: usize) -> f64 {
    query * key / (head_width as f64).sqrt() * SCORE_UNITS_PER_NAT
}

/// `floor(x + 1/2)`, the project's rounding rule.
fn round(x: f64) -> f64 {
    (x + 0.5).floor()
}

/// A real ratio as a multiplier; refuses one of a half or more.
fn multiplier(ratio: f64, layer: &str, channel: usize) -> Result<i32> {
    let value = round(ratio * TWO_32);
    ensure!(
        (0.0..=I32_MAX).contains(&value),
        "{layer} multiplier channel {channel}: ratio {ratio:.4} is outside 0 to 0.5; the output's range is too small \
         for its weights"
    );
    Ok(value as i32)
}

/// Integers for one network. `provenance`: JSON text about how it was made.
pub fn quantize(weights: &Weights, ranges: &Ranges, provenance: &str) -> Result<ModelFile> {
    let scales = activation_scales(&weights.dims, ranges)?;
    let file = ModelFile::new(weights.dims, provenance);
    let mut quantizer = Quantizer { weights, scales, file };
    let [conv1, conv2, conv3] = piezo::LAYERS;
    quantizer.layer(conv1, "taxels", conv1)?;
    quantizer.layer(conv2, conv1, conv2)?;
    quantizer.layer(conv3, conv2, conv3)?;
    quantizer.layer("piezo.dense", conv3, "piezo")?;
    quantizer.layer("xl.conv", "log_mel", "xl.conv")?;
    quantizer.layer("xl.mix1", "xl.conv", "xl.mix1")?;
    quantizer.layer("xl.mix2", "xl.mix1", "xl")?;
    quantizer.attention("cross_piezo", ["piezo", "xl"], "fused")?;
    quantizer.attention("cross_xl", ["xl", "piezo"], "fused")?;
    quantizer.attention("temporal", ["fused", "fused"], "hidden")?;
    quantizer.layer("head", "hidden", "logits")?;
    Ok(quantizer.file)
}

struct Quantizer<'w> {
    weights: &'w Weights,
    /// Real value of one unit of every activation.
    scales: BTreeMap<String, f64>,
    file: ModelFile,
}

impl Quantizer<'_> {
    /// A dense layer or a convolution. `from`, `to`: the activations that it takes and gives.
    fn layer(&mut self, name: &str, from: &str, to: &str) -> Result<()> {
        let (from, to) = (self.scales[from], self.scales[to]);
        let bias = self.weights.get(name, "bias");
        let weight = self.weights.get(name, "weight");
        let inputs = self.file.inputs(name);
        // The accumulator holds a convolution's sums twice.
        let (gain, magnitude) = (f64::from(inputs.gain()), f64::from(inputs.magnitude()));
        // What rounding every weight to a whole step can add to a coefficient, steps.
        let rounded = if matches!(inputs, Inputs::Patch { .. }) { 1.5 } else { 0.0 };
        let (mut weights, mut biases, mut multipliers) = (Vec::new(), Vec::new(), Vec::new());
        for (channel, (row, &bias)) in weight.chunks_exact(inputs.count()).zip(bias).enumerate() {
            let (row, bias): (Vec<f64>, f64) = (row.iter().map(|&w| f64::from(w)).collect(), f64::from(bias));
            // The finest step that fits: what the file has of a weight in its 16 bits, the bias in its half of the
            // accumulator, and everything at its largest in the accumulator; rounding adds at most half a step per
            // weight, and half a unit for the bias.
            let weighted = gain * (row.iter().map(|w| w.abs()).sum::<f64>() * magnitude + bias.abs() / from);
            let rounding = gain * 0.5 * inputs.count() as f64 * magnitude + 1.0;
            let coefficients = (0..inputs.coefficients()).map(|index| inputs.coefficient(index, |i| row[i]));
            let largest = coefficients.fold(0.0, |m: f64, x| m.max(x.abs()));
            let step = (largest / (WEIGHT_MAX - rounded))
                .max(gain * bias.abs() / (from * BIAS_MAX))
                .max(weighted / (I32_MAX - rounding));
            // A channel of zeros: any step will do.
            let step = if step > 0.0 { step } else { to / from / 256.0 };
            weights.extend(row.iter().map(|w| round(w / step) as i32));
            biases.push(round(gain * bias / (from * step)) as i32);
            multipliers.push(multiplier(from * step / (gain * to), name, channel)?);
        }
        *self.file.tensor_mut(name, "weight") = weights;
        *self.file.tensor_mut(name, "bias") = biases;
        *self.file.tensor_mut(name, "multiplier") = multipliers;
        Ok(())
    }

    /// One attention block. `from`: the activations that ask and that answer; `to`: what it gives.
    fn attention(&mut self, block: &str, from: [&str; 2], to: &str) -> Result<()> {
        let name = |part: &str| format!("{block}.{part}");
        let [asks, answers] = from;
        self.layer(&name("query"), asks, &name("query"))?;
        self.layer(&name("key"), answers, &name("key"))?;
        self.layer(&name("value"), answers, &name("value"))?;
        // The context is a weighted mean of values: their scale, their range.
        self.layer(&name("out"), &name("value"), &name("residual"))?;
        let [query, key, residual] = ["query", "key", "residual"].map(|part| self.scales[&name(part)]);
        let to = self.scales[to];

        let score = name("score");
        let width = self.weights.get(&name("query"), "bias").len();
        let ratio = score_ratio([query, key], width / self.weights.dims.heads);
        *self.file.tensor_mut(&score, "multiplier") = vec![multiplier(ratio, &score, 0)?];
        let bias = self.weights.get(&score, "bias").iter().map(|&b| f64::from(b) * SCORE_UNITS_PER_NAT);
        self.set(&score, "bias", bias, I16_MAX)?;
        let factor = self.scales[asks] / residual * f64::from(1 << RESIDUAL_FACTOR_BITS);
        self.set(&name("norm"), "residual", [factor], I32_MAX)?;
        self.norm(&name("norm"), residual, to)
    }

    fn norm(&mut self, name: &str, residual: f64, to: f64) -> Result<()> {
        let gamma = self.weights.get(name, "gamma");
        let largest = gamma.iter().fold(0.0f64, |m, &g| m.max(f64::from(g).abs()));
        ensure!(largest > 0.0, "{name} gamma is all zero");
        let step = largest / I16_MAX;
        let unit = step / f64::from(1 << STANDARD_FRAC_BITS);
        self.set(name, "gamma", gamma.iter().map(|&g| f64::from(g) / step), I16_MAX)?;
        let beta = self.weights.get(name, "beta").iter().map(|&b| f64::from(b) / unit);
        self.set(name, "beta", beta, I32_MAX)?;
        let [gamma, beta] = ["gamma", "beta"].map(|part| self.file.tensor(name, part));
        for (channel, (&gamma, &beta)) in gamma.iter().zip(beta).enumerate() {
            let bound = i64::from(gamma).abs() * ACTIVATION_MAX + i64::from(beta).abs();
            ensure!(
                bound <= i64::from(i32::MAX),
                "{name} beta channel {channel}: accumulator can reach {bound}, more than {}",
                i32::MAX
            );
        }
        let epsilon = (NORM_EPSILON / (residual * residual)).max(1.0);
        *self.file.tensor_mut(name, "multiplier") = vec![multiplier(unit / to, name, 0)?];
        self.set(name, "epsilon", [epsilon], I32_MAX)
    }

    /// Round the numbers of a tensor; refuses those of magnitudes above `most` by tensor and position.
    fn set(
        &mut self,
        layer: &str,
        part: &str,
        values: impl IntoIterator<Item = f64>,
        most: f64,
    ) -> Result<()> {
        let one = |(index, value): (usize, f64)| {
            let value = round(value);
            ensure!(value.abs() <= most, "{layer} {part} {index} is {value}, must be within ±{most}");
            Ok(value as i32)
        };
        *self.file.tensor_mut(layer, part) =
            values.into_iter().enumerate().map(one).collect::<Result<_>>()?;
        Ok(())
    }
}
