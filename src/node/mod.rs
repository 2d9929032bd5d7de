//! The board as a node of a Cyphal bus: what it is, how it is, what can be set, and how it takes an update.
//!
//! [`Node`] does no input or output and has no clock. A task feeds it frames and the time, and does what it
//! asks for:
//!
//! ```text
//!  frames ──> accept(frame, now) ─┐                     ┌─> next_frame()  to the bus, in order
//!  time   ──> poll(now) ──────────┼─ services, settings ┼─> take_action() restart, store, …
//!  tasks  ──> status, report() ───┘                     ├─> take_changed() settings to apply
//!                                                       └─> take_chunk()  a piece of a file
//! ```
//!
//! One file is one service; the types are OpenCyphal's public regulated data types. Everything has its place
//! in fixed memory: what does not fit is dropped whole and counted.
#![allow(clippy::large_enum_variant, reason = "a box would need an allocator")]

mod action;
mod allocation;
mod command;
mod counters;
mod diagnostic;
mod fields;
mod file_read;
mod get_info;
mod heartbeat;
mod identity;
mod lock;
mod machine;
mod outbox;
mod registers;
mod time_sync;

pub use action::Action;
pub use allocation::{ALLOCATION_PORT, REQUEST_PERIOD_MAX_US};
pub use command::{
    BEGIN_MODEL_UPDATE, BEGIN_SOFTWARE_UPDATE, CALIBRATE, COMMAND_PORT, CommandStatus, FACTORY_RESET,
    IDENTIFY, RESTART, SCALE_GAIN, SELF_TEST, STORE, UNLOCK,
};
pub use counters::Counters;
pub use diagnostic::{
    CALIBRATION_LINE, RECORD_BYTES, RECORD_PORT, RECORD_TEXT_MAX, Severity, encode as encode_record,
};
pub use file_read::{
    ANSWER_TIMEOUT_US, CHUNK_BYTES, Chunk, FILE_READ_PORT, FileFailure, FilePath, FileRef, FileSink,
    PATH_MAX, TRIES, UpdateTarget,
};
pub use get_info::GET_INFO_PORT;
pub use heartbeat::{HEARTBEAT_PERIOD_US, HEARTBEAT_PORT, Mode, vendor_status};
pub use identity::{COMMIT, Identity, NODE_NAME, PROTOCOL_VERSION, Version};
pub use lock::{CHALLENGE_BYTES, SIGNATURE_BYTES, UNLOCK_PREFIX};
pub use machine::{COMMAND_TIMEOUT_US, Node, SIGNATURE_PAUSE_US, STORE_PAUSE_US};
pub use registers::{ACCESS_PORT, LIST_PORT, REGISTERS};
pub use time_sync::{JUMP_OFFSETS, TIME_PORT};
