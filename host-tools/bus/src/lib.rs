//! CAN FD traffic as a candump log, the text format of Linux' can-utils, which python-can, pycyphal and
//! SavvyCAN read too. One frame a line:
//!
//! ```text
//! (1700000000.004167) can0 0478382A##1002D3104...
//! ```
//!
//! Seconds since 1970 with microseconds, interface, identifier in hexadecimal (8 digits: 29 bits), two
//! number signs for CAN FD, one digit of flags (1: bit rate switching), data in hexadecimal.

mod read;
mod write;

pub use read::{CandumpError, CandumpReader, LogEntry, Rule};
pub use write::{CandumpWriter, InterfaceError};
