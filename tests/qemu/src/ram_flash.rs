//! Flash in RAM, with the words of an STM32H7 and smaller sectors.

use embedded_storage_async::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};

/// Bytes of a sector.
pub const SECTOR: usize = 8 * 1024;
/// Bytes of all.
pub const FLASH_BYTES: usize = 2 * SECTOR;

/// Bytes that are erased to 0xFF and written by clearing bits.
pub struct RamFlash<'a>(pub &'a mut [u8; FLASH_BYTES]);

/// An access outside.
#[derive(Debug)]
pub struct Outside;

impl NorFlashError for Outside {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::OutOfBounds
    }
}

impl ErrorType for RamFlash<'_> {
    type Error = Outside;
}

impl ReadNorFlash for RamFlash<'_> {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, out: &mut [u8]) -> Result<(), Outside> {
        let offset = offset as usize;
        out.copy_from_slice(self.0.get(offset..offset + out.len()).ok_or(Outside)?);
        Ok(())
    }

    fn capacity(&self) -> usize {
        FLASH_BYTES
    }
}

impl NorFlash for RamFlash<'_> {
    const WRITE_SIZE: usize = 32;
    const ERASE_SIZE: usize = SECTOR;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), Outside> {
        self.0.get_mut(from as usize..to as usize).ok_or(Outside)?.fill(0xFF);
        Ok(())
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Outside> {
        let offset = offset as usize;
        let own = self.0.get_mut(offset..offset + bytes.len()).ok_or(Outside)?;
        own.iter_mut().zip(bytes).for_each(|(own, byte)| *own &= byte);
        Ok(())
    }
}
