//! ResNet-18 of one channel: torchvision's, its first convolution of one channel, its last layer 128 wide.

use burn::module::Module;
use burn::nn::conv::{Conv2d, Conv2dConfig};
use burn::nn::pool::{MaxPool2d, MaxPool2dConfig};
use burn::nn::{BatchNorm, BatchNormConfig, Linear, LinearConfig, PaddingConfig2d};
use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor};

use super::EMBED;

/// Channels of the four stages of two blocks.
const CHANNELS: [usize; 4] = [64, 128, 256, 512];

fn conv([from, to]: [usize; 2], kernel: usize, stride: usize, device: &Device) -> Conv2d {
    let pad = kernel / 2;
    Conv2dConfig::new([from, to], [kernel; 2])
        .with_stride([stride; 2])
        .with_padding(PaddingConfig2d::Explicit(pad, pad, pad, pad))
        .with_bias(false)
        .init(device)
}

#[derive(Module, Debug)]
struct Block {
    conv1: Conv2d,
    bn1: BatchNorm,
    conv2: Conv2d,
    bn2: BatchNorm,
    /// Where the shape changes.
    downsample: Option<Downsample>,
}

#[derive(Module, Debug)]
struct Downsample {
    conv: Conv2d,
    bn: BatchNorm,
}

impl Block {
    fn new([from, to]: [usize; 2], device: &Device) -> Self {
        let stride = if from == to { 1 } else { 2 };
        let norm = || BatchNormConfig::new(to).init(device);
        Self {
            conv1: conv([from, to], 3, stride, device),
            bn1: norm(),
            conv2: conv([to, to], 3, 1, device),
            bn2: norm(),
            downsample: (from != to)
                .then(|| Downsample { conv: conv([from, to], 1, stride, device), bn: norm() }),
        }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let y = relu(self.bn1.forward(self.conv1.forward(x.clone())));
        let y = self.bn2.forward(self.conv2.forward(y));
        let x = match &self.downsample {
            Some(Downsample { conv, bn }) => bn.forward(conv.forward(x)),
            None => x,
        };
        relu(x + y)
    }
}

#[derive(Module, Debug)]
pub struct ResNet18 {
    conv1: Conv2d,
    bn1: BatchNorm,
    pool: MaxPool2d,
    blocks: Vec<Block>,
    fc: Linear,
}

impl ResNet18 {
    pub fn new(device: &Device) -> Self {
        let mut from = CHANNELS[0];
        let blocks =
            CHANNELS.into_iter().flat_map(|to| [std::mem::replace(&mut from, to), to].map(|f| [f, to]));
        Self {
            conv1: conv([1, CHANNELS[0]], 7, 2, device),
            bn1: BatchNormConfig::new(CHANNELS[0]).init(device),
            pool: MaxPool2dConfig::new([3, 3])
                .with_strides([2, 2])
                .with_padding(PaddingConfig2d::Explicit(1, 1, 1, 1))
                .init(),
            blocks: blocks.map(|channels| Block::new(channels, device)).collect(),
            fc: LinearConfig::new(CHANNELS[3], EMBED).init(device),
        }
    }

    /// `[scan, 1, row, column]` to `[scan, embedding]`, by global average pooling.
    pub fn forward(&self, x: Tensor<4>) -> Tensor<2> {
        let x = self.pool.forward(relu(self.bn1.forward(self.conv1.forward(x))));
        let x = self.blocks.iter().fold(x, |x, block| block.forward(x));
        let [scans, channels, ..] = x.dims();
        self.fc.forward(x.mean_dims(&[2, 3]).reshape([scans, channels]))
    }
}
