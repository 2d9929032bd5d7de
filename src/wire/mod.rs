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
mod id;
mod raw;
mod region;
mod receive;
mod sessions;
mod slip;
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
pub use sessions::{Arrived, SessionError, Sessions, TRANSFER_TIMEOUT_US};
pub use slip::{SLIP_BYTES, SLIP_PORT, SLIP_PRIORITY, SensorContact, SlipMessage};
pub use transmit::{RawForm, RawTransfer, Transmitter};
