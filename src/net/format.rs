//! Layout of the model file, for the reader here and the exporter on the host. Little endian throughout:
//!
//! | bytes | content |
//! |---|---|
//! | 8 | [`MAGIC`] |
//! | 2, 2 | format version, header length ([`HEADER_BYTES`]) |
//! | 2 × 8 | dimensions, in the order of [`Dims::FIELDS`] |
//! | 4, 1, 1 | operating point: threshold (`i32`), k, n, see [`OperatingPoint`] |
//! | 2 | zeros, up to a multiple of 4 |
//! | … | the tensors of [`layout`], each padded with zeros to [`TENSOR_ALIGN`] bytes |
//! | 4, n | length and text of the provenance, UTF-8 JSON, padded with zeros to 4 bytes |
//! | 32 | SHA-256 of everything before |

use core::fmt;

use super::packing::{self, Inputs};
use crate::fixed::Logit;
use crate::params::{OUTPUTS, PIEZO_CHANNELS, TAXEL_ROWS, XL_FEATURES, limits};

/// First bytes of every model file.
pub const MAGIC: [u8; 8] = *b"SLIPNET\0";
/// The version this code reads and writes.
pub const FORMAT_VERSION: u16 = 6;
/// Bytes before the first tensor.
pub const HEADER_BYTES: usize = 36;
/// Tensors are padded to four numbers of 32 bits, which kernels take at once; bytes.
pub const TENSOR_ALIGN: usize = 16;
/// Bytes of the hash that ends the file.
pub const HASH_BYTES: usize = 32;

/// Sizes of the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Dims {
    /// Channels after each convolution block.
    pub conv_channels: [usize; 3],
    /// Width of a modality's embedding.
    pub embed: usize,
    /// Frames the first accelerometer layer sees.
    pub xl_kernel: usize,
    /// Hidden channels of the accelerometer encoder.
    pub xl_channels: usize,
    /// Heads of every attention block.
    pub heads: usize,
    /// Frames an attention block looks back over, the current one included.
    pub window: usize,
}

/// A number of the header outside its range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the fields are named after what they are")]
pub struct FieldError {
    pub field: &'static str,
    pub value: i32,
    /// The smallest and largest value allowed.
    pub range: (i32, i32),
}

impl fmt::Display for FieldError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { field, value, range: (least, most) } = self;
        write!(f, "{field} is {value}, allowed are {least} to {most}")
    }
}

impl core::error::Error for FieldError {}

impl Dims {
    /// Names of the header's fields, in their order.
    pub const FIELDS: [&'static str; 8] = [
        "conv1 channels",
        "conv2 channels",
        "conv3 channels",
        "embedding width",
        "accelerometer kernel",
        "accelerometer channels",
        "heads",
        "window",
    ];

    /// The fields in header order.
    pub const fn to_fields(&self) -> [usize; 8] {
        let [c1, c2, c3] = self.conv_channels;
        [c1, c2, c3, self.embed, self.xl_kernel, self.xl_channels, self.heads, self.window]
    }

    /// From the fields in header order; refuses what does not fit [`limits`].
    pub fn from_fields(fields: [usize; 8]) -> Result<Self, FieldError> {
        const MAX: [usize; 8] = [
            limits::CONV_CHANNELS[0],
            limits::CONV_CHANNELS[1],
            limits::CONV_CHANNELS[2],
            limits::EMBED,
            limits::XL_KERNEL,
            limits::XL_CHANNELS,
            limits::HEADS,
            limits::WINDOW,
        ];
        for ((field, value), max) in Self::FIELDS.into_iter().zip(fields).zip(MAX) {
            if value == 0 || value > max {
                return Err(FieldError { field, value: value as i32, range: (1, max as i32) });
            }
        }
        let [c1, c2, c3, embed, xl_kernel, xl_channels, heads, window] = fields;
        let dims = Self { conv_channels: [c1, c2, c3], embed, xl_kernel, xl_channels, heads, window };
        if embed % heads != 0 {
            return Err(FieldError {
                field: "heads (must divide the embedding width)",
                value: heads as i32,
                range: (1, embed as i32),
            });
        }
        // 32 products of two 14-bit values are the most that an i32 holds.
        if dims.fused() / heads > HEAD_WIDTH_MAX {
            let least = dims.fused().div_ceil(HEAD_WIDTH_MAX);
            return Err(FieldError {
                field: "heads (a head of the temporal block wider than 32 could overflow)",
                value: heads as i32,
                range: (least as i32, limits::HEADS as i32),
            });
        }
        Ok(dims)
    }

