//! What the programs of the NUCLEO-H743ZI2 share (STM32H743ZI, silicon revision V): clocks, memories, flash, model.
//! The programs are in `bin/`, pins in `bin/app/pins.rs`, what is behind them in the book's wiring page.
//!
//! | program | what it does |
//! |---|---|
//! | `bin/app/main.rs` | the firmware |
//! | `bin/boot` | the bootloader |
//! | `bin/app/bringup.rs` | for a new board on the desk: what is wrong with it; same pins, scan, accelerometers and bus |
//! | `bin/hil.rs` | the firmware's tasks with a debug probe in place of sensors and bus |
//!
//! **None of it has run on hardware.**

pub mod clock_check;
pub mod clocks;
pub mod flash;
pub mod memory;
pub mod model;
pub mod ram_errors;
pub mod shared;

use cortex_m::Peripherals as Core;
use defmt::{error, unwrap};
use embassy_stm32::pac::gpio::vals::Moder;
use embassy_stm32::{Peripherals, pac};

/// Red, on PB14.
const FAULT_LED: usize = 14;

/// Set memories and clocks up. First thing after reset, and once. `Err`: there is no external clock, or a wrong one, of
/// this frequency, Hz; the clocks are as after reset.
pub fn try_init() -> Result<Peripherals, u32> {
    let mut core = unwrap!(Core::take());
    memory::init(&mut core);
    ram_errors::forget();
    clock_check::check_hse(&mut core)?;
    Ok(embassy_stm32::init(clocks::config()))
}

/// As [`try_init`]; without the clock it does not return.
pub fn init() -> Peripherals {
    try_init().unwrap_or_else(|found_hz| wait_for_the_clock(found_hz))
}

/// Light the red LED, report in the log, and start anew when there is a clock. The node stays off the bus: the internal
/// oscillator is off by 1 %, more than CAN FD at 8 Mbit/s bears, so that it would disturb the others.
#[inline(never)]
pub fn wait_for_the_clock(found_hz: u32) -> ! {
    // The log asks it for the time; it stands at 0.
    pac::RCC.apb1lenr().modify(|w| w.set_tim2en(true));
    light_red();
    // SAFETY: interrupts are as after reset, and nothing else runs.
    let mut core = unsafe { Core::steal() };
    loop {
        error!("external clock: {=u32} Hz found, {=u32} Hz needed; not on the bus", found_hz, clocks::HSE_HZ);
        // A bootloader may have started it.
        flash::feed_watchdog();
        cortex_m::asm::delay(clocks::HSI_HZ);
        if clock_check::check_hse(&mut core).is_ok() {
            cortex_m::peripheral::SCB::sys_reset()
        }
    }
}

/// Red on, from the first instruction on.
pub fn light_red() {
    pac::RCC.ahb4enr().modify(|w| w.set_gpioben(true));
    cortex_m::asm::dsb();
    pac::GPIOB.bsrr().write(|w| w.set_bs(FAULT_LED, true));
    pac::GPIOB.moder().modify(|w| w.set_moder(FAULT_LED, Moder::OUTPUT));
}
