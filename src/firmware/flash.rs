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
use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::peripheral::SCB;
use embassy_embedded_hal::flash::partition::Partition;
use embassy_futures::{block_on, yield_now};
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
/// Tries of a word. Only a flag of a read that comes while it is handed over costs one.
const TRIES: u32 = 8;

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

/// What the option bytes say of supply and bootloader, as the book's page on updates demands it. No program here ever
/// writes them.
#[derive(Clone, Copy, Debug)]
pub struct OptionBytes {
    /// BOR_LEV: 0, no brown-out reset, to 3, 2.7 V.
    pub brown_out_level: u8,
    /// Is the sector of the bootloader protected from writes?
    pub boot_is_protected: bool,
}

impl OptionBytes {
    /// 2.7 V: below, core and flash are near the end of their specification, and the ADC's reference is gone.
    pub const BROWN_OUT_LEVEL: u8 = 3;
    /// As the last reset loaded them. A bit of WRPSN that is 0 protects its sector (RM0433, FLASH_WPSN_CUR1R).
    pub fn read() -> Self {
        let first = BOARD.boot.start / SECTOR_BYTES;
        Self {
            brown_out_level: pac::FLASH.optsr_cur().read().bor_lev(),
            boot_is_protected: pac::FLASH.bank(0).wpsn_curr().read().wrpsn() >> (first % 8) & 1 == 0,
        }
    }

    /// Are they as demanded?
    pub fn are_set(self) -> bool {
        self.brown_out_level == Self::BROWN_OUT_LEVEL && self.boot_is_protected
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

/// What error correction has found since start: errors of one bit, of two.
static ECC_ERRORS: [AtomicU32; 2] = [const { AtomicU32::new(0) }; 2];

/// Count what error correction has found since the last call, once in each bank, and clear its flags: SNECCERR for an
/// error of one bit, which it mended, DBECCERR for one of two. Counts since start.
pub fn count_ecc_errors() -> [u32; 2] {
    for bank in 0..BANKS {
        let flags = pac::FLASH.bank(bank).sr().read();
        let found = [flags.sneccerr1(), flags.dbeccerr()];
        if found != [false; 2] {
            pac::FLASH.bank(bank).ccr().write(|w| {
                w.set_clr_sneccerr(true);
                w.set_clr_dbeccerr(true);
            });
        }
        for (count, found) in ECC_ERRORS.iter().zip(found) {
            count.fetch_add(found.into(), Ordering::Relaxed);
        }
    }
    ECC_ERRORS.each_ref().map(|count| count.load(Ordering::Relaxed))
}

/// Flags of an error that stand fail every later operation; embassy-stm32 0.6 means to clear them and writes the
/// register that only shows them. RDPERR and RDSERR can be raised by the core's speculation, SNECCERR and DBECCERR by
/// reading a word that a power failure left (RM0433, FLASH_SR).
fn clear_errors() {
    count_ecc_errors();
    for bank in 0..BANKS {
        pac::FLASH.bank(bank).ccr().write(|w| {
            w.set_clr_wrperr(true);
            w.set_clr_pgserr(true);
            w.set_clr_strberr(true);
            w.set_clr_incerr(true);
            w.set_clr_operr(true);
            w.set_clr_rdperr(true);
            w.set_clr_rdserr(true);
            w.set_clr_crcrderr(true);
        });
    }
}

/// Has an operation failed? Else an error is of a read, whoever made it: RDPERR, RDSERR, SNECCERR and DBECCERR stop no
/// operation (RM0433, embedded flash memory, error management), and embassy-stm32 0.6 takes them for its own.
fn operation_failed() -> bool {
    (0..BANKS).any(|bank| {
        let flags = pac::FLASH.bank(bank).sr().read();
        flags.wrperr() || flags.pgserr() || flags.strberr() || flags.incerr() || flags.operr()
    })
}

/// What an erase has come to: the driver looks at the flags when it is over.
fn erased(result: Result<(), Error>) -> Result<(), Error> {
    let result = if operation_failed() { result } else { Ok(()) };
    clear_errors();
    result
}

/// What a word at `offset` has come to: is it there? `Ok(false)`: a flag of a read made the driver stop before the word
/// was whole. It has cleared PG, which drops what was handed over (RM0433, FLASH_SRx.WBNE), so another try may follow.
fn written(result: Result<(), Error>, offset: u32, word: &[u8]) -> Result<bool, Error> {
    let failed = operation_failed();
    clear_errors();
    let mut held = [0; WRITE_SIZE];
    read(offset, &mut held)?;
    match result {
        _ if held == word => Ok(true),
        Err(error) if failed => Err(error),
        Err(_) => Ok(false),
        // The driver's interrupt handler clears OPERR before anybody has seen it.
        Ok(()) => Err(Error::Prog),
    }
}

/// Write whole words by `write`, a word at a time.
async fn write_words(
    offset: u32,
    bytes: &[u8],
    mut write: impl AsyncFnMut(u32, &[u8]) -> Result<(), Error>,
) -> Result<(), Error> {
    check(BOARD.flash, offset, bytes.len())?;
    if !bytes.len().is_multiple_of(WRITE_SIZE) || !(offset as usize).is_multiple_of(WRITE_SIZE) {
        return Err(Error::Unaligned);
    }
    for (offset, word) in (offset..).step_by(WRITE_SIZE).zip(bytes.chunks_exact(WRITE_SIZE)) {
        let mut tries = 0..TRIES;
        loop {
            tries.next().ok_or(Error::Prog)?;
            clear_errors();
            if written(write(offset, word).await, offset, word)? {
                break;
            }
        }
    }
    Ok(())
}

/// From `offset` of the flash on; zeros where error correction gave up.
pub fn read(offset: u32, out: &mut [u8]) -> Result<(), Error> {
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
    let [_, lost_before] = count_ecc_errors();
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
    let [_, lost] = count_ecc_errors();
    if lost != lost_before {
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
        for sector in (from..to).step_by(SECTOR_BYTES as usize) {
            clear_errors();
            erased(self.0.erase(sector, sector + SECTOR_BYTES).await)?;
        }
        Ok(())
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Error> {
        check(BOARD.written(), offset, bytes.len())?;
        write_words(offset, bytes, async |offset, word| self.0.write(offset, word).await).await
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
            feed_watchdog();
            clear_errors();
            erased(self.0.blocking_erase(sector, sector + SECTOR_BYTES))?;
        }
        feed_watchdog();
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Error> {
        feed_watchdog();
        block_on(write_words(offset, bytes, async |offset, word| self.0.blocking_write(offset, word)))
    }
}
