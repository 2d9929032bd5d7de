//! Tests of the trainer, the quantizer and the float networks, in one program.

mod common;
mod comparison;
mod folder;
mod encoders;
#[cfg(feature = "gpu")]
mod gpu;
mod gradients;
mod leave_out;
mod quantization;
mod streaming;
mod training;
mod variants;
