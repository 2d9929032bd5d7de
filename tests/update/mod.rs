//! Updates: what is refused, and what is left after a power cut at any step.

mod bus;
mod device;
pub mod flash;
mod format;
mod installed;
mod power_cuts;
mod refusals;
mod rollback;
