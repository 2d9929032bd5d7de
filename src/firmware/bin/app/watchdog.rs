//! The independent watchdog: 100 ms without a decided frame resets the node.
//!
//! [`slipsense::tasks::Supervisor`] feeds it, and only when every task has moved on, so that none can die unnoticed
//! behind the others. It runs from the LSI, whatever the clock tree does.

use embassy_stm32::wdg::IndependentWatchdog;
use embassy_stm32::{Peri, pac, peripherals};

/// 24 frames. The LSI is off by some percent, and defmt may block while the probe drains it.
const TIMEOUT_US: u32 = 100_000;

pub struct Watchdog(IndependentWatchdog<'static, peripherals::IWDG1>);

impl Watchdog {
    /// Start it. From now on it cannot be stopped; it pauses while a debugger halts the core.
    pub fn start(hardware: Peri<'static, peripherals::IWDG1>) -> Self {
        pac::DBGMCU.apb4fzr1().modify(|w| w.set_iwdg1(true));
        let mut hardware = IndependentWatchdog::new(hardware, TIMEOUT_US);
        hardware.unleash();
        Self(hardware)
    }
}

impl slipsense::board::Watchdog for Watchdog {
    fn feed(&mut self) {
        self.0.pet();
    }
}
