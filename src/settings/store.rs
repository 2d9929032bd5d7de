//! The configuration in flash, in a ring of sectors that the crate `sequential-storage` writes one after the
//! other.
//!
//! The whole configuration is one item, which is there whole or not at all. A store appends; only when a
//! sector is full is the other one erased, after the new item is safe. Flash of the STM32H7 has sectors of
//! 128 KB and writes 32 bytes at a time, so that one configuration takes 17 writes and a sector holds more
//! than 200.

use core::fmt;
use core::ops::Range;

use embedded_storage_async::nor_flash::NorFlash;
use sequential_storage::cache::Cache;
use sequential_storage::cache::Uncached;
use sequential_storage::map::{MapConfig, MapStorage};

use super::encoding::{Damage, ENCODED_MAX};
use super::{Settings, TABLE};

/// The one item's name.
const KEY: u8 = 0;
/// Bytes that one item needs on its way: the configuration and its name, up to whole words of 32 bytes. With
/// room for a later version's settings.
const BUFFER_BYTES: usize = (2 * ENCODED_MAX).next_multiple_of(32);

/// Where settings came from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origin {
    /// From flash.
    Stored,
    /// The flash is blank: the defaults.
    Blank,
    /// The flash holds something, but no readable configuration: the defaults.
    Damaged,
    /// The flash could not be read: the defaults.
    Unreadable,
}

/// How loading went.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LoadReport {
    /// Where the settings came from.
    pub origin: Origin,
    /// What was wrong with what was found.
    pub damage: Damage,
}

impl LoadReport {
    /// Was something lost?
    pub fn is_damaged(&self) -> bool {
        match self.origin {
            Origin::Stored => self.damage.settings != 0 || self.damage.cut,
            Origin::Blank => false,
            Origin::Damaged | Origin::Unreadable => true,
        }
    }
}

impl fmt::Display for LoadReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.origin {
            Origin::Blank => return f.write_str("settings: none stored, defaults"),
            Origin::Damaged => return f.write_str("settings: flash damaged, defaults"),
            Origin::Unreadable => return f.write_str("settings: flash unreadable, defaults"),
            Origin::Stored => {}
        }
        if !self.is_damaged() {
            return f.write_str("settings: read from flash");
        }
        f.write_str("settings damaged, default for")?;
        for definition in &TABLE {
            if self.damage.settings >> (definition.setting as u32) & 1 != 0 {
                write!(f, " {}", definition.name)?;
            }
        }
        Ok(())
    }
}

/// Why a configuration was not stored. The one before is still there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StoreError {
    /// The flash refused a write or an erase.
    Flash,
    /// What the flash holds cannot be repaired.
    Corrupted,
    /// What was read back is not what was written.
    Verify,
}

impl StoreError {
    /// In words.
    pub const fn text(self) -> &'static str {
        match self {
            Self::Flash => "the flash refused a write",
            Self::Corrupted => "the flash holds what cannot be repaired",
            Self::Verify => "the flash read back something else",
        }
    }
}

impl fmt::Display for StoreError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.text())
    }
}

impl core::error::Error for StoreError {}

/// A configuration's place in flash: at least two sectors.
pub struct SettingsStore<F: NorFlash> {
    map: MapStorage<u8, F, Cache<Uncached, Uncached, Uncached, u8>>,
    buffer: [u8; BUFFER_BYTES],
}

/// A range of flash that cannot hold settings: not whole sectors, fewer than two, or words above 32 bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RangeError;

impl<F: NorFlash> SettingsStore<F> {
    /// Settings live in `range` of the flash, addresses as the flash counts them.
    pub fn new(flash: F, range: Range<u32>) -> Result<Self, RangeError> {
        // A sector must hold a configuration beside the marks at its ends, four words of at most 32 bytes.
        if F::ERASE_SIZE < BUFFER_BYTES + 4 * 32 {
            return Err(RangeError);
        }
        let config = MapConfig::try_new(range).map_err(|_| RangeError)?;
        let map = MapStorage::new(flash, config, Cache::new_uncached());
        Ok(Self { map, buffer: [0; BUFFER_BYTES] })
    }

    /// The stored configuration, or the defaults; and what was wrong. A flash that holds nothing readable is
    /// left as it is, the next store mends it.
    pub async fn load(&mut self) -> (Settings, LoadReport) {
        let found = match self.map.fetch_item::<&[u8]>(&mut self.buffer, &KEY).await {
            Ok(Some(bytes)) => Ok(Some(Settings::decode(bytes))),
            Ok(None) => Ok(None),
            Err(sequential_storage::Error::Storage { .. }) => Err(Origin::Unreadable),
            Err(_) => Err(Origin::Damaged),
        };
        let origin = match found {
            Ok(Some((settings, damage))) => {
                return (settings, LoadReport { origin: Origin::Stored, damage });
            }
            Ok(None) => self.blank_or_damaged().await,
            Err(origin) => origin,
        };
        (Settings::new(), LoadReport { origin, damage: Damage::default() })
    }

    async fn blank_or_damaged(&mut self) -> Origin {
        let range = self.map.flash_range();
        for address in range.step_by(BUFFER_BYTES / 32 * 32) {
            let left = self.map.flash_range().end.saturating_sub(address) as usize;
            let Some(part) = self.buffer.get_mut(..left.min(BUFFER_BYTES)) else { continue };
            if self.map.flash().read(address, part).await.is_err() {
                return Origin::Unreadable;
            }
            if part.iter().any(|&byte| byte != 0xFF) {
                return Origin::Damaged;
            }
        }
        Origin::Blank
    }

    /// Store a whole configuration and read it back. Until it is there, the one before is. One that is stored already
    /// is not written again, so that nobody can wear the flash out by storing.
    pub async fn store(&mut self, settings: &Settings) -> Result<(), StoreError> {
        let encoded = settings.encode();
        if let Ok(Some(bytes)) = self.map.fetch_item::<&[u8]>(&mut self.buffer, &KEY).await
            && bytes == encoded
        {
            return Ok(());
        }
        let stored = self.map.store_item(&mut self.buffer, &KEY, &encoded.as_slice()).await;
        match stored {
            Ok(()) => {}
            Err(sequential_storage::Error::Storage { .. }) => return Err(StoreError::Flash),
            Err(_) => {
                // Beyond repair: begin anew. Only here can a power cut lose what was stored, and it was lost
                // already.
                self.map.erase_all().await.map_err(|_| StoreError::Flash)?;
                let again = self.map.store_item(&mut self.buffer, &KEY, &encoded.as_slice()).await;
                again.map_err(|_| StoreError::Corrupted)?;
            }
        }
        match self.map.fetch_item::<&[u8]>(&mut self.buffer, &KEY).await {
            Ok(Some(bytes)) if bytes == encoded => Ok(()),
            _ => Err(StoreError::Verify),
        }
    }

    /// The flash.
    pub fn into_flash(self) -> F {
        self.map.destroy().0
    }
}
