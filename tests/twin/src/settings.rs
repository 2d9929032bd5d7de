//! Flash that holds settings before the board starts, as the library itself stores them.

use std::path::Path;

use anyhow::{Result, anyhow};
use embassy_futures::block_on;
use embedded_storage_async::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use rigless::image::Image;
use slipsense::settings::{SCRATCH, Setting, Settings, SettingsStore};
use slipsense::update::partitions::{FLASH_BASE, SECTOR_BYTES};

use crate::programs::BOARD;

/// Of the STM32H743: what one write programs.
const WORD: usize = 32;
const ERASED: u8 = 0xFF;

struct Sectors(Vec<u8>);

impl ErrorType for Sectors {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Sectors {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        bytes.copy_from_slice(&self.0[offset as usize..][..bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.0.len()
    }
}

impl NorFlash for Sectors {
    const WRITE_SIZE: usize = WORD;
    const ERASE_SIZE: usize = SECTOR_BYTES as usize;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        self.0[from as usize..to as usize].fill(ERASED);
        Ok(())
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        self.0[offset as usize..][..bytes.len()].copy_from_slice(bytes);
        Ok(())
    }
}

/// What the flash holds of a board with these settings, all else as delivered.
pub fn stored(changed: &[(Setting, i64)]) -> Result<Image> {
    let mut settings = Settings::new();
    for &(setting, value) in changed {
        settings.set(setting, &[value]).map_err(|error| anyhow!("{error:?}"))?;
    }
    let (start, end) = (BOARD.settings.start, BOARD.settings.end);
    let blank = Sectors(vec![ERASED; (end - start) as usize]);
    let mut store =
        SettingsStore::new(blank, 0..end - start, Box::new(SCRATCH)).map_err(|error| anyhow!("{error:?}"))?;
    block_on(store.store(&settings))?;
    let address = u64::from(FLASH_BASE + start);
    Ok(Image::new(Path::new("settings"), store.into_flash().0, Some(address))?)
}
