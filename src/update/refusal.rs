//! Why an image is not installed, in the words that go onto the bus.

use core::fmt;

use crate::net::ModelError;

/// Why an image is not installed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "`reason` says it in words")]
pub enum Refusal {
    ShorterThanHeader,
    /// It does not begin as an image does: a bare program or model.
    NoHeader,
    UnknownFormat,
    Unsigned,
    WrongSignature,
    /// The key that this firmware was built with is none.
    BadKey,
    WrongKind,
    WrongBoard,
    Older,
    Held,
    Empty,
    TooLong,
    Truncated,
    Trailing,
    WrongHash,
    Model(ModelError),
    /// The firmware that runs has not confirmed: the one to roll back to is where the new one would go.
    OnTrial,
    NoBootloader,
    OutOfOrder,
    Flash,
    Blank,
}

impl Refusal {
    /// In words.
    pub const fn reason(self) -> &'static str {
        match self {
            Self::ShorterThanHeader => "truncated: shorter than the header of an image",
            Self::NoHeader => "unsigned: it has no image header",
            Self::UnknownFormat => "the image's format is unknown to this firmware",
            Self::Unsigned => "unsigned: the signature is empty",
            Self::WrongSignature => "the signature is not by this firmware's key",
            Self::BadKey => "this firmware was built with a key that is none",
            Self::WrongKind => "firmware and model mistaken for each other",
            Self::WrongBoard => "for another board",
            Self::Older => "older than what is installed",
            Self::Held => "installed already",
            Self::Empty => "empty",
            Self::TooLong => "longer than its slot",
            Self::Truncated => "truncated: it ends before its payload does",
            Self::Trailing => "it goes on behind its payload",
            Self::WrongHash => "the payload's SHA-256 does not match",
            Self::Model(error) => match error {
                ModelError::HashMismatch => "corrupt model: its SHA-256 does not match",
                ModelError::UnknownVersion { .. } | ModelError::BadHeader { .. } => {
                    "corrupt model: its format is unknown to this firmware"
                }
                ModelError::BadMagic => "corrupt model: it does not begin as a model does",
                ModelError::Truncated { .. } => "corrupt model: it ends too early",
                ModelError::TrailingBytes { .. } => "corrupt model: bytes after its end",
                ModelError::BadDimension(_) => "corrupt model: a size that this firmware has no room for",
                ModelError::AccumulatorOverflow { .. } => "corrupt model: an accumulator could overflow",
                ModelError::BadScale { .. } | ModelError::BadOperatingPoint(_) => {
                    "corrupt model: a number out of range"
                }
                ModelError::BadPadding { .. }
                | ModelError::BadKernel { .. }
                | ModelError::BadProvenance
                | ModelError::Misaligned => "corrupt model: it is not laid out as a model is",
            },
            Self::OnTrial => "the firmware that runs has not confirmed yet",
            Self::NoBootloader => "there is no bootloader on this board: cargo flash-boot-h743",
            Self::OutOfOrder => "pieces out of order",
            Self::Flash => "the flash refused",
            Self::Blank => "nothing there",
        }
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.reason())
    }
}

impl core::error::Error for Refusal {}
