//! The signed image: a header of [`HEADER_BYTES`], then the payload as it goes into flash.
//!
//! Little endian throughout:
//!
//! | offset | bytes | content |
//! |---|---|---|
//! | 0 | 8 | [`MAGIC`] |
//! | 8 | 2 | format version, [`FORMAT_VERSION`] |
//! | 10 | 2 | board that it is for, `id` of [`Partitions`](super::partitions::Partitions); 0: any, models only |
//! | 12 | 1 | what it is: 1 firmware, 2 model |
//! | 13 | 1 | zero |
//! | 14 | 1, 1, 2 | version: major, minor, patch |
//! | 18 | 2 | zero |
//! | 20 | 4 | bytes of the payload, at least 1 |
//! | 24 | 32 | SHA-256 of the payload |
//! | 56 | 8 | zero |
//! | 64 | 64 | Ed25519 signature (RFC 8032) of the 64 bytes before |
//! | 128 | … | the payload: a firmware as it lies in flash from its first address on, or a model file |
//!
//! The same header lies beside what was installed: at the end of a firmware's slot, at the begin of the model's.

use core::fmt;
use core::str::FromStr;

use super::Refusal;
use super::key::{self, Keys};
use super::partitions::Partitions;
use crate::node::{UpdateTarget, Version};
use crate::wire::bytes::Writer;

/// First bytes of every image.
pub const MAGIC: [u8; 8] = *b"SLIPIMG\0";
/// The version this code reads and writes.
pub const FORMAT_VERSION: u16 = 1;
/// Bytes before the payload.
pub const HEADER_BYTES: usize = 128;
/// The first bytes of the header, which the signature is of.
pub const SIGNED_BYTES: usize = 64;
/// Board of a model that any board takes.
pub const ANY_BOARD: u16 = 0;

/// Version of an image. Compared part by part, major first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct ImageVersion {
    /// Raised by what breaks.
    pub major: u8,
    /// Raised by what is added.
    pub minor: u8,
    /// Raised by what is mended.
    pub patch: u16,
}

impl ImageVersion {
    /// The version of this library, and with it of the firmware.
    pub const SOFTWARE: Self = match Self::parse(env!("CARGO_PKG_VERSION").as_bytes()) {
        Some(version) => version,
        None => panic!("the package's version does not fit an image"),
    };

    /// `major.minor.patch`, each a decimal number in its range.
    const fn parse(text: &[u8]) -> Option<Self> {
        let mut parts = [0u32; 3];
        let (mut part, mut digits, mut index) = (0, 0, 0);
        while index < text.len() {
            match text[index] {
                b'.' if part < 2 && digits > 0 => {
                    part += 1;
                    digits = 0;
                }
                digit @ b'0'..=b'9' if digits < 5 => {
                    parts[part] = parts[part] * 10 + (digit - b'0') as u32;
                    digits += 1;
                }
                _ => return None,
            }
            index += 1;
        }
        let [major, minor, patch] = parts;
        if part != 2
            || digits == 0
            || major > u8::MAX as u32
            || minor > u8::MAX as u32
            || patch > u16::MAX as u32
        {
            return None;
        }
        Some(Self { major: major as u8, minor: minor as u8, patch: patch as u16 })
    }
}

/// As it is stored: minor and patch last, as in the header.
impl From<[u8; 4]> for ImageVersion {
    fn from([major, minor, low, high]: [u8; 4]) -> Self {
        Self { major, minor, patch: u16::from_le_bytes([low, high]) }
    }
}

impl From<ImageVersion> for [u8; 4] {
    fn from(version: ImageVersion) -> Self {
        let [low, high] = version.patch.to_le_bytes();
        [version.major, version.minor, low, high]
    }
}

/// As GetInfo has it: no patch.
impl From<ImageVersion> for Version {
    fn from(version: ImageVersion) -> Self {
        Self { major: version.major, minor: version.minor }
    }
}

impl fmt::Display for ImageVersion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}.{}", self.major, self.minor, self.patch)
    }
}

/// A text that is no version.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VersionError;

impl fmt::Display for VersionError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a version is MAJOR.MINOR.PATCH, up to 255.255.65535")
    }
}

impl core::error::Error for VersionError {}

impl FromStr for ImageVersion {
    type Err = VersionError;

    fn from_str(text: &str) -> Result<Self, VersionError> {
        Self::parse(text.as_bytes()).ok_or(VersionError)
    }
}

