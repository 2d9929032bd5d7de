//! What the programs of the NUCLEO-H743ZI2 share (STM32H743ZI, silicon revision V): clocks, memories, flash, model.
//! The programs are in `bin/`, pins in `bin/app/pins.rs`, what is behind them in the book's wiring page.
//!
//! | program | what it does |
//! |---|---|
//! | `bin/app` | the firmware |
//! | `bin/boot` | the bootloader |
//! | `bin/bringup.rs` | for a new board on the desk: what is wrong with it |
//! | `bin/hil.rs` | the firmware's tasks with a debug probe in place of sensors and bus |
//!
//! **None of it has run on hardware.**

pub mod clock_check;
pub mod clocks;
pub mod flash;
pub mod memory;
pub mod model;
pub mod shared;

use cortex_m::Peripherals as Core;
use defmt::unwrap;
use embassy_stm32::Peripherals;

/// Set memories and clocks up. First thing after reset, and once.
pub fn init() -> Peripherals {
    memory::init(&mut unwrap!(Core::take()));
    embassy_stm32::init(clocks::config())
}
