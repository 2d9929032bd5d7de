//! Reading the fields of Cyphal's regulated types: whole bytes, low byte first.
//!
//! Two rules of DSDL: a *response* or message that ends early continues with zeros, because an older sender does not
//! know the later fields. A *request* that changes something is taken as it stands or not at all.

/// Takes a message apart from its start.
pub(super) struct Fields<'a> {
    bytes: &'a [u8],
    beyond: bool,
}

impl<'a> Fields<'a> {
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, beyond: false }
    }

    /// An unsigned number of `N` bytes, at most 8; missing bytes are zeros.
    pub fn unsigned<const N: usize>(&mut self) -> u64 {
        self.slice(N).iter().rev().fold(0, |value, &byte| value << 8 | u64::from(byte))
    }

    /// The next bytes, fewer where the message ends.
    pub fn slice(&mut self, length: usize) -> &'a [u8] {
        let (slice, rest) = match self.bytes.split_at_checked(length) {
            Some(split) => split,
            None => {
                self.beyond = true;
                (self.bytes, &[][..])
            }
        };
        self.bytes = rest;
        slice
    }

    /// Was everything there that was read?
    pub fn is_whole(&self) -> bool {
        !self.beyond
    }
}
