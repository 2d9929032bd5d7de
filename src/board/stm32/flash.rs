//! The flash, through embassy's driver: settings and updates are written, the firmware's own header and what stands
//! where reset looks first are read. What lies where, `slipsense::update::partitions` says.
//!
//! All that is written lies in bank 2 and the code in bank 1, so that sensing goes on during an erase, which takes up to
//! 4 s: for an update, and every 200th store or so.
//!
//! The MPU takes the cache from what is written (`memory.rs`), so that it is what is read.

use embassy_embedded_hal::flash::partition::Partition;
use embassy_futures::yield_now;
use embassy_stm32::flash::{self, Async, FLASH_BASE, Flash, WRITE_SIZE};
use embassy_stm32::{Peri, bind_interrupts, peripherals};
use embassy_sync::mutex::Mutex;
use embedded_storage_async::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use slipsense::update::partitions::{SECTOR_BYTES, Span};
use static_cell::StaticCell;

use super::flash_word;
use crate::board::PARTITIONS;

bind_interrupts!(struct Irqs {
    FLASH => flash::InterruptHandler;
});

/// The flash of the one task that uses it.
type Whole = Mutex<super::Mutex, BoardFlash>;
static WHOLE: StaticCell<Whole> = StaticCell::new();

/// A partition, from its address 0 on.
pub type Part = Partition<'static, super::Mutex, BoardFlash>;

/// Gives out partitions.
#[derive(Clone, Copy)]
pub struct Parts(&'static Whole);

impl Parts {
    /// Of this flash, the only one.
    pub fn of(hardware: Peri<'static, peripherals::FLASH>) -> Self {
        Self(WHOLE.init(Mutex::new(BoardFlash(Flash::new(hardware, Irqs)))))
    }

    /// This one.
    pub fn part(self, span: Span) -> Part {
        Partition::new(self.0, span.start, span.bytes())
    }
}

/// The whole flash, of which [`Partitions::written`](slipsense::update::partitions::Partitions::written) can be
/// written.
pub struct BoardFlash(Flash<'static, Async>);

/// Do `length` bytes from `offset` on lie in `span`?
fn check(span: Span, offset: u32, length: usize) -> Result<(), flash::Error> {
    let end = offset.checked_add(length as u32);
    if offset < span.start || end.is_none_or(|end| end > span.end) { Err(flash::Error::Size) } else { Ok(()) }
}

impl ErrorType for BoardFlash {
    type Error = flash::Error;
}

impl ReadNorFlash for BoardFlash {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, out: &mut [u8]) -> Result<(), flash::Error> {
        check(PARTITIONS.flash, offset, out.len())?;
        let mut address = FLASH_BASE as u32 + offset;
        let mut out = out.iter_mut();
        while out.len() > 0 {
            let word = address / WRITE_SIZE as u32 * WRITE_SIZE as u32;
            // SAFETY: the word holds bytes of the range checked above.
            let bytes = unsafe { flash_word::read_word(word) };
            // The bytes first: the one that finds the other's end is lost.
            for (&from, to) in bytes.iter().skip((address - word) as usize).zip(out.by_ref()) {
                *to = from;
                address += 1;
            }
        }
        // Whoever reads a whole firmware lets frames be decided meanwhile.
        yield_now().await;
        Ok(())
    }

    fn capacity(&self) -> usize {
        PARTITIONS.flash.bytes() as usize
    }
}

impl NorFlash for BoardFlash {
    const WRITE_SIZE: usize = WRITE_SIZE;
    const ERASE_SIZE: usize = SECTOR_BYTES as usize;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), flash::Error> {
        check(PARTITIONS.written(), from, to.saturating_sub(from) as usize)?;
        flash_word::clear_errors();
        self.0.erase(from, to).await
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), flash::Error> {
        check(PARTITIONS.written(), offset, bytes.len())?;
        flash_word::clear_errors();
        self.0.write(offset, bytes).await
    }
}
