//! What runs above the seam: acquisition fills a bounded queue of frame buffers, inference empties it and makes
//! messages, transmission brings them onto the bus. What they share is [`Shared`], and no task waits for another
//! one's work.
//!
//! ```text
//!             frame queue                 slip: the newest ──────┐
//! acquire ──────────────────> Inference ─ raw: bounded, dropped ─┴> Transmission ──> CanTransmit
//! (interrupt)                 (thread)             whole       ┌─> (interrupt)
//!                             services ── bounded queue ───────┘
//! ```
//!
//! Nothing is lost in silence:
//!
//! | what | when | counted in [`Status`](crate::health::Status) |
//! |---|---|---|
//! | a frame, whole | no buffer free at its tick | `dropped_frames` |
//! | a slip message | a newer one is there and the bus has not taken it | `replaced_slips` |
//! | a raw message, whole | no room in the queue, or off the bus | `dropped_raw` |
//! | a raw message, cut off | the node drops off the bus while it is sent | `broken_raw` |
//! | a service frame | no room in the queue; a heartbeat: the one before still waits | `refused_services` |
//! | a service frame | the node drops off the bus while the hardware holds it | `lost_services` |
//!
//! Compressed raw messages get shorter before they get lost (`rate_control.rs`): the slip message goes first, then every
//! sensor's accelerometer, then the taxels of the contacts, then the rest. A receiver sees in each what it holds.
//!
//! A raw message that has been begun is finished before the next, however long that takes: a receiver could make
//! nothing of the part that it has. The one exception is bus-off, over which a rest would come late by seconds; the
//! receiver sees the next transfer begin and throws the part away.

mod acquire;
mod infer;
mod rate_control;
mod self_check;
mod services;
mod shared;
mod supervise;
mod transmit;

pub use acquire::{QUEUED_FRAMES, acquire};
pub use infer::Inference;
pub use self_check::{
    CheckedMemory, GOLDEN_FRAMES, GOLDEN_PERIOD_FRAMES, RAM_SLICE_BYTES, RamPart, Reference, SLICE_BYTES,
    SelfCheck, digest, known_golden,
};
pub use services::{ServiceBoard, Services};
pub use shared::{RAW_MESSAGES, RawQueue, RuntimeConfig, SERVICE_FRAMES, Shared};
pub use supervise::{Progress, StallWatch, Supervisor, Task};
pub use transmit::Transmission;
