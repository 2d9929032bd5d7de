//! Benchmark of slip detectors on labelled episodes.
//!
//! A [`detectors::Detector`] turns one episode after another into a class, a score and a flag per frame;
//! the metrics compare them with both truths, and the report shows what a reviewer would ask for.

pub mod detectors;
pub mod fit;
pub mod source;
pub mod truth;
pub mod disturbance;
pub mod run;
pub mod metrics;
pub mod paper;
pub mod results;
pub mod grid;
pub mod targets;
pub mod integer_float;
pub mod directions;
pub mod rotation;
pub mod report;
mod table;
pub mod tune;
