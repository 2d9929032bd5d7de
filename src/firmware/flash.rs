//! The flash, through embassy's driver: the firmware's way waits by interrupt, the bootloader's in a loop that feeds
//! the watchdog. What lies where, [`partitions`](crate::update::partitions) says.
//!
//! All that the firmware writes lies in bank 2 and its code in bank 1, so that sensing goes on during an erase, which
//! takes up to 4 s: for an update, and every 200th store or so. The MPU takes the cache from bank 2
//! ([`memory`](super::memory)), so that what is written is what is read.
//!
//! A word whose programming was cut off by a reset may have two wrong bits, which error correction finds and reports
//! by a bus fault (RM0433, embedded flash memory, error code correction). Such a word reads as zeros here. **That path
//! has not run anywhere**: no hardware, and the emulator has no error correction.

use core::arch::asm;
use core::ptr::read_volatile;

use cortex_m::peripheral::SCB;
use embassy_embedded_hal::flash::partition::Partition;
use embassy_futures::yield_now;
use embassy_stm32::flash::{Async, Blocking, Error, FLASH_BASE, Flash, WRITE_SIZE};
use embassy_stm32::pac;
use embassy_stm32::pac::iwdg::vals::Key;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::mutex::Mutex;
use embedded_storage::nor_flash::{
    ErrorType, NorFlash as BlockingNorFlash, ReadNorFlash as BlockingReadNorFlash,
};
use embedded_storage_async::nor_flash::{NorFlash, ReadNorFlash};
use static_cell::StaticCell;

use crate::update::partitions::{NUCLEO_H743ZI2 as BOARD, SECTOR_BYTES, Span};

/// CCR.BFHFNMIGN: bus faults of data accesses are ignored at priority -1 and above.
const IGNORE_BUS_FAULTS: u32 = 1 << 8;
const BANKS: usize = 2;
/// How often a sector is erased before an error that stands is believed.
const TRIES: u8 = 3;

/// The flash of the one task that uses it.
type SharedFlash = Mutex<CriticalSectionRawMutex, BoardFlash<Async>>;
static FLASH: StaticCell<SharedFlash> = StaticCell::new();

/// A partition of the firmware, from its address 0 on.
pub type FlashPartition = Partition<'static, CriticalSectionRawMutex, BoardFlash<Async>>;

