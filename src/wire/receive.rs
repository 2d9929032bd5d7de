//! Frames to transfers to messages. Frames may be lost, repeated, out of order or damaged: one that does not fit gives
//! one named error, and the next complete transfer is received whatever came before it.
//!
//! There is no clock in here: a transfer with the identifier of the last one is refused as a repetition even if it comes
//! much later, so a node that restarts can lose its first transfer. [`Sessions`](super::Sessions) has the clock.

use core::fmt;

use heapless::Vec;

use super::bytes::DecodeError;
use super::compress::{COMPRESSED_BYTES_MAX, COMPRESSED_FRAME_BYTES, COMPRESSED_PORT};
use super::cyphal::{
    CRC_BYTES, CanFrame, FRAME_PAYLOAD, MTU, TAIL_END, TAIL_START, TAIL_TOGGLE, TRANSFER_ID_MAX, crc16,
};
use super::id::{IdError, MessageId, NodeId};
use super::raw::{RAW_PORT, RawMessage};
use super::slip::{SLIP_1_PORT, SLIP_PORT, SlipMessage};

/// Bytes of the longest raw transfer, plain or compressed, as its frames carry it: with padding and CRC.
const RAW_TRANSFER_MAX: usize = COMPRESSED_BYTES_MAX + CRC_BYTES + PADDING_MAX;
/// From 49 bytes to the next length of CAN FD.
const PADDING_MAX: usize = MTU - 49;

/// Why a frame did not continue or complete a transfer, and the identifier of that transfer, 0 to 31.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the fields are named after what they are, and the text says it")]
pub enum TransferError {
    NoTail,
    /// The first frame of a transfer has toggle 0: another version of the protocol.
    Version,
    Repeated {
        transfer: u8,
    },
    NotStarted {
        transfer: u8,
    },
    /// Not the next frame: repeated, or an odd number before it is missing. It is skipped; the CRC tells of a missing one.
    Toggle {
        transfer: u8,
    },
    /// A frame before the last that is not full; its data, bytes.
    ShortFrame {
        transfer: u8,
        length: usize,
    },
    /// More bytes than there is room for, `capacity`: more than any message of this port has.
    TooLong {
        transfer: u8,
        capacity: usize,
    },
    Crc {
        transfer: u8,
    },
}

/// A complete transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transfer<'a> {
    /// Transfer identifier, 0 to 31.
    pub transfer: u8,
    /// Transfers lost since the previous complete one, modulo 32.
    pub missed: u8,
    /// The message and the zeros it was padded with.
    pub payload: &'a [u8],
}

/// Reassembles the transfers of one node and one port. `CAPACITY` bounds a transfer, with padding and
/// CRC, bytes.
#[derive(Clone, Debug)]
pub struct Reassembler<const CAPACITY: usize> {
    bytes: Vec<u8, CAPACITY>,
    /// Bytes of every frame's data but the last.
    full: usize,
    /// The transfer under way and the toggle bit of its next frame.
    open: Option<(u8, bool)>,
    /// The last complete transfer.
    last: Option<u8>,
}

impl<const CAPACITY: usize> Reassembler<CAPACITY> {
    /// Before the first frame.
    pub const fn new() -> Self {
        Self::with_frame_bytes(MTU)
    }

    /// As [`new`](Self::new), for a sender whose full frames have `full` bytes of data.
    pub const fn with_frame_bytes(full: usize) -> Self {
        Self { bytes: Vec::new(), full, open: None, last: None }
    }

    /// As if nothing had been received yet.
    pub fn reset(&mut self) {
        self.bytes.clear();
        self.open = None;
        self.last = None;
    }

    /// Is a transfer under way?
    pub const fn is_open(&self) -> bool {
        self.open.is_some()
    }

    /// Take the data of the next frame; `Some` when it completes a transfer.
    pub fn accept(&mut self, data: &[u8]) -> Result<Option<Transfer<'_>>, TransferError> {
        let (&tail, payload) = data.split_last().ok_or(TransferError::NoTail)?;
        let transfer = tail & TRANSFER_ID_MAX;
        let toggle = tail & TAIL_TOGGLE != 0;
        let end = tail & TAIL_END != 0;
        if tail & TAIL_START != 0 {
            self.start(transfer, toggle, payload)?;
        } else {
            match self.open.filter(|(open, _)| *open == transfer) {
                Some((_, expected)) if toggle != expected => return Err(TransferError::Toggle { transfer }),
                Some(_) => {}
                None => return Err(TransferError::NotStarted { transfer }),
            }
        }
        if !end && data.len() != self.full {
            self.open = None;
            return Err(TransferError::ShortFrame { transfer, length: data.len() });
        }
        if self.bytes.extend_from_slice(payload).is_err() {
            self.open = None;
            return Err(TransferError::TooLong { transfer, capacity: CAPACITY });
        }
        self.open = Some((transfer, !toggle));
        if end { self.finish(transfer, tail & TAIL_START == 0).map(Some) } else { Ok(None) }
    }

    /// A first frame. It ends a transfer under way, which counts as missed.
    fn start(&mut self, transfer: u8, toggle: bool, payload: &[u8]) -> Result<(), TransferError> {
        if !toggle {
            return Err(TransferError::Version);
        }
        if self.open == Some((transfer, false)) && self.bytes.len() + 1 == self.full {
            // The same first frame again: nothing is lost.
            self.bytes.clear();
            return Ok(());
        }
        // The same identifier with another content comes where 32 transfers, or a multiple, are lost.
        if self.last == Some(transfer) && self.bytes.starts_with(payload) {
            return Err(TransferError::Repeated { transfer });
        }
        self.bytes.clear();
        Ok(())
    }

    fn finish(&mut self, transfer: u8, several: bool) -> Result<Transfer<'_>, TransferError> {
        self.open = None;
        let mut payload = self.bytes.as_slice();
        if several {
            // Over a transfer and its CRC the CRC is 0.
            if crc16(payload) != 0 {
                return Err(TransferError::Crc { transfer });
            }
            payload = payload.get(..payload.len().saturating_sub(CRC_BYTES)).unwrap_or(&[]);
        }
        let missed = match self.last {
            Some(last) => transfer.wrapping_sub(last).wrapping_sub(1) & TRANSFER_ID_MAX,
            None => 0,
        };
        self.last = Some(transfer);
        Ok(Transfer { transfer, missed, payload })
    }
}

