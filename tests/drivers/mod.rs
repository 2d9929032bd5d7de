//! Sensor drivers against parts of registers and bytes, and the arithmetic of the scan against its definition.

mod array;
mod calibrated;
mod decimate;
pub mod fake;
mod faults;
mod first_slip;
mod framing;
mod sample_count;
mod scan;
mod sensors;
mod wiring;
