//! The network in float for training: whole sequences at once, under a banded causal mask.
//!
//! A frame's keys and values depend on that frame alone and every attention sees the last `window`
//! frames, so this computes what the streaming network computes frame by frame (`tests/streaming.rs`).

use std::cell::RefCell;

use burn::module::{Module, Param, ParamId};
use burn::optim::GradientsParams;
use burn::tensor::activation::{log_softmax, relu, softmax};
use burn::tensor::module::layer_norm;
use burn::tensor::{Device, Int, Tensor};
use slipsense::net::format::{Dims, TensorSpec};
use slipsense::params::{CLASSES, OUTPUTS, XL_FEATURES};

use crate::detector_loss;
use crate::device::{numbers, tensor};
use crate::piezo::{self, Filters, Tape};
use crate::target::Target;
use crate::weights::Weights;

/// Added to the variance in LayerNorm.
pub const NORM_EPSILON: f64 = 1e-5;

/// Added to the score of a frame that must not be seen.
const UNSEEN: f32 = -1e9;

/// Scores of the attentions above this count in the loss, and what a nat of their mean excess counts. Scores of thousands
/// of nats give one frame all the weight: nothing more is learned from the others, and the smallest rounding chooses
/// another (Zhai et al., arXiv 2303.06296).
const SCORE_NAT: f32 = 20.0;
const SCORE_EXCESS_WEIGHT: f32 = 2e-3;

/// What a teacher's probabilities count in the loss where there is one; the labels count the rest.
const TAUGHT_SHARE: f32 = 0.5;

/// How parameters make logits: [`Dims`] is the shipped network in any size, a `Variant` is compared with it.
pub trait Architecture {
    /// Names and shapes of the parameters. Without [`piezo::LAYERS`] the network does not see the pads.
    fn specs(&self) -> Vec<TensorSpec>;

    /// Outputs of every frame, `[batch, frame, output]`. `features`: of every scan's taxels, `[image, feature]`;
    /// none where the network does not see the pads.
    fn forward(&self, graph: &Graph<'_>, input: &Sequences, features: Option<Tensor<2>>) -> Tensor<3>;
}

/// Loss, nat, and the gradients of all parameters.
pub type Step = (f64, GradientsParams);

#[derive(Module, Debug)]
pub struct FloatNetwork {
    /// One flat run per entry of [`Architecture::specs`]; shaped where it is used.
    parameters: Vec<Param<Tensor<1>>>,
}

/// A batch of sequences of equal length, plain numbers.
#[derive(Clone, Debug, Default)]
pub struct Sequences {
    pub batch: usize,
    pub sensors: usize,
    pub frames: usize,
    /// Counts and their change, `[batch, sensor, frame, 32 · 32, 2]`.
    pub piezo: Vec<i16>,
    /// Features of the accelerometers as real numbers, `[batch, sensor, frame, 32]`.
    pub xl: Vec<f32>,
    /// Classes, `[batch, frame]`.
    pub label: Vec<u8>,
    /// What each frame counts in the loss, `[batch, frame]`.
    pub weight: Vec<f32>,
    /// What the detector is to say of each frame, `[batch, frame]`.
    pub target: Vec<Target>,
    /// What the surest frame of an onset and the worst of a stretch without slip count in addition, if anything.
    pub extreme_weight: Option<f32>,
    /// Probabilities of the classes by a teacher, `[batch, frame, class]`; empty without one.
    pub taught: Vec<f32>,
}

impl FloatNetwork {
    /// To be trained on a device with automatic gradients, to be run on a plain one.
    pub fn new(weights: &Weights, device: &Device) -> Self {
        let parameter = |(index, values): (usize, &Vec<f32>)| {
            let values = tensor::<1>(values.clone(), [values.len()], device);
            let values = if device.is_autodiff() { values.require_grad() } else { values };
            // A fixed identity per tensor lets a resumed run find its optimizer state.
            Param::initialized(ParamId::from(index as u64 + 1), values)
        };
        Self { parameters: weights.tensors.iter().enumerate().map(parameter).collect() }
    }

