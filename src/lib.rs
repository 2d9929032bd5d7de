//! Slip sensing for robot fingertips.
//!
//! One library for both worlds: the microcontroller and the host run this code and get the same bits.
//! The modules below stand in dependency order: each uses only those above it (a test holds this).
#![no_std]
// The exceptions are assembly and vector instructions, in `simd`, and registers, in `firmware`.
#![deny(unsafe_code)]
#![warn(missing_docs)]
#![allow(clippy::new_without_default, clippy::len_without_is_empty, reason = "nobody asks for them")]
#![deny(clippy::float_arithmetic)]

pub mod params;
pub mod fixed;
pub mod sensor;
pub mod transfer;
pub mod calibration;
pub mod health;
pub mod features;
pub mod simd;
pub mod net;
#[expect(clippy::float_arithmetic, reason = "see the module: single precision, the same bits everywhere")]
pub mod contact;
pub mod decision;
pub mod wire;
pub mod pipeline;
pub mod settings;
pub mod node;
pub mod update;
pub mod board;
pub mod drivers;
pub mod bringup;
pub mod tasks;
/// What the programs of the board share; the programs are in `src/firmware/bin`.
#[cfg(all(target_os = "none", feature = "h743"))]
#[expect(unsafe_code, reason = "registers, attributes of memories")]
pub mod firmware;

#[cfg(all(feature = "h743", not(target_os = "none")))]
compile_error!("the feature h743 is for the microcontroller: cargo build-h743");
