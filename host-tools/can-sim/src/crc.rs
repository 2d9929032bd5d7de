//! The three checksums, bit by bit, highest bit first.

/// A polynomial and where its register starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crc {
    pub width: u32,
    /// Without the leading one.
    pub polynomial: u32,
    /// Register before the first bit. ISO 11898-1:2015 starts CRC-17 and CRC-21 with their highest bit set, so that
    /// leading dominant bits count; Bosch's first version, and the published check values, start at 0.
    pub start: u32,
}

pub const CRC_15: Crc = Crc { width: 15, polynomial: 0x4599, start: 0 };
/// CAN FD up to 16 bytes.
pub const CRC_17: Crc = Crc { width: 17, polynomial: 0x1_685B, start: 1 << 16 };
/// CAN FD beyond 16 bytes.
pub const CRC_21: Crc = Crc { width: 21, polynomial: 0x10_2899, start: 1 << 20 };

impl Crc {
    /// The register after one more bit.
    pub const fn next(&self, register: u32, bit: bool) -> u32 {
        let out = register >> (self.width - 1) & 1 != 0;
        let shifted = register << 1 & ((1 << self.width) - 1);
        if out != bit { shifted ^ self.polynomial } else { shifted }
    }
}
