//! SSAST-Tiny, an audio transformer: twelve layers of width 192, here with one token for each frame of 16 mel bins.
//!
//! Its first weights come from the authors' file where there is one ([`Ssast::with_authors`]), else from pretraining
//! on our own log-mel ([`SsastPretraining`]).

use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use burn::module::{Module, Param};
use burn::nn::transformer::{TransformerEncoder, TransformerEncoderInput};
use burn::nn::{LayerNorm, Linear, LinearConfig};
use burn::tensor::activation::{log_softmax, relu};
use burn::tensor::{Bool, Device, Int, Tensor, TensorData};
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use slipsense::params::MEL_BINS;

use super::named::{self, Named, Numbers};
use super::vit::{layers, norm};
use super::{EMBED, NORM_EPSILON};
use crate::device::tensor;
use crate::output;
use crate::weights::FIRST_DIMS;

const WIDTH: usize = 192;
const LAYERS: usize = 12;
/// Tokens ahead of the frames': class and distillation.
const EXTRA: usize = 2;
/// Frames that the positions are of.
const WINDOW: usize = FIRST_DIMS.window;
/// What the generative loss counts in pretraining, as in the authors' code.
const GENERATIVE: f32 = 10.0;
/// Share of the frames that are masked in pretraining; the authors mask 400 of 512 patches.
const MASKED: f64 = 0.75;
const _: () = assert!(NORM_EPSILON == 1e-6, "timm's, which the authors use");

#[derive(Module, Debug)]
pub struct Ssast {
    patch: Linear,
    /// Class and distillation, `[1, 2, width]`.
    tokens: Param<Tensor<3>>,
    /// Of both and every frame of a window.
    positions: Param<Tensor<3>>,
    encoder: TransformerEncoder,
    norm: LayerNorm,
    out: Linear,
}

impl Ssast {
    pub fn new(device: &Device) -> Self {
        Self {
            patch: LinearConfig::new(MEL_BINS, WIDTH).init(device),
            tokens: Param::from_tensor(Tensor::zeros([1, EXTRA, WIDTH], device)),
            positions: Param::from_tensor(Tensor::zeros([1, EXTRA + WINDOW, WIDTH], device)),
            encoder: layers(WIDTH, 3, LAYERS, device),
            norm: norm(WIDTH, device),
            out: LinearConfig::new(WIDTH, EMBED).init(device),
        }
    }

    /// Hidden vectors `[window, 2 + frame, width]` of both extra tokens and every frame `[window, frame, bin]`. With
    /// `causal` a frame sees itself and those before it, else all.
    pub fn hidden(&self, frames: Tensor<3>, causal: bool) -> Tensor<3> {
        self.run(self.patch.forward(frames), causal)
    }

    fn run(&self, patches: Tensor<3>, causal: bool) -> Tensor<3> {
        let [windows, frames, _] = patches.dims();
        let tokens = Tensor::cat(vec![self.tokens.val().repeat_dim(0, windows), patches], 1)
            + self.positions.val().narrow(1, 0, EXTRA + frames);
        let mut input = TransformerEncoderInput::new(tokens);
        if causal {
            let count = EXTRA + frames;
            let hidden = (0..count * count).map(|at| at % count >= EXTRA && at % count > at / count);
            let hidden = TensorData::new(hidden.collect(), [1, count, count]);
            let hidden = Tensor::<3, Bool>::from_data(hidden, &self.positions.val().device());
            input = input.mask_attn(hidden.expand([windows, count, count]));
        }
        self.norm.forward(self.encoder.forward(input))
    }

    /// Embeddings `[sequence, frame, embedding]` of sequences of any length: windows that overlap by a half, of each
    /// the second half, and of the first all. Every frame has 31 to 60 frames in view and none that is still to come.
    pub fn stream(&self, frames: Tensor<3>) -> Tensor<3> {
        let [sequences, length, _] = frames.dims();
        let half = WINDOW / 2;
        let count = length.saturating_sub(WINDOW).div_ceil(half) + 1;
        let padded = if count == 1 { length } else { half * (count + 1) };
        let frames = frames.pad([(0, padded - length), (0, 0)], 0.0);
        let window = padded.min(WINDOW);
        let windows = (0..count).map(|n| frames.clone().narrow(1, n * half, window)).collect();
        let hidden = self.hidden(Tensor::cat(windows, 0), true);
        let embedded = self.out.forward(hidden.narrow(1, EXTRA, window));
        let of = |n: usize, from: usize| {
            embedded.clone().narrow(0, n * sequences, sequences).narrow(1, from, window - from)
        };
        let all = (0..count).map(|n| of(n, if n == 0 { 0 } else { half })).collect();
        Tensor::cat(all, 1).narrow(1, 0, length)
    }

