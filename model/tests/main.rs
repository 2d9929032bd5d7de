//! Tests of the trainer, the quantizer and the float networks, in one program.

mod common;
mod comparison;
mod folder;
mod encoders;
mod gradients;
mod quantization;
mod streaming;
mod training;
mod variants;
