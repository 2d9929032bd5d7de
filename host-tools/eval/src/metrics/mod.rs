//! The metrics, each in its own file with its definition.

pub mod alarms;
pub mod bootstrap;
pub mod cdf;
pub mod events;
pub mod false_slip;
pub mod frames;
pub mod groups;
pub mod operating;
pub mod pairs;
pub mod record;
pub mod statistics;
