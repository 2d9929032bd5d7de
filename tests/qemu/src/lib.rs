//! What goes into the emulated microcontroller and what comes out, as files: the programs on the emulated board and
//! `cargo xtask qemu` use the same code. All numbers are little-endian.
#![no_std]
#![deny(unsafe_code)]

mod bytes;
pub mod equality;
#[cfg(target_os = "none")]
#[expect(unsafe_code, reason = "a register and semihosting calls of the emulated board")]
pub mod emulated;
pub mod input;
pub mod measured;
pub mod record;
#[cfg(feature = "cmsis-dsp")]
pub mod spectra;

/// Name of the file that the emulated board reads, in the emulator's working directory.
pub const INPUT_FILE: &str = "frames.in";
pub const OUTPUT_FILE: &str = "frames.out";
