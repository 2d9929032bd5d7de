//! What each family of physics is good for: a network is trained without it, and judged on every family of its stage
//! beside one that was trained on all.

mod command;
mod picture;
mod results;

pub use command::{LeaveOutArgs, run_leave_out};
