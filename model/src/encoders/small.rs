//! The small encoders: the paper's own CNN of a scan, and the MLP and the causal CNN of log-mel frames.

use burn::module::Module;
use burn::nn::conv::{Conv1d, Conv1dConfig, Conv2d, Conv2dConfig};
use burn::nn::pool::{MaxPool2d, MaxPool2dConfig};
use burn::nn::{BatchNorm, BatchNormConfig, Linear, LinearConfig, PaddingConfig1d, PaddingConfig2d};
use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slipsense::params::{MEL_BINS, TAXELS};

use super::EMBED;
use crate::device::tensor;
use crate::weights::FIRST_DIMS;

/// Channels of the three blocks. The paper names none; these make as many features as ours has taxels.
const CHANNELS: [usize; 3] = [16, 32, 64];
/// Hidden units of the MLP.
const HIDDEN: usize = 16;
/// Share of hidden units that are dropped in training. The paper names none.
const DROPPED: f64 = 0.1;

/// Three blocks of convolution, ReLU and pooling, and a dense layer.
#[derive(Module, Debug)]
pub struct CustomCnn {
    conv: Vec<Conv2d>,
    pool: MaxPool2d,
    fc: Linear,
}

impl CustomCnn {
    pub fn new(device: &Device) -> Self {
        let [first, second, third] = CHANNELS;
        let conv = [[1, first], [first, second], [second, third]].map(|channels| {
            Conv2dConfig::new(channels, [3, 3])
                .with_padding(PaddingConfig2d::Explicit(1, 1, 1, 1))
                .init(device)
        });
        Self {
            conv: conv.into(),
            pool: MaxPool2dConfig::new([2, 2]).init(),
            fc: LinearConfig::new(TAXELS / 64 * third, EMBED).init(device),
        }
    }

    /// `[scan, 1, row, column]` to `[scan, embedding]`.
    pub fn forward(&self, x: Tensor<4>) -> Tensor<2> {
        let x = self.conv.iter().fold(x, |x, conv| self.pool.forward(relu(conv.forward(x))));
        self.fc.forward(x.flatten(1, 3))
    }
}

/// Log-mel frames `[sequence, frame, bin]` to embeddings `[sequence, frame, embedding]` by causal convolutions.
fn of_frames(x: Tensor<3>, forward: impl FnOnce(Tensor<3>) -> Tensor<3>) -> Tensor<3> {
    forward(x.swap_dims(1, 2)).swap_dims(1, 2)
}

fn causal(channels: [usize; 2], kernel: usize, device: &Device) -> Conv1d {
    Conv1dConfig::new(channels[0], channels[1], kernel)
        .with_padding(PaddingConfig1d::Explicit(kernel - 1, 0))
        .init(device)
}

/// Two layers of the last window's frames side by side, as a filter of that length; zeros stand before the start.
#[derive(Module, Debug)]
pub struct Mlp {
    hidden: Conv1d,
    out: Conv1d,
}

impl Mlp {
    pub fn new(device: &Device) -> Self {
        Self {
            hidden: causal([MEL_BINS, HIDDEN], FIRST_DIMS.window, device),
            out: causal([HIDDEN, EMBED], 1, device),
        }
    }

    /// In training units are dropped, the same ones for the same seed: the tensor library draws from one generator for
    /// all threads, and networks are trained at once.
    pub fn forward(&self, x: Tensor<3>, seed: u64) -> Tensor<3> {
        of_frames(x, |x| {
            let hidden = relu(self.hidden.forward(x));
            self.out.forward(if hidden.device().is_autodiff() { dropped(hidden, seed) } else { hidden })
        })
    }
}

/// Some numbers become 0, the others grow by as much as keeps the mean.
fn dropped(x: Tensor<3>, seed: u64) -> Tensor<3> {
    let (shape, mut rng) = (x.dims(), ChaCha8Rng::seed_from_u64(seed));
    let kept = 1.0 / (1.0 - DROPPED) as f32;
    let factors = (0..shape.iter().product()).map(|_| if rng.random_bool(DROPPED) { 0.0 } else { kept });
    let factors = tensor(factors.collect(), shape, &x.device());
    x * factors
}

/// A convolution over the last frames and two over one, each with batch norm and ReLU.
#[derive(Module, Debug)]
pub struct CausalCnn {
    conv: Vec<Conv1d>,
    bn: Vec<BatchNorm>,
}

impl CausalCnn {
    pub fn new(device: &Device) -> Self {
        let layers = [(MEL_BINS, FIRST_DIMS.xl_kernel), (EMBED, 1), (EMBED, 1)];
        Self {
            conv: layers.map(|(from, kernel)| causal([from, EMBED], kernel, device)).into(),
            bn: layers.map(|_| BatchNormConfig::new(EMBED).init(device)).into(),
        }
    }

    pub fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        let layers = || self.conv.iter().zip(&self.bn);
        of_frames(x, |x| layers().fold(x, |x, (conv, bn)| relu(bn.forward(conv.forward(x)))))
    }
}
