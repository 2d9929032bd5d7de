//! A partition of the flash, written by embassy's driver, read so that a torn word does not fault.

use core::cell::RefCell;

use embassy_stm32::flash::{Blocking, Error, Flash, WRITE_SIZE};
use embassy_stm32::pac;
use embassy_stm32::pac::iwdg::vals::Key;
use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use slipsense::update::partitions::{FLASH_BASE, SECTOR_BYTES, Span};

use crate::flash_word;

/// Whatever the bootloader does ends in one of these: the watchdog is fed with it.
pub fn feed_watchdog() {
    pac::IWDG1.kr().write(|w| w.set_key(Key::RESET));
}

/// A stretch of flash. Addresses count from its begin.
pub struct Partition<'a> {
    pub flash: &'a RefCell<Flash<'static, Blocking>>,
    pub span: Span,
}

impl Partition<'_> {
    /// Offset into the flash of a stretch within the partition.
    fn at(&self, from: u32, length: u32) -> Result<u32, Error> {
        match from.checked_add(length) {
            Some(end) if end <= self.span.bytes() => Ok(self.span.start + from),
            _ => Err(Error::Size),
        }
    }
}

impl ErrorType for Partition<'_> {
    type Error = Error;
}

impl ReadNorFlash for Partition<'_> {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, out: &mut [u8]) -> Result<(), Error> {
        let mut address = FLASH_BASE + self.at(offset, out.len() as u32)?;
        feed_watchdog();
        let mut rest = out;
        while !rest.is_empty() {
            let word = address / WRITE_SIZE as u32 * WRITE_SIZE as u32;
            // SAFETY: the word holds bytes of the partition, which is made of whole words.
            let bytes = unsafe { flash_word::read_word(word) };
            let bytes = bytes.get((address - word) as usize..).unwrap_or(&[]);
            let count = bytes.len().min(rest.len());
            let (part, behind) = rest.split_at_mut(count);
            part.copy_from_slice(&bytes[..count]);
            address += count as u32;
            rest = behind;
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.span.bytes() as usize
    }
}

impl NorFlash for Partition<'_> {
    const WRITE_SIZE: usize = WRITE_SIZE;
    const ERASE_SIZE: usize = SECTOR_BYTES as usize;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Error> {
        let mut at = self.at(from, to.saturating_sub(from))?;
        let end = self.span.start + to;
        // One by one: the watchdog has patience for one.
        while at < end {
            feed_watchdog();
            flash_word::clear_errors();
            self.flash.borrow_mut().blocking_erase(at, at + SECTOR_BYTES)?;
            at += SECTOR_BYTES;
        }
        feed_watchdog();
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Error> {
        let at = self.at(offset, bytes.len() as u32)?;
        feed_watchdog();
        flash_word::clear_errors();
        self.flash.borrow_mut().blocking_write(at, bytes)
    }
}
