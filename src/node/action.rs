//! What the node asks of the board.

use super::file_read::{FileRef, UpdateTarget};
use super::lock::SIGNATURE_BYTES;
use crate::calibration::Request;

/// What the board must do. Nothing here does it.
#[derive(Clone, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the fields are named after what they are")]
pub enum Action {
    /// Start anew, after [`Node::next_frame`](super::Node::next_frame) has given its last frame and that has gone out.
    Restart,
    /// Show which board this is.
    Identify,
    /// Store [`Node::settings`](super::Node::settings) in flash, then [`Node::command_done`](super::Node::command_done).
    Store,
    /// As [`Action::Store`]; the settings are at their defaults already.
    FactoryReset,
    /// Test the sensors, then [`Node::command_done`](super::Node::command_done).
    SelfTest,
    /// Check this signature of [`Node::challenge`](super::Node::challenge), then [`Node::unlock_done`](super::Node::unlock_done).
    Unlock([u8; SIGNATURE_BYTES]),
    /// Measure an array, or change its calibration; then [`Node::command_done`](super::Node::command_done): with a measurement when it has begun.
    Calibrate(Request),
    /// Make room for an update, then [`Node::begin_download`](super::Node::begin_download) or [`Node::report`](super::Node::report) why not.
    BeginUpdate { target: UpdateTarget, file: FileRef },
    /// The file is complete, `length` bytes, and the sink has accepted it. A firmware wants a restart; a model too,
    /// unless the board changes models while it runs.
    UpdateReceived { target: UpdateTarget, length: u32 },
    /// The file was given up; a diagnostic record has said why.
    UpdateFailed { target: UpdateTarget },
}