/// Gives out the firmware's partitions.
#[derive(Clone, Copy)]
pub struct FlashPartitions(&'static SharedFlash);

impl FlashPartitions {
    /// Of this flash, the only one.
    pub fn new(flash: Flash<'static, Async>) -> Self {
        Self(FLASH.init(Mutex::new(BoardFlash(flash))))
    }

    /// This one.
    pub fn get(self, span: Span) -> FlashPartition {
        Partition::new(self.0, span.start, span.bytes())
    }
}

/// The whole flash. Of the firmware only [`Partitions::written`](crate::update::partitions::Partitions::written) can
/// be written.
pub struct BoardFlash<M>(Flash<'static, M>);

impl BoardFlash<Blocking> {
    /// The bootloader's.
    pub const fn new(flash: Flash<'static, Blocking>) -> Self {
        Self(flash)
    }
}

/// Start the period of a watchdog that runs anew.
pub fn feed_watchdog() {
    pac::IWDG1.kr().write(|w| w.set_key(Key::RESET));
}

/// Do `length` bytes from `offset` on lie in `span`?
fn check(span: Span, offset: u32, length: usize) -> Result<(), Error> {
    let end = offset.checked_add(length as u32);
    if offset < span.start || end.is_none_or(|end| end > span.end) { Err(Error::Size) } else { Ok(()) }
}

/// Flags of an error that stand fail every later operation; embassy-stm32 0.6 means to clear them and writes the
/// register that only shows them. RDPERR and RDSERR can be raised by the core's speculation, SNECCERR and DBECCERR by
/// reading a word that a power failure left (RM0433, FLASH_SR).
fn clear_errors() {
    for bank in 0..BANKS {
        pac::FLASH.bank(bank).ccr().write(|w| {
            w.set_clr_wrperr(true);
            w.set_clr_pgserr(true);
            w.set_clr_strberr(true);
            w.set_clr_incerr(true);
            w.set_clr_operr(true);
            w.set_clr_rdperr(true);
            w.set_clr_rdserr(true);
            w.set_clr_sneccerr(true);
            w.set_clr_dbeccerr(true);
        });
    }
}

/// After a write that ended with `error`: must this word be written again? An error flag may be another's than the
/// write's, so the flash itself is asked. A word that holds something else cannot be mended: `error`.
fn is_missing(offset: u32, word: &[u8; WRITE_SIZE], error: Error) -> Result<bool, Error> {
    let mut held = [0; WRITE_SIZE];
    read(offset, &mut held)?;
    if held == *word {
        Ok(false)
    } else if held == [0xFF; WRITE_SIZE] {
        Ok(true)
    } else {
        Err(error)
    }
}

/// From `offset` of the flash on.
fn read(offset: u32, out: &mut [u8]) -> Result<(), Error> {
    check(BOARD.flash, offset, out.len())?;
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

/// One flash word; zeros where error correction gave up.
///
/// # Safety
/// `address` is that of a word in flash.
unsafe fn read_word(address: u32) -> [u8; WRITE_SIZE] {
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

impl<M> ErrorType for BoardFlash<M> {
    type Error = Error;
}

impl ReadNorFlash for BoardFlash<Async> {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, out: &mut [u8]) -> Result<(), Error> {
        read(offset, out)?;
        // Whoever reads a whole firmware lets frames be decided meanwhile.
        yield_now().await;
        Ok(())
    }

    fn capacity(&self) -> usize {
        BOARD.flash.bytes() as usize
    }
}

impl NorFlash for BoardFlash<Async> {
    const WRITE_SIZE: usize = WRITE_SIZE;
    const ERASE_SIZE: usize = SECTOR_BYTES as usize;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), Error> {
        check(BOARD.written(), from, to.saturating_sub(from) as usize)?;
        let mut erased = Ok(());
        for _ in 0..TRIES {
            clear_errors();
            erased = self.0.erase(from, to).await;
            if erased.is_ok() {
                break;
            }
        }
        erased
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Error> {
        check(BOARD.written(), offset, bytes.len())?;
        clear_errors();
        let Err(error) = self.0.write(offset, bytes).await else { return Ok(()) };
        for (at, word) in (offset..).step_by(WRITE_SIZE).zip(bytes.as_chunks::<WRITE_SIZE>().0) {
            if is_missing(at, word, error)? {
                clear_errors();
                self.0.write(at, word).await?;
            }
        }
        Ok(())
    }
}

impl BlockingReadNorFlash for BoardFlash<Blocking> {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, out: &mut [u8]) -> Result<(), Error> {
        feed_watchdog();
        read(offset, out)
    }

    fn capacity(&self) -> usize {
        BOARD.flash.bytes() as usize
    }
}

impl BlockingNorFlash for BoardFlash<Blocking> {
    const WRITE_SIZE: usize = WRITE_SIZE;
    const ERASE_SIZE: usize = SECTOR_BYTES as usize;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Error> {
        // One by one: the watchdog waits for one.
        for sector in (from..to).step_by(SECTOR_BYTES as usize) {
            let mut erased = Ok(());
            for _ in 0..TRIES {
                feed_watchdog();
                clear_errors();
                erased = self.0.blocking_erase(sector, sector + SECTOR_BYTES);
                if erased.is_ok() {
                    break;
                }
            }
            erased?;
        }
        feed_watchdog();
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Error> {
        feed_watchdog();
        clear_errors();
        let Err(error) = self.0.blocking_write(offset, bytes) else { return Ok(()) };
        for (at, word) in (offset..).step_by(WRITE_SIZE).zip(bytes.as_chunks::<WRITE_SIZE>().0) {
            if is_missing(at, word, error)? {
                clear_errors();
                self.0.blocking_write(at, word)?;
            }
        }
        Ok(())
    }
}
