//! The independent watchdog: 100 ms without a decided frame resets the node.
//!
//! [`slipsense::tasks::Supervisor`] feeds it, and only when every task has moved on, so that none can die unnoticed
//! behind the others. It runs from the LSI, whatever the clock tree does.

use embassy_stm32::pac::iwdg::vals::{Key, Pr};
use embassy_stm32::wdg::IndependentWatchdog;
use embassy_stm32::{Peri, pac, peripherals};

/// 24 frames. The LSI is off by some percent, and defmt may block while the probe drains it.
const TIMEOUT_US: u32 = 100_000;
/// Largest prescaler: 256 cycles of the LSI, 8 ms.
const SLOWEST: Pr = Pr::DIVIDE_BY256;
const SLOW_TICK_US: u32 = 8_000;
/// A write to a register reaches the LSI's side within five of its cycles, 160 us (RM0433, IWDG): some
/// thousand reads at most.
const SPINS: u32 = 100_000;

/// The hardware.
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

/// Do something that lets nobody run for up to `us` with the watchdog's patience stretched to that.
pub fn with_patience_us<T>(us: u32, work: impl FnOnce() -> T) -> T {
    let registers = pac::IWDG1;
    let usual = (registers.pr().read().pr(), registers.rlr().read().rl());
    set(SLOWEST, us.div_ceil(SLOW_TICK_US) as u16);
    let done = work();
    set(usual.0, usual.1);
    done
}

fn set(prescaler: Pr, reload: u16) {
    let registers = pac::IWDG1;
    let settled = || (0..SPINS).any(|_| registers.sr().read().0 == 0);
    registers.kr().write(|w| w.set_key(Key::ENABLE));
    if settled() {
        registers.pr().write(|w| w.set_pr(prescaler));
        registers.rlr().write(|w| w.set_rl(reload));
    }
    let _ = settled();
    registers.kr().write(|w| w.set_key(Key::RESET));
}
