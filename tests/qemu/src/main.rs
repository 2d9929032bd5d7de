//! The signal path on an emulated Cortex-M7: acquisition on an interrupt executor, inference in thread mode, as on a
//! board. Reads frames from a file of the host and writes the results to another; `cargo xtask qemu` starts it and
//! compares.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod board;
#[cfg(target_os = "none")]
mod tasks;

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("This program runs on an emulated microcontroller; start it with `cargo xtask qemu`.");
    std::process::exit(2);
}