    /// The transformer of the authors' file, a state dict as safetensors; both projections stay as they are.
    pub fn with_authors(self, path: &Path) -> Result<Self> {
        let place = || format!("cannot use {}", path.display());
        let theirs = named::from_bytes(&output::read(path)?)
            .with_context(|| "a state dict must be converted first, as the book says")
            .with_context(place)?;
        let ours = converted(&theirs).with_context(place)?;
        Ok(named::put(self, &ours))
    }
}

/// The authors' tensors by our names: one layer of query, key and value becomes three, matrices are turned.
fn converted(theirs: &Named) -> Result<Named> {
    let find = |name: &str, shape: &[usize]| {
        let name = format!("v.{name}");
        let numbers = theirs.get(&format!("module.{name}")).or_else(|| theirs.get(&name));
        let numbers = numbers.with_context(|| format!("tensor {name} is missing: not SSAST-Tiny"))?;
        let found = &numbers.shape;
        ensure!(
            shape.is_empty() || found == shape,
            "tensor {name} has shape {found:?}, must be {shape:?} for SSAST-Tiny"
        );
        anyhow::Ok(numbers)
    };
    let mut ours = Named::new();
    let mut put = |name: String, shape: &[usize], values: Vec<f32>| {
        ours.insert(name, Numbers { shape: shape.to_vec(), values });
    };
    let [class, distillation] = ["cls_token", "dist_token"].map(|name| find(name, &[1, 1, WIDTH]));
    put("tokens".into(), &[1, EXTRA, WIDTH], [&class?.values[..], &distillation?.values].concat());
    put(
        "positions".into(),
        &[1, EXTRA + WINDOW, WIDTH],
        positions(find("pos_embed", &[])?, find("patch_embed.proj.weight", &[])?)?,
    );
    let mut norms = vec![("norm".to_owned(), "norm".to_owned())];
    for layer in 0..LAYERS {
        let (block, here) = (format!("blocks.{layer}"), format!("encoder.layers.{layer}"));
        // The tensor library's second norm is the one before the attention.
        norms.push((format!("{block}.norm1"), format!("{here}.norm_2")));
        norms.push((format!("{block}.norm2"), format!("{here}.norm_1")));
        let weight = find(&format!("{block}.attn.qkv.weight"), &[3 * WIDTH, WIDTH])?;
        let bias = find(&format!("{block}.attn.qkv.bias"), &[3 * WIDTH])?;
        for (part, name) in ["query", "key", "value"].into_iter().enumerate() {
            let rows = &weight.values[part * WIDTH * WIDTH..][..WIDTH * WIDTH];
            put(format!("{here}.mha.{name}.weight"), &[WIDTH, WIDTH], turned(rows, WIDTH));
            put(format!("{here}.mha.{name}.bias"), &[WIDTH], bias.values[part * WIDTH..][..WIDTH].to_vec());
        }
        for (theirs, name, [from, to]) in [
            ("attn.proj", "mha.output", [WIDTH, WIDTH]),
            ("mlp.fc1", "pwff.linear_inner", [WIDTH, 4 * WIDTH]),
            ("mlp.fc2", "pwff.linear_outer", [4 * WIDTH, WIDTH]),
        ] {
            let weight = find(&format!("{block}.{theirs}.weight"), &[to, from])?;
            put(format!("{here}.{name}.weight"), &[from, to], turned(&weight.values, from));
            let bias = find(&format!("{block}.{theirs}.bias"), &[to])?;
            put(format!("{here}.{name}.bias"), &[to], bias.values.clone());
        }
    }
    for (norm, here) in norms {
        for (theirs, name) in [("weight", "gamma"), ("bias", "beta")] {
            let numbers = find(&format!("{norm}.{theirs}"), &[WIDTH])?;
            put(format!("{here}.{name}"), &[WIDTH], numbers.values.clone());
        }
    }
    Ok(ours)
}

