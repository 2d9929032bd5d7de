//! The lock. A node that started locked refuses whatever would change it (settings, commands, updates) until a holder of
//! an update key unlocks it; the next start locks it again.
//!
//! Who unlocks reads the challenge, signs [`UNLOCK_PREFIX`] and the challenge, and sends the signature. A challenge
//! unlocks once: after it, or after a restart, there is another, so that nothing recorded on the bus unlocks. A wrong
//! signature leaves it as it is, or whoever sends one each second would lock the owner out.

use crate::wire::bytes::Writer;

/// First bytes of what is signed, so that no signature of an image unlocks.
pub const UNLOCK_PREFIX: &[u8; 16] = b"slipsense unlock";
/// Bytes of a challenge: the board's unique identifier, a random number of this start, how often it unlocked.
pub const CHALLENGE_BYTES: usize = 16 + 8 + 8;
/// Bytes of an Ed25519 signature.
pub const SIGNATURE_BYTES: usize = 64;

#[derive(Clone, Copy, Debug)]
pub(super) struct Lock {
    closed: bool,
    entropy: Option<u64>,
    unlocked: u64,
}

impl Lock {
    /// As it is at the start. `entropy`: a random number that no other start has; without one the node stays locked.
    pub const fn new(closed: bool, entropy: Option<u64>) -> Self {
        Self { closed, entropy, unlocked: 0 }
    }

    pub const fn is_closed(&self) -> bool {
        self.closed
    }

    /// What is to be signed, behind the prefix.
    pub fn challenge(&self, unique_id: &[u8; 16]) -> Option<[u8; CHALLENGE_BYTES]> {
        let mut out = [0; CHALLENGE_BYTES];
        let mut writer = Writer::new(&mut out);
        writer.put(unique_id);
        writer.put(&self.entropy?.to_le_bytes());
        writer.put(&self.unlocked.to_le_bytes());
        Some(out)
    }

    /// An attempt has been judged.
    pub fn tried(&mut self, valid: bool) {
        self.unlocked = self.unlocked.saturating_add(valid.into());
        self.closed &= !valid;
    }
}
