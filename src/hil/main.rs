//! The firmware's tasks with a debug probe in place of sensors and bus: the board's side of `slipsense hil`.
//!
//! Clocks, memories, model, pipeline, tasks, executors and their priorities are the firmware's. There is no scan, no
//! accelerometer, no CAN, no setting and no watchdog: frames come through [`slipsense::board::mailbox`], and the CAN
//! frames that they lead to go back the same way. So a bare NUCLEO on its USB cable is all that the test needs.
//! **It has not run on hardware**; it runs on the emulated STM32H743.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
#[path = "../board/h743/mod.rs"]
#[allow(dead_code, reason = "the firmware uses the rest")]
mod board;
// What a board's folder calls by this name.
#[cfg(target_os = "none")]
#[path = "node.rs"]
mod stm32;

#[cfg(not(target_os = "none"))]
fn main() -> std::process::ExitCode {
    eprintln!("slipsense-hil runs on a NUCLEO-H743ZI2: cargo build-hil-h743; slipsense hil --help");
    std::process::ExitCode::from(2)
}