/// A matrix `[row, column]` with `columns` columns, `[column, row]`.
fn turned(values: &[f32], columns: usize) -> Vec<f32> {
    (0..columns).flat_map(|column| values[column..].iter().step_by(columns)).copied().collect()
}

/// Those of both extra tokens and of as many steps of time as a window has, from the middle as in the authors' code;
/// patches above each other share a step, which gets their mean.
fn positions(theirs: &Numbers, patch: &Numbers) -> Result<Vec<f32>> {
    let [1, count, WIDTH] = theirs.shape[..] else {
        bail!("tensor v.pos_embed has shape {:?}, must be [1, tokens, {WIDTH}]", theirs.shape)
    };
    let [WIDTH, 1, height, _] = patch.shape[..] else {
        bail!(
            "tensor v.patch_embed.proj.weight has shape {:?}, must be [{WIDTH}, 1, bins, frames]",
            patch.shape
        )
    };
    // The authors have 128 bins.
    let above = (128 / height.max(1)).max(1);
    let steps = count.saturating_sub(EXTRA) / above;
    ensure!(steps >= WINDOW, "tensor v.pos_embed has {steps} steps of time, fewer than {WINDOW}");
    let (extra, patches) = theirs.values.split_at(EXTRA * WIDTH);
    let first = steps / 2 - WINDOW / 2;
    let of = |step: usize, at: usize| {
        let all = (0..above).map(|row| patches[(row * steps + step) * WIDTH + at]);
        all.sum::<f32>() / above as f32
    };
    let middle = (first..first + WINDOW).flat_map(|step| (0..WIDTH).map(move |at| of(step, at)));
    Ok(extra.iter().copied().chain(middle).collect())
}

/// The encoder with what pretraining it on masked frames needs.
#[derive(Module, Debug)]
pub struct SsastPretraining {
    pub ssast: Ssast,
    mask: Param<Tensor<3>>,
    tell: Vec<Linear>,
    make: Vec<Linear>,
}

impl SsastPretraining {
    pub fn new(device: &Device) -> Self {
        let two = || [WIDTH, MEL_BINS].map(|to| LinearConfig::new(WIDTH, to).init(device)).into();
        let mask = Param::from_tensor(Tensor::zeros([1, 1, WIDTH], device));
        Self { ssast: Ssast::new(device), mask, tell: two(), make: two() }
    }

    /// Of windows `[window, frame, bin]`, some frames of each hidden: which of the hidden frames is which, and what
    /// its bins are, as in the authors' code.
    pub fn loss(&self, frames: Tensor<3>, rng: &mut ChaCha8Rng) -> Tensor<1> {
        let [windows, length, bins] = frames.dims();
        let device = frames.device();
        let hidden = ((length as f64 * MASKED) as usize).max(1);
        // The same frames of every window of a step.
        let mut order: Vec<usize> = (0..length).collect();
        order.shuffle(rng);
        let mut seen = vec![1.0; length];
        order[..hidden].iter().for_each(|&frame| seen[frame] = 0.0);
        let places: Vec<i32> = order[..hidden].iter().map(|&frame| frame as i32).collect();
        let places = Tensor::<1, Int>::from_data(&places[..], &device);
        let seen = tensor::<3>(seen, [1, length, 1], &device);
        let mask = self.mask.val() * seen.clone().neg().add_scalar(1.0);
        let patches = self.ssast.patch.forward(frames.clone()) * seen + mask;
        let tokens = self.ssast.run(patches, false).narrow(1, EXTRA, length).select(1, places.clone());
        let truth = frames.select(1, places);
        let through = |layers: &[Linear]| layers[1].forward(relu(layers[0].forward(tokens.clone())));
        let told = through(&self.tell).matmul(truth.clone().swap_dims(1, 2));
        let same = Tensor::<2>::eye(hidden, &device).reshape([1, hidden, hidden]);
        let count = (windows * hidden) as f32;
        let discriminative = (log_softmax(told, 2) * same).sum().neg().div_scalar(count);
        let generative = (through(&self.make) - truth).powi_scalar(2).sum().div_scalar(count * bins as f32);
        discriminative + generative.mul_scalar(GENERATIVE)
    }
}
