//! The quantized network, integers only.
//!
//! Kernels first ([requantization](crate::fixed::scale_q32), [`dense`], the convolution in [`crate::simd`], [`softmax`], [`layer_norm`],
//! [`attention`]), then the file that holds a trained network ([`format`], [`packing`], [`model`]), then the graph that
//! runs it frame by frame ([`encoder`], [`network`]). Activations are `i16` with one real scale per tensor, weights
//! are `i16` with one scale per output channel, accumulators `i32` that provably never overflow: [`model`] refuses a file for which the proof fails, so the kernels add without checks.

pub mod dense;
pub mod observer;
mod tables;
pub mod softmax;
pub mod layer_norm;
pub mod attention;
pub mod packing;
pub mod activations;
pub mod format;
mod model_error;
pub mod model;
pub mod encoder;
pub mod network;

pub use model::{Aligned, Model};
pub use model_error::ModelError;
pub use network::{Network, NetworkState, SensorFeatures};
pub use observer::Observer;