    /// Width of the fused vector: both embeddings.
    pub const fn fused(&self) -> usize {
        2 * self.embed
    }
}

/// When the flag is raised: fixed on validation data, stored with the network it was fixed for. It is up while the
/// log-odds of slip ([`crate::decision`]) of at least `k` of the last `n` frames exceeds the threshold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OperatingPoint {
    /// The largest log-odds that are not enough, [`Self::THRESHOLD_MIN`] to [`Self::THRESHOLD_MAX`].
    pub threshold: Logit,
    /// Frames that must exceed the threshold, 1 to `n`.
    pub k: u8,
    /// The last frames that count, the current one included, 1 to [`DECISION_FRAMES_MAX`].
    pub n: u8,
}

/// Frames that the flag remembers, at most: the bits of its history.
pub const DECISION_FRAMES_MAX: u8 = u32::BITS as u8;

impl OperatingPoint {
    /// The flag is up where slip is likelier than not.
    pub const EVEN: Self = Self { threshold: Logit::from_bits(0), k: 1, n: 1 };
    /// Below all log-odds, which have 16 bits.
    pub const THRESHOLD_MIN: Logit = Logit::from_bits(-(1 << 16));
    /// At least all log-odds.
    pub const THRESHOLD_MAX: Logit = Logit::from_bits((1 << 16) - 1);

    /// Refuses a field out of range.
    pub fn check(&self) -> Result<(), FieldError> {
        let n_max = DECISION_FRAMES_MAX as i32;
        let thresholds = (Self::THRESHOLD_MIN.to_bits(), Self::THRESHOLD_MAX.to_bits());
        for (field, value, range) in [
            ("operating point n", self.n as i32, (1, n_max)),
            ("operating point k", self.k as i32, (1, self.n as i32)),
            ("operating point threshold", self.threshold.to_bits(), thresholds),
        ] {
            if value < range.0 || value > range.1 {
                return Err(FieldError { field, value, range });
            }
        }
        Ok(())
    }
}

/// Widest attention head whose scores provably fit an `i32`.
pub const HEAD_WIDTH_MAX: usize = 32;

/// Number of tensors in a file.
pub const TENSORS: usize = 3 * 7 + 3 * (3 * 4 + 7) + 3;

/// How a tensor's numbers are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the names say it")]
pub enum Kind {
    /// Weights: two bytes per coefficient, in the order of [`packing`].
    Weights(Inputs),
    I16,
    I32,
}

impl Kind {
    /// Bytes of one number.
    pub const fn bytes(self) -> usize {
        match self {
            Self::Weights(_) | Self::I16 => 2,
            Self::I32 => 4,
        }
    }
}

/// One tensor of the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TensorSpec {
    /// The layer it belongs to, such as `piezo.conv1` or `temporal.query`.
    pub layer: &'static str,
    /// What it is there, such as `weight` or `multiplier`.
    pub part: &'static str,
    /// Storage of one number.
    pub kind: Kind,
    /// Rows (output channels or heads; 1 for a plain vector).
    pub rows: usize,
    /// Numbers per row.
    pub cols: usize,
}

impl TensorSpec {
    pub(super) const NONE: Self = Self { layer: "", part: "", kind: Kind::I16, rows: 0, cols: 0 };

    /// Numbers in the tensor.
    pub const fn len(&self) -> usize {
        self.rows * self.cols
    }

    /// Bytes in the file, padding behind them left out.
    pub const fn bytes(&self) -> usize {
        let count = match self.kind {
            Kind::Weights(inputs) => packing::len(inputs, self.rows),
            _ => self.len(),
        };
        count * self.kind.bytes()
    }

    /// Bytes in the file, padding included.
    pub const fn padded_bytes(&self) -> usize {
        self.bytes().next_multiple_of(TENSOR_ALIGN)
    }
}

