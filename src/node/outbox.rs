//! Frames on their way to the bus, in the order they must be sent.

use heapless::Deque;

use crate::wire::{CanFrame, Frames};

/// Frames that wait at most: four of the longest answers and then some.
const OUTBOX_FRAMES: usize = 32;

/// A bounded queue of transfers. One that does not fit is dropped whole and counted: half a transfer is
/// noise.
#[derive(Clone, Debug, Default)]
pub(super) struct Outbox {
    frames: Deque<CanFrame, OUTBOX_FRAMES>,
    /// Transfers dropped since start.
    pub dropped: u32,
}

impl Outbox {
    #[inline(never)]
    pub fn push(&mut self, transfer: Frames<'_>) {
        if transfer.len() > OUTBOX_FRAMES - self.frames.len() {
            self.dropped = self.dropped.saturating_add(1);
            return;
        }
        for frame in transfer {
            // There is room: counted above.
            let _ = self.frames.push_back(frame);
        }
    }

    pub fn pop(&mut self) -> Option<CanFrame> {
        self.frames.pop_front()
    }

    /// Drop everything, and count it; with the heartbeat, which waits beside the queue.
    pub fn discard(&mut self, heartbeat: bool) {
        let transfers =
            usize::from(heartbeat) + self.frames.iter().filter(|frame| frame.ends_transfer()).count();
        self.dropped = self.dropped.saturating_add(transfers as u32);
        self.frames.clear();
    }

    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// Is half of the queue free? What is only nice to know asks first.
    pub fn is_half_free(&self) -> bool {
        self.frames.len() <= OUTBOX_FRAMES / 2
    }
}
