//! Instructions of every kernel and of the whole path on an emulated Cortex-M7; `cargo xtask bench` starts
//! it. No tasks and no interrupts: what is counted is what was called.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod compression;
#[cfg(target_os = "none")]
mod counter;
#[cfg(target_os = "none")]
mod emulated;
#[cfg(target_os = "none")]
mod kernels;
#[cfg(target_os = "none")]
mod path;
#[cfg(target_os = "none")]
#[path = "../semihosting.rs"]
mod semihosting;

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("This program runs on an emulated microcontroller; start it with `cargo xtask bench`.");
    std::process::exit(2);
}
