//! The bootloader: swaps in a firmware that came by an update, swaps out one that did not confirm, and jumps. What it
//! decides is `slipsense::update::boot`, which the host's tests run; here are only registers. The board twin runs it.
//! **It has not run on hardware.**
//!
//! The watchdog is on from the first microsecond: a bootloader that hangs starts anew, and a firmware that hangs comes
//! back here without having confirmed. Without a firmware that is whole the red LED is lit, and a debug probe is needed.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
#[path = "../board/stm32/flash_word.rs"]
mod flash_word;
#[cfg(target_os = "none")]
mod partition;
#[cfg(target_os = "none")]
mod start;

#[cfg(not(target_os = "none"))]
fn main() -> std::process::ExitCode {
    eprintln!("slipsense-boot runs on a NUCLEO-H743ZI2: cargo build-boot-h743; cargo flash-boot-h743");
    std::process::ExitCode::from(2)
}