    pub fn weights(&self, dims: Dims) -> Weights {
        Weights { dims, tensors: self.parameters.iter().map(|parameter| numbers(parameter.val())).collect() }
    }

    pub(crate) fn device(&self) -> Device {
        self.parameters[0].val().device()
    }

    pub(crate) fn graph(&self, architecture: &impl Architecture) -> Graph<'_> {
        Graph {
            parameters: &self.parameters,
            specs: architecture.specs(),
            device: self.device(),
            score_excess: RefCell::default(),
        }
    }

    /// Outputs of every frame, `[batch, frame]`, of a network that is to be run.
    pub fn outputs(&self, architecture: &impl Architecture, input: &Sequences) -> Vec<[f32; OUTPUTS]> {
        plain(self.run(architecture, input))
    }

    /// Probabilities of the classes of every frame, `[batch, frame, class]`, of a network that is to be run.
    pub fn probabilities(&self, architecture: &impl Architecture, input: &Sequences) -> Vec<f32> {
        numbers(softmax(classes(self.run(architecture, input)), 2))
    }

    fn run(&self, architecture: &impl Architecture, input: &Sequences) -> Tensor<3> {
        let graph = self.graph(architecture);
        let features = graph.filters().map(|filters| graph.features(&filters, input).0);
        architecture.forward(&graph, input, features)
    }

    /// Of a batch, by a network that is to be trained.
    pub fn gradients(&self, architecture: &impl Architecture, input: &Sequences) -> Step {
        let graph = self.graph(architecture);
        let seen = graph.filters().map(|filters| {
            let (features, tape) = graph.features(&filters, input);
            (filters, tape, features.require_grad())
        });
        let features = seen.as_ref().map(|(_, _, features)| features.clone());
        let outputs = architecture.forward(&graph, input, features);
        let mut loss = Self::loss(outputs, input);
        for excess in graph.score_excess.take() {
            loss = loss + excess.mul_scalar(SCORE_EXCESS_WEIGHT);
        }
        let value = f64::from(loss.clone().into_scalar::<f32>());
        let mut gradients = loss.backward();
        let Some((filters, tape, features)) = seen else {
            return (value, GradientsParams::from_grads(gradients, self));
        };
        let of_features = features.grad_remove(&mut gradients).expect("the loss depends on the features");
        let of_filters = piezo::backward(&filters, &input.piezo, &tape, &numbers(of_features));
        let mut all = GradientsParams::from_grads(gradients, self);
        let plain_device = graph.device.clone().inner();
        for (part, gradients) in [("weight", of_filters.weight), ("bias", of_filters.bias)] {
            for (layer, gradient) in piezo::LAYERS.into_iter().zip(gradients) {
                let id = self.parameters[graph.index(layer, part)].id;
                let length = gradient.len();
                all.register(id, tensor::<1>(gradient, [length], &plain_device));
            }
        }
        (value, all)
    }

    /// Cross entropy of the classes against the labels and the teacher, the weighted mean over all frames, and the
    /// detector's [loss](detector_loss), nat.
    pub(crate) fn loss(outputs: Tensor<3>, input: &Sequences) -> Tensor<1> {
        let log_odds = outputs.clone().narrow(2, CLASSES, 1);
        let of_detector = detector_loss::loss(log_odds, &input.target, input.extreme_weight);
        let logits = classes(outputs);
        let [b, l, classes] = logits.dims();
        let mut truth = vec![0f32; b * l * classes];
        let total: f32 = input.weight.iter().sum();
        for ((row, &class), &weight) in truth.chunks_exact_mut(classes).zip(&input.label).zip(&input.weight) {
            row[class as usize] = weight / total;
        }
        let rows = truth.chunks_exact_mut(classes).zip(input.taught.chunks_exact(classes));
        for ((row, taught), &weight) in rows.zip(&input.weight) {
            for (truth, &probability) in row.iter_mut().zip(taught) {
                *truth += TAUGHT_SHARE * (probability * weight / total - *truth);
            }
        }
        let truth = tensor::<3>(truth, [b, l, classes], &logits.device());
        (log_softmax(logits, 2) * truth).sum().neg() + of_detector
    }
}

