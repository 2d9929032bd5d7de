//! The trained parameters as plain numbers, named like the tensors of the model file.
//!
//! One list serves the tensor library, the frame-by-frame network, the checkpoint and the quantizer:
//! [`slipsense::net::format::layout`] without its integer-only parts (multipliers, residual factor and epsilon).

use std::collections::HashMap;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use safetensors::{Dtype, SafeTensors};
use slipsense::net::format::{Dims, TensorSpec, layout};

use crate::{output, tensors_file};

/// Sizes of the shipped model; its memory in every attention is 60 frames, 250 ms.
pub const FIRST_DIMS: Dims =
    Dims { conv_channels: [4, 8, 32], embed: 32, xl_kernel: 5, xl_channels: 48, heads: 4, window: 60 };

/// [`FIRST_DIMS`] with `size` times the channels, filters and embeddings, but no more filters in the third convolution.
pub const fn dims_of_size(size: usize) -> Dims {
    let [first, second, third] = FIRST_DIMS.conv_channels;
    Dims {
        conv_channels: [size * first, size * second, third],
        embed: size * FIRST_DIMS.embed,
        xl_channels: size * FIRST_DIMS.xl_channels,
        ..FIRST_DIMS
    }
}

/// Key of the dimensions in the metadata of a weights file.
const DIMS_KEY: &str = "slipsense.dims";

/// Names and shapes of the trained parameters, in the order of the model file.
pub fn specs(dims: &Dims) -> Vec<TensorSpec> {
    layout(dims)
        .into_iter()
        .filter(|spec| !matches!(spec.part, "multiplier" | "residual" | "epsilon"))
        .collect()
}

/// `layer.part`, the name in a weights file.
pub fn name(spec: &TensorSpec) -> String {
    format!("{}.{}", spec.layer, spec.part)
}

/// Lowest first value of a score's bias, nat: e^-16 is nothing, and the model file holds down to -22.
const LAG_BIAS_MIN: f32 = -16.0;

/// First value of a score's bias: every head but the last prefers recent frames, each four times less
/// than the one before (half-lives of 1.4, 5.5, 22 frames). From an even start the network averages its
/// whole window and notices a slip only when all of it slips, 60 frames late.
fn lag_bias(head: usize, lag: usize) -> f32 {
    let slope = if head < 3 { 0.5 / 4f32.powi(head as i32) } else { 0.0 };
    (-slope * lag as f32).max(LAG_BIAS_MIN)
}

/// Parameters before training: weights uniform with variance 2 / inputs ahead of a ReLU and 1 / inputs
/// elsewhere, norms neutral, biases zero but for the lags ([`lag_bias`]).
pub fn first_values(specs: &[TensorSpec], seed: u64) -> Vec<Vec<f32>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let tensor = |spec: &TensorSpec| match spec.part {
        "weight" => {
            let before_relu =
                spec.layer.starts_with("piezo.conv") || matches!(spec.layer, "xl.conv" | "xl.mix1");
            let limit = ((if before_relu { 6.0 } else { 3.0 }) / spec.cols as f32).sqrt();
            (0..spec.len()).map(|_| rng.random_range(-limit..limit)).collect()
        }
        "gamma" => vec![1.0; spec.len()],
        "bias" if spec.layer.ends_with(".score") => {
            (0..spec.rows).flat_map(|head| (0..spec.cols).map(move |lag| lag_bias(head, lag))).collect()
        }
        _ => vec![0.0; spec.len()],
    };
    specs.iter().map(tensor).collect()
}

/// Move numbers towards `newer`, as [`Weights::average`].
pub(crate) fn approach(mine: &mut [f32], newer: &[f32], decay: f32) {
    for (mine, newer) in mine.iter_mut().zip(newer) {
        *mine += (1.0 - decay) * (newer - *mine);
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct Weights {
    pub dims: Dims,
    /// One run of numbers per entry of [`specs`], row by row.
    pub tensors: Vec<Vec<f32>>,
}

impl Weights {
    /// Before training, see [`first_values`].
    pub fn init(dims: Dims, seed: u64) -> Self {
        Self { dims, tensors: first_values(&specs(&dims), seed) }
    }

    /// Numbers in all tensors.
    pub fn count(&self) -> usize {
        self.tensors.iter().map(Vec::len).sum()
    }

    /// The numbers of a tensor, such as `("piezo.conv1", "weight")`. Panics at names that the layout does not have.
    pub fn get(&self, layer: &str, part: &str) -> &[f32] {
        let index = specs(&self.dims).iter().position(|spec| spec.layer == layer && spec.part == part);
        &self.tensors[index.unwrap_or_else(|| panic!("there is no tensor {layer}.{part}"))]
    }

    /// Move towards `newer`: `self = decay · self + (1 − decay) · newer`.
    pub fn average(&mut self, newer: &Self, decay: f32) {
        for (mine, newer) in self.tensors.iter_mut().zip(&newer.tensors) {
            approach(mine, newer, decay);
        }
    }

    /// The mean of networks of the same sizes, summed in double precision. Panics if there is none.
    pub fn mean(all: &[Self]) -> Self {
        let mut mean = all[0].clone();
        for (tensor, values) in mean.tensors.iter_mut().enumerate() {
            for (index, value) in values.iter_mut().enumerate() {
                let sum: f64 = all.iter().map(|one| f64::from(one.tensors[tensor][index])).sum();
                *value = (sum / all.len() as f64) as f32;
            }
        }
        mean
    }

    /// The bytes of a safetensors file: f32, shape `[rows, cols]`, sizes in the metadata.
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        let fields = serde_json::to_string(&self.dims.to_fields())?;
        let tensors = specs(&self.dims).into_iter().zip(&self.tensors).map(|(spec, values)| {
            (name(&spec), Dtype::F32, vec![spec.rows, spec.cols], tensors_file::bytes_of(values))
        });
        tensors_file::to_bytes(tensors, Some(HashMap::from([(DIMS_KEY.to_owned(), fields)])))
    }

    /// Read a weights file's bytes; refuses a missing, misshapen or non-finite tensor by name.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self> {
        let (_, header) = SafeTensors::read_metadata(bytes).context("not a safetensors file")?;
        let fields = header.metadata().as_ref().and_then(|m| m.get(DIMS_KEY));
        let fields = fields.with_context(|| format!("metadata has no {DIMS_KEY}: not SlipSense weights"))?;
        let fields: [usize; 8] = serde_json::from_str(fields)
            .with_context(|| format!("metadata {DIMS_KEY} must be 8 integers"))?;
        let dims = Dims::from_fields(fields)?;
        let file = SafeTensors::deserialize(bytes)?;
        let mut tensors = Vec::new();
        for spec in specs(&dims) {
            let name = name(&spec);
            let view = file.tensor(&name).with_context(|| format!("tensor {name} is missing"))?;
            let values = tensors_file::finite(&name, &view)?;
            let shape = [spec.rows, spec.cols];
            ensure!(view.shape() == shape, "tensor {name} has shape {:?}, must be {shape:?}", view.shape());
            tensors.push(values);
        }
        Ok(Self { dims, tensors })
    }

    pub fn read(path: &Path) -> Result<Self> {
        Self::from_bytes(&output::read(path)?).with_context(|| format!("cannot use {}", path.display()))
    }

    pub fn write(&self, path: &Path) -> Result<()> {
        output::write(path, &self.to_bytes()?)
    }
}
