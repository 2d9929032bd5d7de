//! A word of flash, as the microcontroller can read it, and its errors cleared: for firmware and bootloader.
//!
//! A word whose programming was cut off by a reset may have two wrong bits, which error correction finds and tells by
//! a bus fault (RM0433, embedded flash memory, error code correction). Such a word reads as zeros here. **That path
//! has not run anywhere**: no hardware, and the emulator has no error correction.

use core::arch::asm;
use core::ptr::read_volatile;

use cortex_m::peripheral::SCB;
use embassy_stm32::flash::WRITE_SIZE;
use embassy_stm32::pac;

/// CCR.BFHFNMIGN: bus faults of data accesses are ignored at priority -1 and above.
const IGNORE_BUS_FAULTS: u32 = 1 << 8;

const BANKS: usize = 2;

/// Flags of an error that stand would refuse every later write; embassy-stm32 0.6 means to clear them and writes the
/// register that only shows them.
pub fn clear_errors() {
    for bank in 0..BANKS {
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
pub unsafe fn read_word(address: u32) -> [u8; WRITE_SIZE] {
    let mut words = [0u32; WRITE_SIZE / 4];
    let failed = || (0..BANKS).any(|bank| pac::FLASH.bank(bank).sr().read().dbeccerr());
    let clear = || {
        for bank in 0..BANKS {
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
