//! What goes on the bus: OpenCyphal messages over CAN FD, encode and decode side by side.
//!
//! A frame's decision is one [`SlipMessage`], every sensor's readings are one [`RawFrame`]. The [`Transmitter`] numbers
//! the transfers and segments them into [`CanFrame`]s: one of the slip message, which is queued first, then per sensor
//! 23 to 29 (26 at the nominal 33 samples), or fewer [compressed](compress). A [`Receiver`] reassembles them. Nothing
//! here allocates. Service calls and messages of other nodes go through [`TransferId`] and [`Sessions`]; their meaning
//! is in [`crate::node`]. `src/wire/dsdl` has the layouts as DSDL, from which any Cyphal client decodes them.
//!
//! The slip message's place in the queue does not make it first on the bus: frames of another node or of the period
//! before may be ahead. Its priority does, the leading bits of the identifier that CAN arbitrates on: [`SLIP_PRIORITY`].

pub(crate) mod bytes;
pub mod compress;
mod cyphal;
mod id;
mod raw;
mod region;
mod receive;
mod sessions;
mod slip;
mod slip_receiver;
mod transmit;

pub use bytes::DecodeError;
pub use compress::{COMPRESSED_BYTES_MAX, COMPRESSED_FRAME_BYTES, COMPRESSED_PORT, Detail};
pub(crate) use cyphal::next_transfer;
pub use cyphal::{CanFrame, FD_LENGTHS, FRAME_PAYLOAD, Frames, LengthError, crc16, fd_length};
pub use id::{
    AnonymousId, CAN_ID_MAX, IdError, MessageId, NodeId, Priority, SERVICE_PORT_MAX, ServiceId, ServiceRole,
    TransferId,
};
pub use raw::{RAW_BYTES_MAX, RAW_PORT, RAW_PRIORITY, RAW_XL_MAX, RawBuffer, RawFrame, RawMessage};
pub use receive::{Reassembler, ReceiveError, Received, Receiver, Transfer, TransferError};
pub use region::Region;
pub use sessions::{SessionError, Sessions, TRANSFER_TIMEOUT_US};
pub(crate) use slip::{CRC_32, fold};
pub use slip::{
    DEGRADED_FROZEN, DEGRADED_LATE, DEGRADED_MISSING, DEGRADED_NOT_CALIBRATED, DEGRADED_POINT,
    DEGRADED_SELF_TEST, INVALID_MEMORY, INVALID_NETWORK, INVALID_NO_MODEL, INVALID_NO_SENSOR,
    INVALID_OTHER_MODEL, INVALID_STARTING, Origin, SLIP_1_PORT, SLIP_BYTES, SLIP_DATA_ID, SLIP_PORT,
    SLIP_PRIORITY, SensorContact, SlipMessage, WireLogit, wire_logit,
};
pub use slip_receiver::{Check, FlagState, SlipReceiver};
pub use transmit::{RawForm, RawTransfer, Transmitter};
