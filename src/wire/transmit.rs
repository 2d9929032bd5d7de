//! From messages to CAN frames, and the transfer identifiers of each port.

use super::compress::{COMPRESSED_FRAME_BYTES, COMPRESSED_PORT, Detail};
use super::cyphal::{CanFrame, FRAME_PAYLOAD, Frames, Segmenter, next_transfer};
use super::id::{MessageId, NodeId};
use super::raw::{RAW_PORT, RAW_PRIORITY, RawBuffer, RawFrame};
use super::slip::{SLIP_PORT, SLIP_PRIORITY, SlipMessage};

/// Turns messages into CAN frames and keeps the transfer identifier of each port.
#[derive(Clone, Debug)]
pub struct Transmitter {
    node: NodeId,
    slip_transfer: u8,
    raw_transfer: u8,
    compressed_transfer: u8,
}

impl Transmitter {
    /// For messages from `node`. Transfer identifiers start at 0.
    pub const fn new(node: NodeId) -> Self {
        Self { node, slip_transfer: 0, raw_transfer: 0, compressed_transfer: 0 }
    }

    /// Send from another node. Transfer identifiers go on.
    pub const fn set_node_id(&mut self, node: NodeId) {
        self.node = node;
    }

    /// The one frame of a slip message, its CRC computed here.
    pub fn slip(&mut self, message: &SlipMessage) -> CanFrame {
        let id = MessageId { priority: SLIP_PRIORITY, port: SLIP_PORT, node: self.node };
        CanFrame::single(id, next_transfer(&mut self.slip_transfer), &message.encode(self.node))
    }

    /// The 23 to 29 frames of one sensor's readings, in the order they must be sent; `buffer` holds the encoded message.
    /// None where neither part delivered: the slip message reports that.
    pub fn raw<'b>(
        &mut self,
        frame: &RawFrame<'_>,
        buffer: &'b mut RawBuffer,
    ) -> impl Iterator<Item = CanFrame> + use<'b> {
        self.raw_as(RawForm::Plain, frame, buffer)
    }

    /// As [`raw`](Self::raw), in either form: compressed, 1 to 39 frames of at most [`COMPRESSED_FRAME_BYTES`].
    pub fn raw_as<'b>(
        &mut self,
        form: RawForm,
        frame: &RawFrame<'_>,
        buffer: &'b mut RawBuffer,
    ) -> impl Iterator<Item = CanFrame> + use<'b> {
        let frames = frame.delivers().then(|| {
            let (id, transfer) = self.next_raw(form);
            Frames::with_payload(id, transfer, form.encode(frame, buffer), form.frame_payload())
        });
        frames.into_iter().flatten()
    }

    /// As [`raw_as`](Self::raw_as), into a buffer from which the frames are taken later. `false`: there is nothing to
    /// send, and `into` is as it was.
    pub fn start_raw(&mut self, form: RawForm, frame: &RawFrame<'_>, into: &mut RawTransfer) -> bool {
        let delivered = frame.delivers();
        if delivered {
            let (id, transfer) = self.next_raw(form);
            let encoded = form.encode(frame, &mut into.buffer);
            into.length = encoded.len();
            into.segmenter = Some(Segmenter::new(id, transfer, encoded, form.frame_payload()));
        }
        delivered
    }

    /// Drop a raw message that the bus has no room for. Its transfer identifier is used, so that the receiver counts it as
    /// missed. `false`: there was nothing to send.
    pub fn skip_raw(&mut self, form: RawForm, frame: &RawFrame<'_>) -> bool {
        let delivered = frame.delivers();
        if delivered {
            self.next_raw(form);
        }
        delivered
    }

    fn next_raw(&mut self, form: RawForm) -> (MessageId, u8) {
        let (port, counter) = match form {
            RawForm::Plain => (RAW_PORT, &mut self.raw_transfer),
            RawForm::Compressed(_) => (COMPRESSED_PORT, &mut self.compressed_transfer),
        };
        (MessageId { priority: RAW_PRIORITY, port, node: self.node }, next_transfer(counter))
    }
}

/// How a raw frame goes onto the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RawForm {
    /// `slipsense.Raw`: any Cyphal client reads it, one sensor fits a bus of 1/8 Mbit/s.
    Plain,
    /// `slipsense.RawCompressed`: three sensors fit.
    Compressed(Detail),
}

impl RawForm {
    /// Bytes of the message in each CAN frame but the last.
    const fn frame_payload(self) -> usize {
        match self {
            Self::Plain => FRAME_PAYLOAD,
            Self::Compressed(_) => COMPRESSED_FRAME_BYTES - 1,
        }
    }

    fn encode<'b>(self, frame: &RawFrame<'_>, buffer: &'b mut RawBuffer) -> &'b [u8] {
        match self {
            Self::Plain => frame.encode(buffer),
            Self::Compressed(detail) => frame.compress(detail, buffer),
        }
    }
}

/// A raw message between the task that makes it and the task that sends it: encoded once, with its CRC, and
/// segmented into CAN frames one at a time. Filled by [`Transmitter::start_raw`].
#[derive(Clone, Debug)]
pub struct RawTransfer {
    buffer: RawBuffer,
    /// Bytes of `buffer` in use.
    length: usize,
    segmenter: Option<Segmenter>,
}

impl RawTransfer {
    /// Nothing to send.
    pub const fn new() -> Self {
        Self { buffer: RawBuffer::new(), length: 0, segmenter: None }
    }

    /// The next CAN frame, 39 in all at most; `None` when all have been taken.
    pub fn next_frame(&mut self) -> Option<CanFrame> {
        self.segmenter.as_mut()?.next(self.buffer.bytes(self.length))
    }
}
