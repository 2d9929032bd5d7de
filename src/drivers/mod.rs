//! Sensor drivers: from a register or an ADC code to the parts of a [`SensedFrame`](crate::board::SensedFrame).
//! Everything here but the wires: a board hands over an SPI device per accelerometer and a [`TaxelScan`].
//!
//! ```text
//! FIFO ─ adxl38x, icm42688 ─> XlTrack: restarts a dead part, counts samples, decimates ─┐
//!                                                                                      ├─> Sensors: FrameSource
//! ADC ring ─ scan (order) ─> array: de-interleaves, masks, knows a dead array ──────────┘
//! ```
//!
//! Nothing waits for a part that does not answer: each tick gives every sensor a bounded number of transfers.
//!
//! [`TaxelScan`]: crate::board::TaxelScan

pub mod adxl38x;
pub mod array;
pub mod decimate;
mod decimate_table;
pub mod icm42688;
mod registers;
mod sample_count;
pub mod scan;
mod sensors;
mod track;

pub use adxl38x::{Adxl380, Adxl382};
pub use icm42688::Icm42688;
pub use registers::{SPI_BUFFER_BYTES, SpiBuffer};
pub use sample_count::SampleCount;
pub use sensors::{Sensor, SensorReport, Sensors};
pub use track::{RETRY_TICKS, XlBatch, XlCounters, XlTrack};
