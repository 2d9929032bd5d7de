//! The network in float for training: whole sequences at once, under a banded causal mask.
//!
//! A frame's keys and values depend on that frame alone and every attention sees the last `window`
//! frames, so this computes what the streaming network computes frame by frame (`tests/streaming.rs`).

use burn::module::{Module, Param, ParamId};
use burn::tensor::activation::{log_softmax, relu, softmax};
use burn::tensor::module::{conv2d, layer_norm, max_pool2d};
use burn::tensor::ops::{ConvOptions, MaxPoolOptions};
use burn::tensor::{Device, Int, Tensor, TensorData};
use slipsense::net::format::Dims;
use slipsense::params::{CLASSES, MEL_BINS, TAXEL_COLS, TAXEL_ROWS, TAXELS};

use crate::weights::{Weights, specs};

/// Real value of one count at the first convolution: a linear factor, no information lost.
pub const PIEZO_INPUT_SCALE: f32 = 1.0 / 256.0;
/// Added to the variance in LayerNorm.
pub const NORM_EPSILON: f64 = 1e-5;

/// Added to the score of a frame that must not be seen.
const UNSEEN: f32 = -1e9;

/// The trainable network.
#[derive(Module, Debug)]
pub struct FloatNetwork {
    /// One flat run per entry of [`specs`]; shaped where it is used.
    parameters: Vec<Param<Tensor<1>>>,
}

/// A batch of sequences of equal length, plain numbers.
#[derive(Clone, Debug, Default)]
pub struct Sequences {
    /// Sequences.
    pub batch: usize,
    /// Sensors of every sequence.
    pub sensors: usize,
    /// Frames of every sequence.
    pub frames: usize,
    /// Counts times [`PIEZO_INPUT_SCALE`], `[batch, sensor, frame, 32 · 32]`.
    pub piezo: Vec<f32>,
    /// Standardised log-mel, `[batch, sensor, frame, 16]`.
    pub log_mel: Vec<f32>,
    /// Classes, `[batch, frame]`.
    pub label: Vec<u8>,
}

impl FloatNetwork {
    /// From plain numbers.
    pub fn new(weights: &Weights, device: &Device) -> Self {
        let parameter = |(index, tensor): (usize, &Vec<f32>)| {
            let data = TensorData::new(tensor.clone(), [tensor.len()]);
            let tensor = Tensor::<1>::from_data(data, device).require_grad();
            // A fixed identity per tensor lets a resumed run find its optimizer state.
            Param::initialized(ParamId::from(index as u64 + 1), tensor)
        };
        Self { parameters: weights.tensors.iter().enumerate().map(parameter).collect() }
    }

    /// To plain numbers.
    pub fn weights(&self, dims: Dims) -> Weights {
        let tensors = self.parameters.iter().map(|p| p.val().into_data().iter::<f32>().collect());
        Weights { dims, tensors: tensors.collect() }
    }

    /// Logits of every frame, `[batch, frame, class]`.
    pub fn forward(&self, dims: &Dims, input: &Sequences, device: &Device) -> Tensor<3> {
        let graph = Graph { parameters: &self.parameters, dims };
        let (b, l) = (input.batch, input.frames);
        let widest = |embedding: Tensor<2>| {
            embedding.reshape([b, input.sensors, l, dims.embed]).max_dim(1).reshape([b, l, dims.embed])
        };
        let piezo = widest(graph.piezo(input, device));
        let xl = widest(graph.xl(input, device));

        let band = Band::new(l, dims.window, device);
        let asks_xl = graph.attention("cross_piezo", piezo.clone(), xl.clone(), &band);
        let asks_piezo = graph.attention("cross_xl", xl, piezo, &band);
        let fused = Tensor::cat(vec![asks_xl, asks_piezo], 2);
        let hidden = graph.attention("temporal", fused.clone(), fused, &band);
        let logits = graph.dense("head", hidden.reshape([b * l, dims.fused()]));
        logits.reshape([b, l, CLASSES])
    }

    /// Mean cross entropy over all frames, nat.
    pub fn loss(logits: Tensor<3>, label: &[u8], device: &Device) -> Tensor<1> {
        let [b, l, classes] = logits.dims();
        let mut truth = vec![0f32; b * l * classes];
        for (row, &class) in truth.chunks_exact_mut(classes).zip(label) {
            row[class as usize] = 1.0;
        }
        let truth = tensor::<3>(truth, [b, l, classes], device);
        (log_softmax(logits, 2) * truth).sum().mul_scalar(-1.0 / (b * l) as f32)
    }
}

fn tensor<const D: usize>(values: Vec<f32>, shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values, shape), device)
}

/// Which frames an attention sees, and at what lag.
struct Band {
    /// Lag of every pair of frames, `[frame · frame]`; clamped where masked.
    lag: Tensor<1, Int>,
    /// 0 where seen, [`UNSEEN`] elsewhere, `[1, 1, frame, frame]`.
    mask: Tensor<4>,
    frames: usize,
}

