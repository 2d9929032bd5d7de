//! The tasks in real time on an emulated Cortex-M7: frames at 240 Hz that nobody waits for, a CAN bus in virtual time.
//! `cargo xtask qemu --real-time` starts it and judges what it reports.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod board;
#[cfg(target_os = "none")]
mod tasks;

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("This program runs on an emulated microcontroller; `cargo xtask qemu --real-time` starts it.");
    std::process::exit(2);
}
