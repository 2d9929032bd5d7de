//! The bootloader: swaps in a firmware that came by an update, swaps out one that did not confirm, and jumps. What it
//! decides is [`slipsense::update::boot`], which the host's tests run; here are only registers. The emulated board
//! runs it. **It has not run on hardware.**
//!
//! The watchdog is on from the first microsecond: a bootloader that hangs starts anew, and a firmware that hangs comes
//! back here without having confirmed. Without a firmware that is whole the red LED is lit, and a debug probe is needed.
//!
//! It runs on the 64 MHz oscillator that the chip starts with: no clock is set up, so that the firmware finds the chip
//! as after a reset, but for the watchdog.
#![no_std]
#![no_main]

use core::cell::RefCell;
use core::hint::black_box;
use core::panic::PanicInfo;

use cortex_m::peripheral::SCB;
use cortex_m_rt::entry;
use defmt::{Display2Format, error, info};
use defmt_rtt as _;
use embassy_embedded_hal::flash::partition::BlockingPartition;
use embassy_stm32::flash::Flash;
use embassy_stm32::pac;
use embassy_stm32::wdg::IndependentWatchdog;
use embassy_sync::blocking_mutex::NoopMutex;
use slipsense::firmware::flash::{BoardFlash, feed_watchdog};
use slipsense::firmware::{self, memory};
use slipsense::update::boot::{BootFailure, Firmware, Slots};
use slipsense::update::partitions::{FLASH_BASE, NUCLEO_H743ZI2 as BOARD, Span};
use slipsense::update::{KEY_NOTICE, PUBLIC_KEYS};

/// Twice the longest erase of a sector (STM32H743 data sheet, flash memory programming). The firmware sets its own.
const WATCHDOG_US: u32 = 8_000_000;
/// What is copied at once.
const BUFFER_BYTES: usize = 1024;

#[repr(align(32))]
struct Buffer([u8; BUFFER_BYTES]);

#[entry]
fn main() -> ! {
    // SAFETY: nothing has run before, and nothing else runs here.
    let (chip, mut core) = unsafe { (embassy_stm32::Peripherals::steal(), cortex_m::Peripherals::steal()) };
    pac::DBGMCU.apb4fzr1().modify(|w| w.set_iwdg1(true));
    IndependentWatchdog::new(chip.IWDG1, WATCHDOG_US).unleash();
    memory::protect(&mut core.MPU);
    core.SCB.enable_icache();
    info!("slipsense bootloader {=str}", env!("CARGO_PKG_VERSION"));
    if let Some(notice) = KEY_NOTICE {
        info!("{=str}", notice);
    }

    let flash = NoopMutex::new(RefCell::new(BoardFlash::new(Flash::new_blocking(chip.FLASH))));
    let partition = |span: Span| BlockingPartition::new(&flash, span.start, span.bytes());
    let [active, dfu, state] = [BOARD.active, BOARD.dfu, BOARD.state].map(partition);
    let mut buffer = Buffer([0; BUFFER_BYTES]);
    let mut slots = Slots { active, dfu, state };
    let firmware = match slots.prepare(&BOARD, PUBLIC_KEYS, &mut buffer.0) {
        Ok(firmware) => firmware,
        Err(failure) => show_and_restart(&failure),
    };
    // Against a skipped instruction. Without `black_box` the compiler could leave it out as a repetition.
    if let Err(failure) = slots.check_again(black_box(&firmware), black_box(&BOARD), black_box(PUBLIC_KEYS)) {
        show_and_restart(&failure)
    }
    match firmware {
        Firmware::Signed { version, .. } => info!("firmware {}", Display2Format(&version)),
        Firmware::Flashed => info!("a firmware that a probe wrote"),
    }
    feed_watchdog();
    core.SCB.disable_icache();
    let firmware = FLASH_BASE + BOARD.active.start;
    // SAFETY: the active slot holds a firmware, whose first words are its stack and where it begins; no interrupt is
    // enabled and no DMA runs.
    unsafe {
        core.SCB.vtor.write(firmware);
        cortex_m::asm::bootload(firmware as *const u32)
    }
}

/// Nothing to run: the red LED until the watchdog starts the bootloader anew, which finds what a transient error has
/// hidden. A probe can attach meanwhile.
fn show_and_restart(failure: &BootFailure) -> ! {
    error!("{}", Display2Format(failure));
    firmware::light_red();
    loop {
        cortex_m::asm::nop();
    }
}

/// Nothing is lost by starting anew: every step of a swap may be the last.
#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    cortex_m::interrupt::disable();
    error!("{}", Display2Format(info));
    SCB::sys_reset()
}
