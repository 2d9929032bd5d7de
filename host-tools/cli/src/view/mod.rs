//! What `slipsense view` serves: frames of an episode, a candump log or a live bus, to a page on this computer.
//!
//! ```text
//! episode ─> pipeline ──┐
//!                       ├─> Record ─> Store (bounded) ─> server ─> page, which draws and scrubs
//! candump ─> Receiver ──┘
//! ```
//!
//! One [`record`] layout carries all of them, so the page does not know where frames come from. It asks for the
//! ones that it shows; a server that has none yet answers when it has, and says when there will be no more.

pub mod record;
pub mod store;
pub mod source;
pub mod server;
#[cfg(test)]
mod tests;