impl Band {
    fn new(frames: usize, window: usize, device: &Device) -> Self {
        let pairs = (0..frames).flat_map(|t| (0..frames).map(move |j| (t, j)));
        let lag: Vec<i32> = pairs.clone().map(|(t, j)| t.saturating_sub(j).min(window - 1) as i32).collect();
        let seen = |(t, j): (usize, usize)| if j <= t && t - j < window { 0.0 } else { UNSEEN };
        let mask = tensor(pairs.map(seen).collect(), [1, 1, frames, frames], device);
        let lag = Tensor::from_data(TensorData::new(lag, [frames * frames]), device);
        Self { lag, mask, frames }
    }
}

/// The parameters with their names, and the layers made of them.
struct Graph<'a> {
    parameters: &'a [Param<Tensor<1>>],
    dims: &'a Dims,
}

impl Graph<'_> {
    fn get<const D: usize>(&self, layer: &str, part: &str, shape: [usize; D]) -> Tensor<D> {
        let specs = specs(self.dims);
        let index = specs.iter().position(|spec| spec.layer == layer && spec.part == part);
        self.parameters[index.expect("names come from the layout")].val().reshape(shape)
    }

    /// `[n, inputs]` to `[n, outputs]`.
    fn dense(&self, layer: &str, x: Tensor<2>) -> Tensor<2> {
        let [_, inputs] = x.dims();
        let spec = specs(self.dims).into_iter().find(|s| s.layer == layer && s.part == "weight");
        let outputs = spec.expect("names come from the layout").rows;
        let weight = self.get(layer, "weight", [outputs, inputs]);
        x.matmul(weight.transpose()) + self.get(layer, "bias", [1, outputs])
    }

    /// Embeddings of every frame of every sensor, `[batch · sensor · frame, embed]`.
    fn piezo(&self, input: &Sequences, device: &Device) -> Tensor<2> {
        let images = input.piezo.len() / TAXELS;
        let mut x = tensor::<4>(input.piezo.clone(), [images, 1, TAXEL_ROWS, TAXEL_COLS], device);
        let mut inputs = 1;
        for (block, outputs) in self.dims.conv_channels.into_iter().enumerate() {
            let layer = ["piezo.conv1", "piezo.conv2", "piezo.conv3"][block];
            let weight = self.get(layer, "weight", [outputs, 3, 3, inputs]).permute([0, 3, 1, 2]);
            let bias = self.get(layer, "bias", [outputs]);
            x = conv2d(x, weight, Some(bias), ConvOptions::new([1, 1], [1, 1], [1, 1], 1));
            // The pool before the ReLU: the same values with a quarter of the work.
            x = relu(max_pool2d(x, MaxPoolOptions::new([2, 2])));
            inputs = outputs;
        }
        let flat = x.permute([0, 2, 3, 1]).reshape([images, self.dims.piezo_features()]);
        self.dense("piezo.dense", flat)
    }

    /// Embeddings of every frame of every sensor, `[batch · sensor · frame, embed]`.
    fn xl(&self, input: &Sequences, device: &Device) -> Tensor<2> {
        let taps = self.dims.xl_kernel;
        let seen = taps * MEL_BINS;
        // Each row: the frames up to this one, oldest first, zeros before the start.
        let mut x = vec![0f32; input.log_mel.len() * taps];
        for (sequence, rows) in
            input.log_mel.chunks_exact(input.frames * MEL_BINS).zip(x.chunks_exact_mut(input.frames * seen))
        {
            for (t, row) in rows.chunks_exact_mut(seen).enumerate() {
                let frames = (t + 1).min(taps);
                let from = (t + 1 - frames) * MEL_BINS;
                row[seen - frames * MEL_BINS..].copy_from_slice(&sequence[from..(t + 1) * MEL_BINS]);
            }
        }
        let rows = input.log_mel.len() / MEL_BINS;
        let x = relu(self.dense("xl.conv", tensor::<2>(x, [rows, seen], device)));
        let x = relu(self.dense("xl.mix1", x));
        self.dense("xl.mix2", x)
    }

    /// `LayerNorm(x + Wo · context)`; `x` asks, `seen` answers, both `[batch, frame, width]`.
    fn attention(&self, block: &str, x: Tensor<3>, seen: Tensor<3>, band: &Band) -> Tensor<3> {
        let [b, l, width] = x.dims();
        let heads = self.dims.heads;
        let head_width = width / heads;
        let project = |part: &str, x: Tensor<3>| {
            let y = self.dense(&format!("{block}.{part}"), x.reshape([b * l, width]));
            y.reshape([b, l, heads, head_width]).swap_dims(1, 2)
        };
        let (query, key) = (project("query", x.clone()), project("key", seen.clone()));
        let value = project("value", seen);
        let by_lag = self.get(&format!("{block}.score"), "bias", [heads, self.dims.window]);
        let bias = by_lag.select(1, band.lag.clone()).reshape([1, heads, band.frames, band.frames]);
        let scale = 1.0 / (head_width as f32).sqrt();
        let scores = query.matmul(key.transpose()).mul_scalar(scale) + bias + band.mask.clone();
        let context = softmax(scores, 3).matmul(value).swap_dims(1, 2).reshape([b * l, width]);
        let sum = x.reshape([b * l, width]) + self.dense(&format!("{block}.out"), context);
        let norm = format!("{block}.norm");
        let (gamma, beta) = (self.get(&norm, "gamma", [width]), self.get(&norm, "beta", [width]));
        layer_norm(sum, gamma, Some(beta), NORM_EPSILON).reshape([b, l, width])
    }
}
