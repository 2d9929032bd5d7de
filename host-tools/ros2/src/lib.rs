//! The module in ROS 2: its messages, a node that publishes them, and recordings as bags.

pub mod bag;
mod diagnostics;
mod messages;
mod middleware;
mod module;
pub mod node;
mod services;
mod topics;
