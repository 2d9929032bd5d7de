//! The paper's comparisons: networks that differ from the shipped one in one thing each, trained on the same
//! episodes with the same budget and scored on the same frozen splits.
//!
//! [`ROWS`] lists them, [`network`] says what each computes, [`train`] trains one, alone or with another as its
//! teacher, [`integers`] runs it on the microcontroller's kernels, [`results`] collects what they reach,
//! [`published`] puts the paper's tables beside it and [`orderings`] holds it against the order that the paper found.
//! All networks but one are in float.

mod command;
mod example;
pub mod integers;
mod jobs;
mod leave_out;
pub mod network;
pub mod orderings;
pub mod paper;
mod picture;
mod published;
pub mod results;
mod run;
pub mod sets;
mod table;
pub mod train;

pub use command::{BudgetName, REPORT_FILE, ReproduceArgs, run_reproduce};
pub use leave_out::{LeaveOutArgs, run_leave_out};

use slipsense::params::TAXEL_ROWS;

use crate::encoders::{PadEncoder, XlEncoder};
use crate::pad_view::PadView;
use crate::weights::FIRST_DIMS;

/// Which sensors a network has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Modality {
    Both,
    Piezo,
    /// Accelerometers only: they say what contact is, too.
    Xl,
}

/// How two modalities become one decision. A network of one modality attends to itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fusion {
    /// Each modality asks the other, then both side by side ask their past.
    CrossAttention,
    /// Each asks itself: as many parameters, and only what the first attention looks at is another.
    OwnAttention,
    /// Side by side at once, without a first attention.
    Concatenation,
    /// Two networks of one modality each, trained together; the mean of their logits.
    Late,
}

/// Where the maximum over the sensors is taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pool {
    /// Of each modality's embedding.
    BeforeFusion,
    /// Of the fused vector: each sensor's modalities ask each other only.
    AfterFusion,
    /// Of each modality's embedding, and a learned share of the mean over the sensors is added: what they agree on.
    WithMean,
}

/// The paper's encoders of pads and accelerometers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Encoders {
    pub pads: PadEncoder,
    pub xl: XlEncoder,
}

/// A network and what it is trained on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Variant {
    pub modality: Modality,
    pub fusion: Fusion,
    pub pool: Pool,
    /// Channels, filters and embeddings, times those of the shipped network.
    pub size: usize,
    /// Frames an attention looks back over, the current one included.
    pub window: usize,
    /// Frames the first accelerometer layer sees; with 1 the encoder is an MLP of one frame.
    pub xl_kernel: usize,
    /// Does the network see how far each bin is above its noise floor; else the standardised bins alone.
    pub over_floor: bool,
    pub pads: PadView,
    /// Is what the accelerometers hear changed at random in training.
    pub xl_augmentation: bool,
    /// Is it trained on families of physics beside the laboratory's.
    pub families: bool,
    /// Does the detector's loss weigh events, else all frames alike.
    pub event_loss: bool,
    /// Does it learn what contact is too, from frames that count as much as others.
    pub learns_contact: bool,
}

impl Variant {
    /// Whether the pads decide what contact is, as in the pipeline.
    pub fn pads_say_contact(&self) -> bool {
        self.modality != Modality::Xl
    }
}

/// The network as shipped: what `slipsense train` trains and what is quantized has its parts, at its own size.
pub const BASE: Variant = Variant {
    modality: Modality::Both,
    fusion: Fusion::CrossAttention,
    pool: Pool::BeforeFusion,
    size: 1,
    window: FIRST_DIMS.window,
    xl_kernel: FIRST_DIMS.xl_kernel,
    over_floor: true,
    pads: PadView { side: TAXEL_ROWS, change: true },
    xl_augmentation: true,
    families: true,
    event_loss: true,
    learns_contact: false,
};

/// Where a row's weights come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Making {
    /// Trained on the labels.
    Trained,
    /// Trained on the labels and on what a trained row of this name says of the same frames, in equal parts.
    TaughtBy(&'static str),
    /// Not trained: the weights of [`BASE_ROW`] in integers.
    Quantized,
    /// From the weights of [`BASE_ROW`] as many steps again.
    TrainedOn {
        /// Also on hard examples that those weights find.
        mined: bool,
    },
}

/// One row of the comparisons.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// As on the command line and in files.
    pub name: &'static str,
    /// What is compared.
    pub group: &'static str,
    pub about: &'static str,
    pub variant: Variant,
    /// The paper's encoders instead of ours.
    pub encoders: Option<Encoders>,
    pub making: Making,
}

impl Row {
    /// The row whose weights this one runs or learns from.
    pub fn needs(&self) -> Option<&'static str> {
        match self.making {
            Making::Trained => None,
            Making::TaughtBy(teacher) => Some(teacher),
            Making::Quantized | Making::TrainedOn { .. } => Some(BASE_ROW),
        }
    }
}

/// Name of the row that the others differ from.
pub const BASE_ROW: &str = "base";
/// Name of the row of both modalities that stands beside each alone.
const BOTH_ROW: &str = "both";
const INTEGERS_ROW: &str = "integers";
const PAPER_ROW: &str = "paper";
/// Name of the larger network that teaches.
const TEACHER_ROW: &str = "wide";

const fn row(name: &'static str, group: &'static str, about: &'static str, variant: Variant) -> Row {
    Row { name, group, about, variant, encoders: None, making: Making::Trained }
}

