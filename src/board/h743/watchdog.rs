//! The independent watchdog: 100 ms without a decided frame resets the node.
//!
//! It is fed by the inference loop, and only when acquisition has closed another frame since, so that
//! neither task can die unnoticed behind the other. It runs from the LSI, whatever the clock tree does.

use embassy_stm32::wdg::IndependentWatchdog;
use embassy_stm32::{Peri, pac, peripherals};

/// 24 frames. The LSI is off by some percent, and defmt may block while the probe drains it.
const TIMEOUT_US: u32 = 100_000;

/// A watchdog that wants to see progress.
pub struct Watchdog {
    hardware: IndependentWatchdog<'static, peripherals::IWDG1>,
    frames_acquired: u32,
}

impl Watchdog {
    /// Start it. From now on it cannot be stopped; it pauses while a debugger halts the core.
    pub fn start(hardware: Peri<'static, peripherals::IWDG1>) -> Self {
        pac::DBGMCU.apb4fzr1().modify(|w| w.set_iwdg1(true));
        let mut hardware = IndependentWatchdog::new(hardware, TIMEOUT_US);
        hardware.unleash();
        Self { hardware, frames_acquired: 0 }
    }

    /// After each decided frame, with the number of frames that acquisition has closed so far.
    pub fn feed(&mut self, frames_acquired: u32) {
        if frames_acquired != self.frames_acquired {
            self.frames_acquired = frames_acquired;
            self.hardware.pet();
        }
    }
}
