//! What goes on the bus: OpenCyphal messages over CAN FD, encode and decode side by side.
//!
//! Once per frame the pipeline's decision becomes one [`SlipMessage`], and every sensor's readings one
//! [`RawFrame`]. The [`Transmitter`] numbers the transfers and cuts them into [`CanFrame`]s: the slip
//! message is exactly one frame and is queued first, then 23 to 29 frames per sensor follow, 26 at the nominal 33 samples,
//! or what is left of them [compressed](compress). A
//! [`Receiver`] puts frames together again. The same code runs on the microcontroller and on the host;
//! nothing here allocates. Service calls and the messages of other nodes go through [`TransferId`] and
//! [`Sessions`]; what they mean is [`crate::node`]'s. The layouts are also written as DSDL in `src/wire/dsdl`, from which any
//! Cyphal client decodes them.
//!
//! Order in the queue alone does not put the slip message first on the bus: a transfer of another
//! node, or raw frames left over from the period before, may be ahead of it. Its priority does,
//! because the priority leads the identifier that CAN arbitrates on. See [`SLIP_PRIORITY`].

pub(crate) mod bytes;
pub mod compress;
mod cyphal;
mod raw;
mod raw_transfer;
mod receive;
mod service;
mod sessions;
mod slip;

pub use bytes::DecodeError;
pub use compress::{COMPRESSED_BYTES_MAX, Detail, Region};
pub use cyphal::{
    CAN_ID_MAX, CanFrame, FD_LENGTHS, FRAME_PAYLOAD, Frames, IdError, LengthError, MessageId, NodeId,
    Priority, crc16, fd_length,
};
pub use raw::{RAW_BYTES_MAX, RAW_XL_MAX, RawBuffer, RawFrame, RawMessage};
pub use raw_transfer::RawTransfer;
pub use receive::{Reassembler, ReceiveError, Received, Receiver, Transfer, TransferError};
pub use service::{AnonymousId, SERVICE_PORT_MAX, ServiceId, ServiceRole, TransferId};
pub use sessions::{Arrived, SessionError, Sessions, TRANSFER_TIMEOUT_US};
pub use slip::{SLIP_BYTES, SensorContact, SlipMessage};

/// Subject identifier of [`SlipMessage`]: `slipsense.Slip.1.0`. 6144 to 7167 is the range that Cyphal
/// reserves for fixed identifiers of vendors.
pub const SLIP_PORT: u16 = 6200;
/// Subject identifier of [`RawFrame`]: `slipsense.Raw.1.0`, all sensors.
pub const RAW_PORT: u16 = 6201;
/// Subject identifier of a [`RawFrame`] compressed: `slipsense.RawCompressed.1.0`, all sensors.
pub const COMPRESSED_PORT: u16 = 6202;

/// Ahead of all control traffic of a robot (Fast and below), so that the slip message waits for at
/// most the one frame already on the wire. Exceptional stays free for the emergency stop of whoever
/// builds the robot.
pub const SLIP_PRIORITY: Priority = Priority::Immediate;
/// Raw frames fill most of the bus, so they give way to everything but optional traffic.
pub const RAW_PRIORITY: Priority = Priority::Slow;

/// Bytes of a full CAN frame of a compressed raw message. Not the 64 that CAN FD allows: a slip message waits for the
/// frame on the wire, and at 1/8 Mbit/s both together may take a quarter of a millisecond. That costs a seventh more of
/// the bus for the same bytes; compressed, there is room for it.
pub const COMPRESSED_FRAME_BYTES: usize = 48;

/// Bits of the health byte of a sensor; more than one may be set, 0 is a healthy sensor.
pub mod health {
    /// No array scan for this frame; its taxels are sent as zeros.
    pub const PIEZO_MISSING: u8 = 1;
    /// The accelerometer delivered nothing for this frame.
    pub const XL_MISSING: u8 = 2;
    /// Fewer samples than one analysis window so far.
    pub const XL_WARMING_UP: u8 = 4;
    /// An accelerometer sample at full scale.
    pub const XL_CLIPPED: u8 = 8;
    /// A taxel at full scale.
    pub const TAXELS_SATURATED: u8 = 16;
    /// Accelerometer samples were lost before the front end.
    pub const XL_SAMPLES_DROPPED: u8 = 32;
    /// The node has no readable model: class, flag and logits of the message mean nothing.
    pub const NO_MODEL: u8 = 64;
    /// Taxels are masked by a setting of the node: they read 0 here and for the network.
    pub const TAXELS_MASKED: u8 = 128;
}

/// Turns messages into CAN frames and keeps the transfer identifier of each port.
#[derive(Clone, Debug)]
pub struct Transmitter {
    node: NodeId,
    slip_transfer: u8,
    raw_transfer: u8,
    compressed_transfer: u8,
}

impl Transmitter {
    /// A transmitter that speaks as `node`. Transfer identifiers start at 0.
    pub const fn new(node: NodeId) -> Self {
        Self { node, slip_transfer: 0, raw_transfer: 0, compressed_transfer: 0 }
    }

    /// From now on speak as `node`. Transfer identifiers go on.
    pub const fn speak_as(&mut self, node: NodeId) {
        self.node = node;
    }

    /// The one frame of a slip message.
    pub fn slip(&mut self, message: &SlipMessage) -> CanFrame {
        let id = MessageId { priority: SLIP_PRIORITY, port: SLIP_PORT, node: self.node };
        CanFrame::single(id, next_transfer(&mut self.slip_transfer), &message.encode())
    }

    /// The 23 to 29 frames of one sensor's readings, in the order they must be sent. `buffer` holds
    /// the encoded message while the frames are taken from it. None where neither part delivered: the
    /// slip message says so already, and zeros would only load the bus.
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
            Frames::of_size(id, transfer, form.encode(frame, buffer), form.frame_payload())
        });
        frames.into_iter().flatten()
    }

    /// As [`raw_as`](Self::raw_as), into a buffer from which the frames are taken later. `false`: there is nothing to
    /// send, and `into` is as it was.
    pub fn raw_later(&mut self, form: RawForm, frame: &RawFrame<'_>, into: &mut RawTransfer) -> bool {
        let delivered = frame.delivers();
        if delivered {
            let (id, transfer) = self.next_raw(form);
            into.fill(id, transfer, form, frame);
        }
        delivered
    }

    /// Give up a raw message that the bus has no room for. Its transfer identifier is used up all the same, so
    /// that the receiver counts it as missed. `false`: there was nothing to send.
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

/// The 5-bit transfer identifier to use now; the counter moves on.
pub(crate) fn next_transfer(counter: &mut u8) -> u8 {
    let now = *counter;
    *counter = now.wrapping_add(1) & cyphal::TRANSFER_ID_MAX;
    now
}