const fn side(side: usize) -> Variant {
    Variant { pads: PadView { side, change: true }, ..BASE }
}

const fn fusion(fusion: Fusion) -> Variant {
    Variant { fusion, ..BASE }
}

/// The paper's comparison of modalities: in the laboratory alone, all three trained alike.
const fn modality(modality: Modality) -> Variant {
    Variant { modality, families: false, learns_contact: true, ..BASE }
}

const NO_CHANGE: Variant = Variant { pads: PadView { side: TAXEL_ROWS, change: false }, ..BASE };

/// The paper's network but for its encoders: embeddings of 128, of counts and standardised bins alone.
const PAPER: Variant = Variant { size: 4, over_floor: false, ..NO_CHANGE };

const fn encoders(name: &'static str, about: &'static str, pads: PadEncoder, xl: XlEncoder) -> Row {
    Row { encoders: Some(Encoders { pads, xl }), ..row(name, "paper's network", about, PAPER) }
}

pub const ROWS: [Row; 33] = [
    row(BASE_ROW, "base", "both modalities, cross-attention, T = 60, 32×32, XL augmentation", BASE),
    row(BOTH_ROW, "modality", "both, trained as each alone", modality(Modality::Both)),
    row("piezo", "modality", "pads only", modality(Modality::Piezo)),
    row("xl", "modality", "accelerometers only, which say what contact is, too", modality(Modality::Xl)),
    row("late", "fusion", "mean of the logits of two networks", fusion(Fusion::Late)),
    row("concatenation", "fusion", "no first attention", fusion(Fusion::Concatenation)),
    row("own-attention", "fusion", "each modality attends to itself first", fusion(Fusion::OwnAttention)),
    row("xl-mlp", "XL encoder", "MLP of one frame instead of a 1-D CNN", Variant { xl_kernel: 1, ..BASE }),
    row("t6", "memory", "T = 6 frames", Variant { window: 6, ..BASE }),
    row("t15", "memory", "T = 15 frames", Variant { window: 15, ..BASE }),
    row("t30", "memory", "T = 30 frames", Variant { window: 30, ..BASE }),
    row("t120", "memory", "T = 120 frames", Variant { window: 120, ..BASE }),
    row("side16", "resolution", "every second taxel of rows and columns", side(16)),
    row("side8", "resolution", "every fourth", side(8)),
    row(
        "no-xl-augmentation",
        "augmentation",
        "no sound, colour, mask or noise on the accelerometers",
        Variant { xl_augmentation: false, ..BASE },
    ),
    row("no-floor", "XL input", "standardised bins alone", Variant { over_floor: false, ..BASE }),
    row(
        "max-after-fusion",
        "sensors",
        "maximum over sensors after the fusion",
        Variant { pool: Pool::AfterFusion, ..BASE },
    ),
    row(
        "with-mean",
        "sensors",
        "a learned share of the mean over sensors beside the maximum",
        Variant { pool: Pool::WithMean, ..BASE },
    ),
    row(
        "laboratory",
        "worlds",
        "the laboratory's physics alone: half of the episodes",
        Variant { families: false, ..BASE },
    ),
    row(
        "frame-loss",
        "detector",
        "its loss over frames, not over events",
        Variant { event_loss: false, ..BASE },
    ),
    Row {
        making: Making::TrainedOn { mined: false },
        ..row("longer", "hard examples", "as many steps again from the base's weights", BASE)
    },
    Row {
        making: Making::TrainedOn { mined: true },
        ..row("mined", "hard examples", "the same, also on what the base takes for slip", BASE)
    },
    Row {
        making: Making::Quantized,
        ..row(
            INTEGERS_ROW,
            "integers",
            "the base's weights in integers, as the microcontroller runs them",
            BASE,
        )
    },
    row("no-change", "pad input", "counts only, no change channel", NO_CHANGE),
    row(
        TEACHER_ROW,
        "size",
        "twice the channels, embeddings and filters of the first two convolutions",
        Variant { size: 2, ..BASE },
    ),
    Row {
        making: Making::TaughtBy(TEACHER_ROW),
        ..row("distilled", "size", "the base's network, taught by wide and the labels in equal parts", BASE)
    },
    encoders(PAPER_ROW, "custom CNN, SSAST-Tiny: the paper's own", PadEncoder::Cnn, XlEncoder::Ssast),
    encoders("resnet18", "ResNet-18, SSAST-Tiny", PadEncoder::ResNet18, XlEncoder::Ssast),
    encoders("vit-scratch", "ViT from random weights, SSAST-Tiny", PadEncoder::Vit, XlEncoder::Ssast),
    encoders("vit-frozen", "ViT-MAE, kept, SSAST-Tiny", PadEncoder::VitFrozen, XlEncoder::Ssast),
    encoders("vit-finetuned", "ViT-MAE, trained on, SSAST-Tiny", PadEncoder::VitFinetuned, XlEncoder::Ssast),
    encoders("paper-mlp", "custom CNN, MLP", PadEncoder::Cnn, XlEncoder::Mlp),
    encoders("paper-cnn", "custom CNN, 1-D CNN", PadEncoder::Cnn, XlEncoder::Cnn),
];

pub fn row_named(name: &str) -> Option<&'static Row> {
    ROWS.iter().find(|row| row.name == name)
}