/// The logits of the classes, without the detector's output.
fn classes(outputs: Tensor<3>) -> Tensor<3> {
    outputs.narrow(2, 0, CLASSES)
}

/// Outputs as plain numbers, `[batch, frame]`.
pub(crate) fn plain(outputs: Tensor<3>) -> Vec<[f32; OUTPUTS]> {
    numbers(outputs).as_chunks().0.to_vec()
}

/// Which frames an attention sees, and at what lag. Sequences are cut into chunks as long as the window: a
/// chunk's frames see it and the one before, and the work grows with the length, not with its square.
pub(crate) struct Band {
    /// Lag of each frame of a chunk to each of the one before and its own, `[window · 2 window]`; clamped if masked.
    lag: Tensor<1, Int>,
    /// 0 where seen, [`UNSEEN`] elsewhere, `[1, 1, chunk, window, 2 window]`.
    mask: Tensor<5>,
    chunks: usize,
}

impl Band {
    pub(crate) fn new(frames: usize, window: usize, device: &Device) -> Self {
        let chunks = frames.div_ceil(window);
        let pairs = || (0..window).flat_map(|t| (0..2 * window).map(move |j| (t, j)));
        // Frame t of a chunk is number window + t of the two.
        let lag = pairs().map(|(t, j)| (window + t).saturating_sub(j).min(window - 1) as i32);
        let lag = Tensor::from_data(&lag.collect::<Vec<_>>()[..], device);
        let seen = |chunk: usize, (t, j): (usize, usize)| {
            let in_band = j <= window + t && window + t - j < window;
            let exists = chunk > 0 || j >= window;
            if in_band && exists { 0.0 } else { UNSEEN }
        };
        let mask = (0..chunks).flat_map(|chunk| pairs().map(move |pair| seen(chunk, pair)));
        let mask = tensor(mask.collect(), [1, 1, chunks, window, 2 * window], device);
        Self { lag, mask, chunks }
    }
}

/// The parameters with their names, and the layers made of them.
pub struct Graph<'a> {
    parameters: &'a [Param<Tensor<1>>],
    specs: Vec<TensorSpec>,
    pub(crate) device: Device,
    /// Mean excess of each attention's scores over [`SCORE_NAT`].
    score_excess: RefCell<Vec<Tensor<1>>>,
}

