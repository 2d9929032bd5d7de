//! The `slipsense` command, as a user starts it.

mod busload;
mod calibrate;
mod errors;
mod eval;
mod fake_board;
mod grasp;
mod hil;
mod label;
mod model;
mod outputs;
mod recorder;
mod recordings;
mod sign;
mod support;
mod synth;
mod tune;
