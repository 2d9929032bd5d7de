//! What the node counts.

/// What the node's own traffic met with, since start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Frames that are none of Cyphal's.
    pub foreign_frames: u32,
    /// Frames that broke a transfer, or transfers given up for another sender.
    pub transfer_errors: u32,
    /// Messages of another node with this node's address, frames.
    pub address_conflicts: u32,
    /// Transfers of this node dropped because [`Node::next_frame`](super::Node::next_frame) was not called often enough.
    pub dropped_transfers: u32,
}