/// A message that arrived.
#[allow(clippy::large_enum_variant, reason = "a box would need an allocator")]
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Received {
    /// A slip message.
    Slip(SlipMessage),
    /// One sensor's raw frame, whichever way it came.
    Raw(RawMessage),
}

/// Why a frame did not lead to a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the fields are named after what they are")]
pub enum ReceiveError {
    /// Not the identifier of a message.
    Id(IdError),
    /// The transfer of this subject is damaged.
    Transfer { port: u16, error: TransferError },
    /// The transfer is whole, the message makes no sense.
    Message(DecodeError),
}

/// Receives the messages of one module: slip of either version, raw, and raw compressed. For recordings and displays; what
/// acts on the flag uses a [`SlipReceiver`](super::SlipReceiver).
#[derive(Clone, Debug)]
pub struct Receiver {
    node: NodeId,
    slip: Reassembler<FRAME_PAYLOAD>,
    slip_1: Reassembler<FRAME_PAYLOAD>,
    raw: Reassembler<RAW_TRANSFER_MAX>,
    compressed: Reassembler<RAW_TRANSFER_MAX>,
    missed_slip: u32,
    missed_raw: u32,
}

impl Receiver {
    /// For the messages of `node`.
    pub const fn new(node: NodeId) -> Self {
        let compressed = Reassembler::with_frame_bytes(COMPRESSED_FRAME_BYTES);
        Self {
            node,
            slip: Reassembler::new(),
            slip_1: Reassembler::new(),
            raw: Reassembler::new(),
            compressed,
            missed_slip: 0,
            missed_raw: 0,
        }
    }

    /// Take the next frame of the bus; `Some` when it completes a message. Messages of other nodes
    /// and ports are passed over.
    pub fn accept(&mut self, frame: &CanFrame) -> Result<Option<Received>, ReceiveError> {
        let id = MessageId::from_can(frame.id()).map_err(ReceiveError::Id)?;
        if id.node != self.node {
            return Ok(None);
        }
        let transfer = match id.port {
            SLIP_PORT => self.slip.accept(frame.data()),
            SLIP_1_PORT => self.slip_1.accept(frame.data()),
            RAW_PORT => self.raw.accept(frame.data()),
            COMPRESSED_PORT => self.compressed.accept(frame.data()),
            _ => return Ok(None),
        };
        let transfer = transfer.map_err(|error| ReceiveError::Transfer { port: id.port, error })?;
        let Some(Transfer { missed, payload, .. }) = transfer else { return Ok(None) };
        let count = match id.port {
            SLIP_PORT | SLIP_1_PORT => &mut self.missed_slip,
            _ => &mut self.missed_raw,
        };
        *count = count.saturating_add(missed.into());
        let message = match id.port {
            SLIP_PORT => SlipMessage::decode(self.node, payload).map(Received::Slip),
            SLIP_1_PORT => SlipMessage::decode_1(payload).map(Received::Slip),
            COMPRESSED_PORT => RawMessage::decompress(payload).map(Received::Raw),
            _ => RawMessage::decode(payload).map(Received::Raw),
        };
        message.map(Some).map_err(ReceiveError::Message)
    }

    /// Transfers lost so far, by their 5-bit identifiers: the sequence numbers of the messages tell of 32 and more.
    pub const fn missed(&self) -> u32 {
        self.missed_slip.saturating_add(self.missed_raw)
    }

    /// Those of them that had raw messages.
    pub const fn missed_raw(&self) -> u32 {
        self.missed_raw
    }

    /// The module has started again, so its raw messages are numbered anew: from there on none is missed yet.
    pub fn restart_raw(&mut self) {
        self.raw.reset();
        self.compressed.reset();
    }
}

impl fmt::Display for TransferError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoTail => f.write_str("empty frame, no tail byte"),
            Self::Version => f.write_str("first frame with toggle 0: not Cyphal 1.0"),
            Self::Repeated { transfer } => write!(f, "transfer {transfer} repeated"),
            Self::NotStarted { transfer } => write!(f, "transfer {transfer} has no first frame"),
            Self::Toggle { transfer } => {
                write!(f, "transfer {transfer}: frame repeated or one missing before it")
            }
            Self::ShortFrame { transfer, length } => {
                write!(f, "transfer {transfer}: frame of {length} bytes before the last")
            }
            Self::TooLong { transfer, capacity } => {
                write!(f, "transfer {transfer}: more than {capacity} bytes")
            }
            Self::Crc { transfer } => write!(f, "transfer {transfer}: CRC wrong"),
        }
    }
}

impl core::error::Error for TransferError {}

impl fmt::Display for ReceiveError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Id(error) => error.fmt(f),
            Self::Transfer { port, error } => write!(f, "port {port}, {error}"),
            Self::Message(error) => error.fmt(f),
        }
    }
}

impl core::error::Error for ReceiveError {}
