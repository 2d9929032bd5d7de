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
use slipsense::params::{MEL_BINS, TAXEL_COLS, TAXEL_ROWS};

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

/// What makes embeddings of rows: of scans one by one, or of a sensor's whole sequence of log-mel frames.
#[allow(clippy::large_enum_variant, reason = "there are two of it in a network")]
#[derive(Module, Debug)]
pub enum Encoder {
    CustomCnn(CustomCnn),
    ResNet18(ResNet18),
    Vit(Vit),
    Mlp(Mlp),
    CausalCnn(CausalCnn),
    Ssast(Ssast),
}

impl Encoder {
    pub fn of_pads(encoder: PadEncoder, device: &Device) -> Self {
        match encoder {
            PadEncoder::Cnn => Self::CustomCnn(CustomCnn::new(device)),
            PadEncoder::ResNet18 => Self::ResNet18(ResNet18::new(device)),
            PadEncoder::Vit | PadEncoder::VitFrozen | PadEncoder::VitFinetuned => Self::Vit(Vit::new(device)),
        }
    }

    pub fn of_xl(encoder: XlEncoder, device: &Device) -> Self {
        match encoder {
            XlEncoder::Mlp => Self::Mlp(Mlp::new(device)),
            XlEncoder::Cnn => Self::CausalCnn(CausalCnn::new(device)),
            XlEncoder::Ssast => Self::Ssast(Ssast::new(device)),
        }
    }

    /// Rows that are embedded at once: as many as fit a CPU's caches, or batch normalization takes statistics from.
    pub(crate) fn rows_at_once(&self, device: &Device) -> usize {
        match self {
            Self::Vit(_) if is_cpu(device) => 8,
            Self::Vit(_) => 512,
            Self::CustomCnn(_) | Self::ResNet18(_) => 64,
            Self::Ssast(_) if is_cpu(device) => 2,
            Self::Mlp(_) | Self::CausalCnn(_) | Self::Ssast(_) => 8,
        }
    }

    /// `[row, number]` to `[row, embedding]`: a scan's taxels to [`EMBED`] numbers, a sequence's [`MEL_BINS`] of each
    /// frame to as many of each. `seed`: of what is dropped in training.
    pub(crate) fn embed(&self, rows: Tensor<2>, seed: u64) -> Tensor<2> {
        let [count, numbers] = rows.dims();
        let image = |rows: Tensor<2>| rows.reshape([count, 1, TAXEL_ROWS, TAXEL_COLS]);
        let frames = |rows: Tensor<2>| rows.reshape([count, numbers / MEL_BINS, MEL_BINS]);
        let flat = |embedded: Tensor<3>| embedded.reshape([count, numbers / MEL_BINS * EMBED]);
        match self {
            Self::CustomCnn(cnn) => cnn.forward(image(rows)),
            Self::ResNet18(resnet) => resnet.forward(image(rows)),
            Self::Vit(vit) => vit.forward(rows),
            Self::Mlp(mlp) => flat(mlp.forward(frames(rows), seed)),
            Self::CausalCnn(cnn) => flat(cnn.forward(frames(rows))),
            Self::Ssast(ssast) => flat(ssast.stream(frames(rows))),
        }
    }
}