impl Graph<'_> {
    fn index(&self, layer: &str, part: &str) -> usize {
        let index = self.specs.iter().position(|spec| spec.layer == layer && spec.part == part);
        index.expect("names come from the architecture")
    }

    /// A parameter, `[row, column]`; a vector is one row.
    pub(crate) fn get(&self, layer: &str, part: &str) -> Tensor<2> {
        let index = self.index(layer, part);
        self.parameters[index].val().reshape([self.specs[index].rows, self.specs[index].cols])
    }

    /// The convolution blocks' parameters, which [`piezo`] runs; none where the network does not see the pads.
    fn filters(&self) -> Option<Filters> {
        self.specs.iter().find(|spec| spec.layer == piezo::LAYERS[0])?;
        let values = |part| piezo::LAYERS.map(|layer| numbers(self.get(layer, part)));
        Some(Filters { weight: values("weight"), bias: values("bias") })
    }

    /// Features of every scan, `[image, feature]`, and what their gradients need.
    fn features(&self, filters: &Filters, input: &Sequences) -> (Tensor<2>, Tape) {
        let (features, tape) = piezo::forward(filters, &input.piezo);
        let images = input.batch * input.sensors * input.frames;
        (tensor(features, [images, filters.features()], &self.device), tape)
    }

    /// `[n, inputs]` to `[n, outputs]`.
    pub(crate) fn dense(&self, layer: &str, x: Tensor<2>) -> Tensor<2> {
        x.matmul(self.get(layer, "weight").transpose()) + self.get(layer, "bias")
    }

    /// Outputs `[batch, frame, output]` of hidden vectors `[batch, frame, width]`.
    pub(crate) fn head(&self, layer: &str, hidden: Tensor<3>) -> Tensor<3> {
        let [b, l, width] = hidden.dims();
        self.dense(layer, hidden.reshape([b * l, width])).reshape([b, l, OUTPUTS])
    }

    /// Embeddings `[batch · sensor · frame, embed]` of every frame's `values`, `[batch, sensor, frame, 32]`.
    pub(crate) fn xl(&self, values: &[f32], frames: usize) -> Tensor<2> {
        let sequences = values.len() / (frames * XL_FEATURES);
        let seen = self.specs[self.index("xl.conv", "weight")].cols;
        let taps = seen / XL_FEATURES;
        let x = tensor::<3>(values.to_vec(), [sequences, frames, XL_FEATURES], &self.device);
        // Each row: the frames up to this one, oldest first, zeros before the start.
        let x = x.pad([(taps - 1, 0), (0, 0)], 0.0);
        let x = Tensor::cat((0..taps).map(|tap| x.clone().narrow(1, tap, frames)).collect(), 2);
        let x = relu(self.dense("xl.conv", x.reshape([sequences * frames, seen])));
        let x = relu(self.dense("xl.mix1", x));
        self.dense("xl.mix2", x)
    }

    /// `LayerNorm(x + Wo · context)`; `x` asks, `seen` answers, both `[batch, frame, width]`.
    pub(crate) fn attention(&self, block: &str, x: Tensor<3>, seen: Tensor<3>, band: &Band) -> Tensor<3> {
        let [b, l, width] = x.dims();
        let by_lag = self.get(&format!("{block}.score"), "bias");
        let [heads, window] = by_lag.dims();
        let (head_width, chunks) = (width / heads, band.chunks);
        // [batch, head, chunk, frame of the chunk, column]
        let project = |part: &str, x: Tensor<3>| {
            let y = self.dense(&format!("{block}.{part}"), x.reshape([b * l, width])).reshape([b, l, width]);
            y.pad([(0, chunks * window - l), (0, 0)], 0.0)
                .reshape([b, chunks * window, heads, head_width])
                .swap_dims(1, 2)
                .reshape([b, heads, chunks, window, head_width])
        };
        // Each chunk behind the one before it.
        let with_before = |x: Tensor<5>| {
            let before = x.clone().pad([(1, 0), (0, 0), (0, 0)], 0.0).narrow(2, 0, chunks);
            Tensor::cat(vec![before, x], 3)
        };
        let query = project("query", x.clone());
        let key = with_before(project("key", seen.clone()));
        let value = with_before(project("value", seen));
        let bias = by_lag.select(1, band.lag.clone()).reshape([1, heads, 1, window, 2 * window]);
        let scale = 1.0 / (head_width as f32).sqrt();
        let product = query.matmul(key.swap_dims(3, 4)).mul_scalar(scale);
        self.score_excess.borrow_mut().push(relu(product.clone().abs() - SCORE_NAT).mean());
        let scores = product + bias + band.mask.clone();
        let context = softmax(scores, 4).matmul(value).reshape([b, heads, chunks * window, head_width]);
        let context = context.narrow(2, 0, l).swap_dims(1, 2).reshape([b * l, width]);
        let sum = x.reshape([b * l, width]) + self.dense(&format!("{block}.out"), context);
        let norm = format!("{block}.norm");
        let [gamma, beta] = ["gamma", "beta"].map(|part| self.get(&norm, part).reshape([width]));
        layer_norm(sum, gamma, Some(beta), NORM_EPSILON).reshape([b, l, width])
    }
}
