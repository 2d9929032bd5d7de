//! One encoded raw message that waits for the bus, and how much of it has gone.

use super::RawForm;
use super::cyphal::{CanFrame, Cut, MessageId};
use super::raw::{RawBuffer, RawFrame};

/// A raw message between the task that makes it and the task that sends it: encoded once, with its CRC, and cut
/// into CAN frames one at a time. Filled by [`Transmitter::raw_later`](super::Transmitter::raw_later).
#[derive(Clone, Debug)]
pub struct RawTransfer {
    buffer: RawBuffer,
    /// Bytes of `buffer` in use.
    length: usize,
    cut: Option<Cut>,
}

impl RawTransfer {
    /// Nothing to send.
    pub const fn new() -> Self {
        Self { buffer: RawBuffer::new(), length: 0, cut: None }
    }

    pub(super) fn fill(&mut self, id: MessageId, transfer: u8, form: RawForm, frame: &RawFrame<'_>) {
        let encoded = form.encode(frame, &mut self.buffer);
        self.length = encoded.len();
        self.cut = Some(Cut::new(id, transfer, encoded, form.frame_payload()));
    }

    /// The next CAN frame, 39 in all at most; `None` when all have been taken.
    pub fn next_frame(&mut self) -> Option<CanFrame> {
        self.cut.as_mut()?.next(self.buffer.bytes(self.length))
    }
}

impl Default for RawTransfer {
    fn default() -> Self {
        Self::new()
    }
}
