//! Reasons to refuse a model file.

use core::fmt;

use super::format::{FORMAT_VERSION, FieldError, HEADER_BYTES};

/// Why a model file is refused: a layer or section, the tensor of it, the output channel, what the file says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the fields are named after what they are, and the text says it")]
pub enum ModelError {
    BadMagic,
    UnknownVersion {
        found: u16,
    },
    BadHeader {
        bytes: u16,
    },
    BadDimension(FieldError),
    /// An operating point that the flag cannot be decided at.
    BadOperatingPoint(FieldError),
    Truncated {
        layer: &'static str,
        part: &'static str,
    },
    /// The bytes do not start at a multiple of four, as the kernels that read them in place need it.
    Misaligned,
    /// Numbers that no output or input belongs to, and that are not zero.
    BadPadding {
        layer: &'static str,
    },
    /// Four numbers of a convolution that no three weights give.
    BadKernel {
        layer: &'static str,
        channel: usize,
    },
    TrailingBytes {
        count: usize,
    },
    HashMismatch,
    BadProvenance,
    /// Some input could bring the 32-bit accumulator of this channel up to `bound`.
    AccumulatorOverflow {
        layer: &'static str,
        channel: usize,
        bound: i64,
    },
    /// A multiplier below 0, or an epsilon below 1; `channel` is its position in the tensor.
    BadScale {
        layer: &'static str,
        part: &'static str,
        channel: usize,
        value: i32,
    },
}

impl fmt::Display for ModelError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::BadMagic => f.write_str("not a SlipSense model file (wrong first bytes)"),
            Self::UnknownVersion { found } => {
                write!(
                    f,
                    "model format version {found} is unknown; this build reads version {FORMAT_VERSION}"
                )
            }
            Self::BadHeader { bytes } => {
                write!(f, "header of {bytes} bytes, version {FORMAT_VERSION} has {HEADER_BYTES}")
            }
            Self::BadDimension(error) | Self::BadOperatingPoint(error) => error.fmt(f),
            Self::Truncated { layer, part } => write!(f, "file ends inside {layer} {part}"),
            Self::Misaligned => f.write_str("the file does not start at a multiple of four bytes in memory"),
            Self::BadPadding { layer } => write!(f, "{layer}: the padding is not zero"),
            Self::BadKernel { layer, channel } => {
                write!(
                    f,
                    "{layer} channel {channel}: the numbers are not sums and differences of a kernel's weights"
                )
            }
            Self::TrailingBytes { count } => write!(f, "{count} bytes after the end"),
            Self::HashMismatch => f.write_str("SHA-256 does not match: the file is damaged"),
            Self::BadProvenance => f.write_str("provenance is not UTF-8"),
            Self::AccumulatorOverflow { layer, channel, bound } => {
                write!(f, "{layer} channel {channel}: accumulator can reach {bound}, more than 2147483647")
            }
            Self::BadScale { layer, part, channel, value } => {
                write!(f, "{layer} {part} {channel} is {value}, out of range")
            }
        }
    }
}

impl core::error::Error for ModelError {}
