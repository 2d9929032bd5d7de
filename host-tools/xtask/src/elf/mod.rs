//! A linked program for the Cortex-M7, looked into: functions, their instructions, their stack frames.

mod code;
mod image;

pub use code::{Code, Instruction, number};
pub use image::{Image, Section};
