//! What a node is: fixed while it runs.

use crate::net::format::HASH_BYTES;
use crate::settings::LoadReport;

/// The name of every node of this firmware.
pub const NODE_NAME: &str = "slipsense.fingertip";
/// Version of the Cyphal protocol.
pub const PROTOCOL_VERSION: Version = Version { major: 1, minor: 0 };

/// The first 64 bits of the git commit that the firmware is built from; 0 where the build does not know it: on a
/// computer, or from sources without repository.
pub const COMMIT: u64 = match option_env!("SLIPSENSE_COMMIT") {
    Some(hex) if hex.len() >= 16 => match u64::from_str_radix(hex.split_at(16).0, 16) {
        Ok(leading) => leading,
        Err(_) => panic!("SLIPSENSE_COMMIT is not hexadecimal"),
    },
    Some(_) => panic!("SLIPSENSE_COMMIT has fewer than 16 digits"),
    None => 0,
};

/// A version, as Cyphal counts them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Version {
    /// Raised by what breaks.
    pub major: u8,
    /// Raised by what is added.
    pub minor: u8,
}

impl Version {
    /// The version of this library, and with it of the firmware.
    pub const SOFTWARE: Self = Self {
        major: decimal(env!("CARGO_PKG_VERSION_MAJOR")),
        minor: decimal(env!("CARGO_PKG_VERSION_MINOR")),
    };
}

const fn decimal(text: &str) -> u8 {
    match u8::from_str_radix(text, 10) {
        Ok(number) => number,
        Err(_) => panic!("the package's version does not fit a Cyphal version"),
    }
}

/// What a node is.
#[derive(Clone, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the fields are named after what they are")]
pub struct Identity {
    pub hardware_version: Version,
    pub software_version: Version,
    /// The first 64 bits of the git commit it was built from, [`COMMIT`] in a firmware; 0: not known.
    pub vcs_revision: u64,
    /// 128 bits that no other node has, not all zero. The STM32's 96-bit unique identifier, padded.
    pub unique_id: [u8; 16],
    /// SHA-256 of the model file; `None`: there is no readable model.
    pub model_hash: Option<[u8; HASH_BYTES]>,
    /// How loading the settings went.
    pub settings: LoadReport,
    /// A random number that no other start has, for the challenge of the lock; `None`: the board has none.
    pub entropy: Option<u64>,
}

impl Identity {
    /// What GetInfo gives as `software_image_crc`, for which the standard asks for a hash of any kind: the
    /// first eight bytes of the model's SHA-256, first byte highest, as `slipsense model info` prints them.
    /// Firmware is identified by the commit, so that both together say what runs.
    pub fn model_revision(&self) -> Option<u64> {
        let hash = self.model_hash?;
        hash.first_chunk().map(|bytes| u64::from_be_bytes(*bytes))
    }
}
