//! Evaluation of slip detectors on labelled episodes, in dependency order.
//!
//! A [`detector::Detector`] predicts a class and a score for every frame of one episode after another;
//! the metrics compare them with both truths, and the report has tables, plots and definitions.

pub mod truth;
pub mod source;
pub mod detector;
mod spectrum;
mod gaussian;
pub mod fitted;
pub mod detectors;
pub mod fit;
pub mod run;
pub mod metrics;
mod paper;
mod targets;
mod quantization;
mod directions;
pub mod results;
mod table;
pub mod report;
pub mod families;
pub mod tune;
#[cfg(test)]
mod tests;