/// What stands before a payload.
#[derive(Clone, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "as in the layout above")]
pub struct Header {
    pub target: UpdateTarget,
    /// The board it is for; 0 for any.
    pub board: u16,
    pub version: ImageVersion,
    /// Bytes of the payload.
    pub length: u32,
    pub sha256: [u8; 32],
}

impl Header {
    /// The bytes that a signature is made of.
    pub fn signed_bytes(&self) -> [u8; SIGNED_BYTES] {
        let mut bytes = [0; SIGNED_BYTES];
        let mut writer = Writer::new(&mut bytes);
        writer.put(&MAGIC);
        writer.put(&FORMAT_VERSION.to_le_bytes());
        writer.put(&self.board.to_le_bytes());
        writer.put(&[kind(self.target), 0]);
        writer.put(&<[u8; 4]>::from(self.version));
        writer.put(&[0; 2]);
        writer.put(&self.length.to_le_bytes());
        writer.put(&self.sha256);
        bytes
    }

    /// The header, with the signature that was made of [`signed_bytes`](Self::signed_bytes).
    pub fn encode(&self, signature: &[u8; 64]) -> [u8; HEADER_BYTES] {
        let mut bytes = [0; HEADER_BYTES];
        let mut writer = Writer::new(&mut bytes);
        writer.put(&self.signed_bytes());
        writer.put(signature);
        bytes
    }

    /// Read a header and prove that the holder of the private half of one of `keys` signed it. Everything in it is
    /// part of what is signed.
    pub fn verify(bytes: &[u8; HEADER_BYTES], keys: &Keys) -> Result<Self, Refusal> {
        let header = Self::read(bytes)?;
        let (signed, signature) = bytes.split_at(SIGNED_BYTES);
        if signature.iter().all(|&byte| byte == 0) {
            return Err(Refusal::Unsigned);
        }
        let signature = signature.first_chunk().ok_or(Refusal::ShorterThanHeader)?;
        key::verify(signed, signature, keys)?;
        header.ok_or(Refusal::UnknownFormat)
    }

    /// What the header says, whoever wrote it. `Ok(None)`: fields that this version does not know.
    fn read(bytes: &[u8; HEADER_BYTES]) -> Result<Option<Self>, Refusal> {
        let mut rest = bytes.as_slice();
        if take(&mut rest) != MAGIC {
            return Err(Refusal::NoHeader);
        }
        if u16::from_le_bytes(take(&mut rest)) != FORMAT_VERSION {
            return Err(Refusal::UnknownFormat);
        }
        let board = u16::from_le_bytes(take(&mut rest));
        let [kind, zero] = take(&mut rest);
        let version = ImageVersion::from(take::<4>(&mut rest));
        let zeros: [u8; 2] = take(&mut rest);
        let length = u32::from_le_bytes(take(&mut rest));
        let sha256 = take(&mut rest);
        let reserved: [u8; 8] = take(&mut rest);
        if zero != 0 || zeros != [0; 2] || reserved != [0; 8] {
            return Ok(None);
        }
        let target = match kind {
            1 => UpdateTarget::Firmware,
            2 => UpdateTarget::Model,
            _ => return Ok(None),
        };
        Ok(Some(Self { target, board, version, length, sha256 }))
    }

    /// What the header says, its signature not looked at: for showing it.
    pub fn inspect(bytes: &[u8; HEADER_BYTES]) -> Result<Self, Refusal> {
        Self::read(bytes)?.ok_or(Refusal::UnknownFormat)
    }

    /// May this image be installed as `target` on `board`, where `floor` is the version that it may not be below and there
    /// is room for `room` bytes?
    pub fn admit(
        &self,
        target: UpdateTarget,
        board: &Partitions,
        floor: ImageVersion,
        room: u32,
    ) -> Result<(), Refusal> {
        if self.target != target {
            return Err(Refusal::WrongKind);
        }
        if self.board != board.id && (self.board != ANY_BOARD || target == UpdateTarget::Firmware) {
            return Err(Refusal::WrongBoard);
        }
        if self.version < floor {
            return Err(Refusal::Older);
        }
        if self.length == 0 {
            return Err(Refusal::Empty);
        }
        if self.length > room {
            return Err(Refusal::TooLong);
        }
        Ok(())
    }
}

const fn kind(target: UpdateTarget) -> u8 {
    match target {
        UpdateTarget::Firmware => 1,
        UpdateTarget::Model => 2,
    }
}

/// The first bytes; zeros where there are none.
fn take<const N: usize>(rest: &mut &[u8]) -> [u8; N] {
    let (taken, behind) = rest.split_first_chunk().unwrap_or((&[0; N], &[]));
    *rest = behind;
    *taken
}
