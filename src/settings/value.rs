//! What a setting's numbers are on the bus and in flash.

/// Elements of the longest setting.
pub const ELEMENTS_MAX: usize = 32;

/// How the numbers of a setting or register are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the names say sign and bits")]
pub enum Kind {
    /// Off or on, 0 or 1.
    Bit,
    Integer64,
    Integer32,
    Integer16,
    Integer8,
    /// Unsigned, 64 bits, of which 63 are used here.
    Natural64,
    Natural32,
    Natural16,
    Natural8,
}

impl Kind {
    /// Bytes of one element; a bit takes one in flash and is packed on the bus.
    pub const fn bytes(self) -> usize {
        match self {
            Self::Bit | Self::Integer8 | Self::Natural8 => 1,
            Self::Integer16 | Self::Natural16 => 2,
            Self::Integer32 | Self::Natural32 => 4,
            Self::Integer64 | Self::Natural64 => 8,
        }
    }

    /// One element from its bytes, low byte first; `None` for a number that 63 bits do not hold.
    pub fn read(self, bytes: &[u8]) -> Option<i64> {
        let raw = bytes.iter().take(8).rev().fold(0u64, |value, &byte| value << 8 | u64::from(byte));
        Some(match self {
            Self::Bit | Self::Natural8 | Self::Natural16 | Self::Natural32 => raw as i64,
            Self::Natural64 => i64::try_from(raw).ok()?,
            Self::Integer8 => i64::from(raw as i8),
            Self::Integer16 => i64::from(raw as i16),
            Self::Integer32 => i64::from(raw as i32),
            Self::Integer64 => raw as i64,
        })
    }
}
