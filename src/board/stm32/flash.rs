//! The flash that holds the settings: two sectors, `SETTINGS` of `board.x`, through embassy's driver.
//!
//! | | NUCLEO-H743ZI2 | NUCLEO-H723ZG |
//! |---|---|---|
//! | the sectors | in bank 2 | in the only bank |
//! | an erase, up to 4 s, when a sector is full: every 200th store or so | the rest goes on | everything waits: frames are missed, the watchdog is given [`ERASE_PATIENCE_US`] |
//! | a store, 17 words of 32 bytes | as above | the core waits up to 0.3 ms for each word |
//!
//! A word whose programming was cut off by a reset may have two wrong bits, which error correction finds and tells by
//! a bus fault (RM0433, embedded flash memory, error code correction). Such a word reads as zeros here, which the
//! checksums of the settings refuse. **That path has not run anywhere**: no hardware, and the emulator has no error
//! correction.
//!
//! The MPU takes the cache from these sectors (`memory.rs`), so that what was written is what is read.

use core::arch::asm;
use core::ops::Range;
use core::ptr::read_volatile;

use cortex_m::peripheral::SCB;
use embassy_stm32::flash::{self, Async, FLASH_BASE, Flash, WRITE_SIZE};
use embassy_stm32::{Peri, bind_interrupts, pac, peripherals};
use embedded_storage_async::nor_flash::{ErrorType, NorFlash, ReadNorFlash};

use super::watchdog;
use crate::board::FLASH_BANKS;

bind_interrupts!(struct Irqs {
    FLASH => flash::InterruptHandler;
});

/// Sectors of both parts.
const SECTOR_BYTES: usize = 128 * 1024;
/// The longest erase of a sector takes half of it (STM32H743 data sheet, flash memory programming).
const ERASE_PATIENCE_US: u32 = 8_000_000;
/// CCR.BFHFNMIGN: bus faults of data accesses are ignored at priority -1 and above.
const IGNORE_BUS_FAULTS: u32 = 1 << 8;

unsafe extern "C" {
    // Of `board.x`.
    static __settings_start: u8;
    static __settings_end: u8;
}

/// Where settings live, as offsets into the flash.
pub fn settings_range() -> Range<u32> {
    let offset = |address: *const u8| address as u32 - FLASH_BASE as u32;
    offset(&raw const __settings_start)..offset(&raw const __settings_end)
}

/// The flash, of which settings are read, written and erased.
pub struct BoardFlash(Flash<'static, Async>);

impl BoardFlash {
    /// Take it.
    pub fn new(hardware: Peri<'static, peripherals::FLASH>) -> Self {
        Self(Flash::new(hardware, Irqs))
    }
}

impl ErrorType for BoardFlash {
    type Error = flash::Error;
}

impl ReadNorFlash for BoardFlash {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, out: &mut [u8]) -> Result<(), flash::Error> {
        let range = settings_range();
        let end = offset.checked_add(out.len() as u32);
        if offset < range.start || end.is_none_or(|end| end > range.end) {
            return Err(flash::Error::Size);
        }
        let mut address = FLASH_BASE as u32 + offset;
        let mut out = out.iter_mut();
        while out.len() > 0 {
            let word = address / WRITE_SIZE as u32 * WRITE_SIZE as u32;
            // SAFETY: the word holds bytes of the range checked above.
            let bytes = unsafe { read_word(word) };
            // The bytes first: the one that finds the other's end is lost.
            for (&from, to) in bytes.iter().skip((address - word) as usize).zip(out.by_ref()) {
                *to = from;
                address += 1;
            }
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        settings_range().end as usize
    }
}

impl NorFlash for BoardFlash {
    const WRITE_SIZE: usize = WRITE_SIZE;
    const ERASE_SIZE: usize = SECTOR_BYTES;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), flash::Error> {
        clear_errors();
        if FLASH_BANKS > 1 {
            return self.0.erase(from, to).await;
        }
        watchdog::with_patience_us(ERASE_PATIENCE_US, || self.0.blocking_erase(from, to))
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), flash::Error> {
        clear_errors();
        self.0.write(offset, bytes).await
    }
}

/// Flags of an error that stand would refuse every later write; embassy-stm32 0.6 means to clear them and writes the
/// register that only shows them.
fn clear_errors() {
    for bank in 0..FLASH_BANKS {
        pac::FLASH.bank(bank).ccr().write(|w| {
            w.set_clr_wrperr(true);
            w.set_clr_pgserr(true);
            w.set_clr_strberr(true);
            w.set_clr_incerr(true);
            w.set_clr_operr(true);
        });
    }
}

/// One flash word; zeros where error correction gave up.
///
/// # Safety
/// `address` is that of a word in flash.
unsafe fn read_word(address: u32) -> [u8; WRITE_SIZE] {
    let mut words = [0u32; WRITE_SIZE / 4];
    let failed = || (0..FLASH_BANKS).any(|bank| pac::FLASH.bank(bank).sr().read().dbeccerr());
    let clear = || {
        for bank in 0..FLASH_BANKS {
            pac::FLASH.bank(bank).ccr().write(|w| w.set_clr_dbeccerr(true));
        }
    };
    clear();
    cortex_m::interrupt::free(|_| {
        // SAFETY: nothing else runs until FAULTMASK is clear again: it raises the priority to -1, at which the bus
        // fault of the read is ignored. Whoever sets CCR meanwhile is us.
        unsafe {
            let control = (*SCB::PTR).ccr.read();
            (*SCB::PTR).ccr.write(control | IGNORE_BUS_FAULTS);
            asm!("cpsid f", "dsb", "isb");
            for (index, word) in words.iter_mut().enumerate() {
                *word = read_volatile((address as *const u32).add(index));
            }
            asm!("dsb", "cpsie f", "isb");
            (*SCB::PTR).ccr.write(control);
        }
    });
    if failed() {
        clear();
        words = [0; WRITE_SIZE / 4];
    }
    let mut bytes = [0; WRITE_SIZE];
    for (to, word) in bytes.as_chunks_mut::<4>().0.iter_mut().zip(words) {
        *to = word.to_le_bytes();
    }
    bytes
}