/// Names of an attention block's four projections and of its own tensors.
macro_rules! block_names {
    ($block:literal) => {
        [
            concat!($block, ".query"),
            concat!($block, ".key"),
            concat!($block, ".value"),
            concat!($block, ".out"),
            concat!($block, ".score"),
            concat!($block, ".norm"),
        ]
    };
}

/// Collects the specs in file order.
struct Layout<'a> {
    specs: &'a mut [TensorSpec; TENSORS],
    used: usize,
}

impl Layout<'_> {
    const fn push(&mut self, layer: &'static str, part: &'static str, kind: Kind, rows: usize, cols: usize) {
        self.specs[self.used] = TensorSpec { layer, part, kind, rows, cols };
        self.used += 1;
    }

    const fn layer(&mut self, name: &'static str, outputs: usize, inputs: Inputs) {
        self.push(name, "weight", Kind::Weights(inputs), outputs, inputs.count());
        self.push(name, "bias", Kind::I32, 1, outputs);
        self.push(name, "multiplier", Kind::I32, 1, outputs);
    }

    const fn attention(&mut self, names: [&'static str; 6], width: usize, dims: &Dims) {
        let [query, key, value, out, score, norm] = names;
        let all = Inputs::Vector { count: width };
        self.layer(query, width, all);
        self.layer(key, width, all);
        self.layer(value, width, all);
        self.layer(out, width, all);
        self.push(score, "multiplier", Kind::I32, 1, 1);
        self.push(score, "bias", Kind::I16, dims.heads, dims.window);
        self.push(norm, "residual", Kind::I32, 1, 1);
        self.push(norm, "gamma", Kind::I16, 1, width);
        self.push(norm, "beta", Kind::I32, 1, width);
        self.push(norm, "multiplier", Kind::I32, 1, 1);
        self.push(norm, "epsilon", Kind::I32, 1, 1);
    }
}

/// The tensors of a file with these dimensions, in file order.
///
/// In a model's terms convolution weights are in output, kernel row, kernel column, input order, the inputs of the first
/// being count and delta; the dense layer after them takes its inputs in row, column, channel order; the first
/// accelerometer layer takes frames oldest first, [`XlFeatures`](crate::features::XlFeatures) within a frame. The head
/// has the logits of the classes, then the log-odds of slip. [`packing`] has their order in the file. Row 0 of a
/// score bias is head 0, column 0 is lag 0.
pub const fn layout(dims: &Dims) -> [TensorSpec; TENSORS] {
    let mut specs = [TensorSpec::NONE; TENSORS];
    lay_out(dims, &mut specs);
    specs
}

/// As [`layout`], in place: a firmware's stack has no room for the specs twice.
pub(super) const fn lay_out(dims: &Dims, specs: &mut [TensorSpec; TENSORS]) {
    let [c1, c2, c3] = dims.conv_channels;
    let mut all = Layout { specs, used: 0 };
    all.layer("piezo.conv1", c1, Inputs::Patch { channels: PIEZO_CHANNELS, pairs: PIEZO_CHANNELS / 2 });
    all.layer("piezo.conv2", c2, Inputs::Patch { channels: c1, pairs: packing::pairs(c1) });
    all.layer("piezo.conv3", c3, Inputs::Patch { channels: c2, pairs: packing::pairs(c2) });
    all.layer(
        "piezo.dense",
        dims.embed,
        Inputs::Map { side: TAXEL_ROWS / 8, channels: c3, pairs: packing::pairs(c3) },
    );
    all.layer("xl.conv", dims.xl_channels, Inputs::Vector { count: dims.xl_kernel * XL_FEATURES });
    all.layer("xl.mix1", dims.xl_channels, Inputs::Vector { count: dims.xl_channels });
    all.layer("xl.mix2", dims.embed, Inputs::Vector { count: dims.xl_channels });
    all.attention(block_names!("cross_piezo"), dims.embed, dims);
    all.attention(block_names!("cross_xl"), dims.embed, dims);
    all.attention(block_names!("temporal"), dims.fused(), dims);
    all.layer("head", OUTPUTS, Inputs::Vector { count: dims.fused() });
}
