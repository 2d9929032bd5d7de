//! Sensor drivers: from a register or an ADC code to the parts of a [`SensorFrame`](crate::board::SensorFrame).
//! Everything here but the wires: a board hands over an SPI device per accelerometer and a [`TaxelScan`].
//!
//! ```text
//! FIFO ─ adxl38x, icm42688 ─> XlMonitor: restarts a dead part, counts samples, decimates ─┐
//!                                                                                      ├─> Sensors: FrameSource
//! ADC ring ─ scan (order) ─> array: de-interleaves, trims, finds dead and stuck ───┘
//! ```
//!
//! Nothing waits for a part that does not answer: each tick gives every sensor a bounded number of transfers.
//!
//! [`TaxelScan`]: crate::board::TaxelScan

pub mod adxl38x;
pub mod array;
mod commissioning;
pub mod decimate;
mod decimate_table;
pub mod icm42688;
mod registers;
mod sample_count;
pub mod scan;
mod sensor_link;
mod sensors;
mod xl_monitor;

pub use adxl38x::{Adxl380, Adxl382};
pub use commissioning::{Commissioning, Failure};
pub use icm42688::Icm42688;
pub use registers::{SPI_BUFFER_BYTES, SpiBuffer};
pub use sample_count::SampleCount;
pub use sensor_link::{Bench, SensorLink, SensorReport};
pub use sensors::{Sensor, Sensors};
pub use xl_monitor::{RETRY_TICKS, XlBatch, XlCounters, XlMonitor};
