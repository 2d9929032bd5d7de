//! Counting instructions: the emulator is started so that an instruction takes 2^7 ns of its clock, and CMSDK
//! timer 0 counts that clock down at 25 MHz. A tick is then 40/128 of an instruction, and rounding gives the
//! exact number.

use core::hint::black_box;
use core::ptr::{read_volatile, write_volatile};
use core::sync::atomic::{Ordering, compiler_fence};

const CONTROL: *mut u32 = 0x4000_0000 as *mut u32;
const VALUE: *mut u32 = 0x4000_0004 as *mut u32;
const RELOAD: *mut u32 = 0x4000_0008 as *mut u32;
const ENABLE: u32 = 1;
const NS_PER_TICK: u64 = 40;
const NS_PER_INSTRUCTION: u64 = 128;
/// Turns of the loop that the counter is checked with, two instructions each.
const CHECK_TURNS: u32 = 100_000;

/// The started timer and what looking at it costs.
pub struct Counter {
    of_call: u32,
}

impl Counter {
    /// Start the timer. Once, because nothing else may use it.
    pub fn start() -> Self {
        // SAFETY: registers of a timer that the board has at these addresses; nothing else uses it.
        unsafe {
            write_volatile(RELOAD, u32::MAX);
            write_volatile(VALUE, u32::MAX);
            write_volatile(CONTROL, ENABLE);
        }
        let mut counter = Self { of_call: 0 };
        counter.of_call = counter.of(&mut || {});
        counter
    }

    /// Instructions that one call of `work` takes, the call itself left out.
    #[inline(never)]
    pub fn of(&self, work: &mut dyn FnMut()) -> u32 {
        // The compiler must not see what is called, or it could move parts of it out of the measurement.
        let work = black_box(work);
        let before = ticks();
        work();
        let after = ticks();
        instructions(before, after).saturating_sub(self.of_call)
    }

    /// Measure a loop whose length is known: expected and measured instructions.
    pub fn check(&self) -> (u32, u32) {
        let [short, long] = [1, 1 + CHECK_TURNS].map(|turns| self.of(&mut || spin(black_box(turns))));
        (2 * CHECK_TURNS, long - short)
    }
}

/// Ticks left of the timer.
#[inline(always)]
fn ticks() -> u32 {
    compiler_fence(Ordering::SeqCst);
    // SAFETY: as in `Counter::start`; reading has no side effect.
    let ticks = unsafe { read_volatile(VALUE) };
    compiler_fence(Ordering::SeqCst);
    ticks
}

/// Two instructions a turn.
fn spin(turns: u32) {
    // SAFETY: counts a register down.
    unsafe {
        core::arch::asm!("2:", "subs {0}, {0}, #1", "bne 2b", inout(reg) turns => _, options(nomem, nostack))
    }
}

/// The timer counts down, and wraps after 1.3 thousand million instructions.
fn instructions(before: u32, after: u32) -> u32 {
    let ticks = u64::from(before.wrapping_sub(after));
    ((ticks * NS_PER_TICK + NS_PER_INSTRUCTION / 2) / NS_PER_INSTRUCTION) as u32
}
