//! uavcan.pnp.NodeIDAllocationData.2.0, subject 8165: a node without address asks for one.
//!
//! It asks at random moments, on average twice a second, without a sender, until an allocator answers with its unique
//! identifier. Chance comes from that and the moment, so that two boards that start together part.

use super::fields::Fields;
use crate::wire::bytes::Writer;
use crate::wire::{AnonymousId, NodeId, Priority, crc16};

/// Subject of uavcan.pnp.NodeIDAllocationData.2.0.
pub const ALLOCATION_PORT: u16 = 8_165;
/// Longest time between two requests, µs.
pub const REQUEST_PERIOD_MAX_US: u64 = 1_000_000;
/// The address asked for: the highest that is not for tools.
const PREFERRED: u16 = 125;
const BYTES: usize = 18;

#[derive(Clone, Debug)]
pub(super) struct Allocation {
    unique_id: [u8; 16],
    chance: u64,
    /// When the next request is due.
    pub next_us: Option<u64>,
    pub transfer: u8,
}

impl Allocation {
    pub fn new(unique_id: [u8; 16]) -> Self {
        let (a, b) = (crc16(&unique_id), crc16(unique_id.get(1..).unwrap_or(&[])));
        // Not 0, from which xorshift never leaves.
        let chance = u64::from(a) << 32 | u64::from(b) << 8 | 1;
        Self { unique_id, chance, next_us: None, transfer: 0 }
    }

    /// The request, if it is due, and its identifier.
    pub fn poll(&mut self, now_us: u64) -> Option<(AnonymousId, [u8; BYTES])> {
        let due = self.next_us.is_some_and(|next| now_us >= next);
        if due || self.next_us.is_none() {
            self.next_us = Some(now_us.saturating_add(self.wait_us(now_us)));
        }
        due.then(|| {
            let mut payload = [0; BYTES];
            let mut writer = Writer::new(&mut payload);
            writer.put(&PREFERRED.to_le_bytes());
            writer.put(&self.unique_id);
            let pseudo_source = crc16(&payload) as u8 & 127;
            (AnonymousId { priority: Priority::Slow, port: ALLOCATION_PORT, pseudo_source }, payload)
        })
    }

    /// The address in an allocator's answer, if it is for us.
    pub fn accept(&self, payload: &[u8]) -> Option<NodeId> {
        let mut fields = Fields::new(payload);
        let node = fields.unsigned::<2>();
        let ours = fields.slice(16) == self.unique_id;
        u8::try_from(node).ok().filter(|_| ours).and_then(NodeId::new)
    }

    /// xorshift64, stirred with the moment.
    fn wait_us(&mut self, now_us: u64) -> u64 {
        self.chance ^= now_us << 1;
        self.chance ^= self.chance << 13;
        self.chance ^= self.chance >> 7;
        self.chance ^= self.chance << 17;
        self.chance |= u64::from(self.chance == 0);
        self.chance % REQUEST_PERIOD_MAX_US
    }
}
