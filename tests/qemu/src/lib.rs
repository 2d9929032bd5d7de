//! What goes into the emulated microcontroller and what comes out, as bytes of two files.
//!
//! Encode and decode stand side by side; the program on the emulated board and `cargo xtask qemu` use
//! the same. All numbers are little-endian.
#![no_std]
#![forbid(unsafe_code)]

mod bytes;
pub mod equal;
pub mod events;
pub mod input;
pub mod link;
pub mod node_loop;
pub mod measured;
pub mod ram_flash;
pub mod record;
#[cfg(feature = "cmsis-dsp")]
pub mod spectra;

/// Name of the file that the emulated board reads, in the emulator's working directory.
pub const INPUT_FILE: &str = "frames.in";
/// Name of the file that it writes.
pub const OUTPUT_FILE: &str = "frames.out";
