//! The paper's encoders of one scan and of a sequence of log-mel frames, by the tensor library's own layers.
//!
//! The network that is shipped has none of them: they are too large for the microcontroller. `slipsense reproduce`
//! trains them beside it. [`named`] are a module's numbers by name, for files, first values and running averages.

pub mod named;
mod resnet;
mod small;
mod ssast;
mod vit;

use burn::module::Module;
use burn::tensor::{Device, Tensor};
use slipsense::params::{MEL_BINS, TAXELS};

use crate::device::is_cpu;

pub use resnet::ResNet18;
pub use small::{CausalCnn, CustomCnn, Mlp};
pub use ssast::{Ssast, SsastPretraining};
pub use vit::{MaskedPatches, Vit, VitMae};

/// Width of every embedding.
pub const EMBED: usize = 128;
/// Added to the variance in the transformers' LayerNorms, as in the authors' code.
const NORM_EPSILON: f64 = 1e-6;

/// What a network of the paper's sees a scan with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PadEncoder {
    Cnn,
    ResNet18,
    /// From random weights.
    Vit,
    /// Pretrained as a masked autoencoder, then kept.
    VitFrozen,
    /// Pretrained as a masked autoencoder, then trained on.
    VitFinetuned,
}

/// What a network of the paper's hears with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum XlEncoder {
    Mlp,
    Cnn,
    Ssast,
}

impl PadEncoder {
    pub const fn is_pretrained(self) -> bool {
        matches!(self, Self::VitFrozen | Self::VitFinetuned)
    }
}

#[expect(clippy::large_enum_variant, reason = "there is one of it in a network")]
#[derive(Module, Debug)]
pub enum PadModule {
    Cnn(CustomCnn),
    ResNet18(ResNet18),
    Vit(Vit),
}

#[expect(clippy::large_enum_variant, reason = "there is one of it in a network")]
#[derive(Module, Debug)]
pub enum XlModule {
    Mlp(Mlp),
    Cnn(CausalCnn),
    Ssast(Ssast),
}

/// What makes embeddings of rows: of scans one by one, or of a sensor's whole sequence of log-mel frames.
pub trait Encode: Module {
    /// Rows that are embedded at once: the size of their activations, which is to fit a CPU's caches, and what batch
    /// normalization takes its statistics from.
    fn rows_at_once(&self, device: &Device) -> usize;

    /// `[row, number]` to `[row, embedding]`. `seed`: of what is dropped in training.
    fn embed(&self, rows: Tensor<2>, seed: u64) -> Tensor<2>;
}

impl PadModule {
    pub fn new(encoder: PadEncoder, device: &Device) -> Self {
        match encoder {
            PadEncoder::Cnn => Self::Cnn(CustomCnn::new(device)),
            PadEncoder::ResNet18 => Self::ResNet18(ResNet18::new(device)),
            PadEncoder::Vit | PadEncoder::VitFrozen | PadEncoder::VitFinetuned => Self::Vit(Vit::new(device)),
        }
    }
}

impl Encode for PadModule {
    fn rows_at_once(&self, device: &Device) -> usize {
        match self {
            Self::Vit(_) if is_cpu(device) => 8,
            Self::Vit(_) => 512,
            Self::Cnn(_) | Self::ResNet18(_) => 64,
        }
    }

    /// Of pads, [`TAXELS`] numbers each.
    fn embed(&self, rows: Tensor<2>, _seed: u64) -> Tensor<2> {
        let [scans, taxels] = rows.dims();
        debug_assert_eq!(taxels, TAXELS);
        match self {
            Self::Cnn(cnn) => cnn.forward(image(rows)),
            Self::ResNet18(resnet) => resnet.forward(image(rows)),
            Self::Vit(vit) => vit.forward(rows.reshape([scans, TAXELS])),
        }
    }
}

impl XlModule {
    pub fn new(encoder: XlEncoder, device: &Device) -> Self {
        match encoder {
            XlEncoder::Mlp => Self::Mlp(Mlp::new(device)),
            XlEncoder::Cnn => Self::Cnn(CausalCnn::new(device)),
            XlEncoder::Ssast => Self::Ssast(Ssast::new(device)),
        }
    }
}

impl Encode for XlModule {
    fn rows_at_once(&self, device: &Device) -> usize {
        if matches!(self, Self::Ssast(_)) && is_cpu(device) { 2 } else { 8 }
    }

    /// Of sequences, [`MEL_BINS`] numbers for each frame, to [`EMBED`] for each frame.
    fn embed(&self, rows: Tensor<2>, seed: u64) -> Tensor<2> {
        let [sequences, numbers] = rows.dims();
        let frames = numbers / MEL_BINS;
        let rows = rows.reshape([sequences, frames, MEL_BINS]);
        let embedded = match self {
            Self::Mlp(mlp) => mlp.forward(rows, seed),
            Self::Cnn(cnn) => cnn.forward(rows),
            Self::Ssast(ssast) => ssast.stream(rows),
        };
        embedded.reshape([sequences, frames * EMBED])
    }
}

/// A scan as an image of one channel.
fn image(rows: Tensor<2>) -> Tensor<4> {
    use slipsense::params::{TAXEL_COLS, TAXEL_ROWS};
    let [scans, _] = rows.dims();
    rows.reshape([scans, 1, TAXEL_ROWS, TAXEL_COLS])
}
