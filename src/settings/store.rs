//! The configuration and the arrays' calibrations in flash, in a ring of sectors that the crate `sequential-storage`
//! writes one after the other.
//!
//! The whole configuration is one item, and so is the calibration behind each connector: an item is there whole or not
//! at all. A store appends; only when a sector is full is the other one erased, after all items are safe. Flash of the
//! STM32H7 has sectors of 128 KB and writes 32 bytes at a time, so that one configuration takes 17 writes and a sector
//! holds more than 200; a calibration takes 197, and a sector holds 20.

use core::borrow::BorrowMut;
use core::fmt;
use core::ops::Range;

use embedded_storage_async::nor_flash::NorFlash;
use sequential_storage::cache::key_pointers::ArrayKeyPointers;
use sequential_storage::cache::{Cache, Uncached};
use sequential_storage::map::{MapConfig, MapStorage, SerializationError, Value};

use super::encoding::{Damage, ENCODED_MAX};
use super::{Settings, TABLE};
use crate::calibration::{Calibration, RECORD_BYTES};
use crate::params::MAX_SENSORS;

/// The configuration's name. A calibration's is 1 more than its connector's number; behind them is the model floor's.
const KEY: u8 = 0;
const FLOOR_KEY: u8 = KEY + 1 + MAX_SENSORS as u8;
const KEYS: usize = FLOOR_KEY as usize + 1;
/// Bytes that a configuration needs, with room for a later version's settings.
const SETTINGS_BYTES: usize = 2 * ENCODED_MAX;
/// Bytes that an item needs on its way: the longest and its name, up to whole words of 32 bytes.
const SCRATCH_BYTES: usize =
    (if RECORD_BYTES > SETTINGS_BYTES { RECORD_BYTES } else { SETTINGS_BYTES } + 1).next_multiple_of(32);

/// Where items are on their way between flash and RAM, of the store's own or of somebody else.
pub type Scratch = [u8; SCRATCH_BYTES];
/// No item yet on its way.
pub const SCRATCH: Scratch = [0; SCRATCH_BYTES];

/// Where settings came from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the text of a [`LoadReport`] says it")]
pub enum Origin {
    Stored,
    Blank,
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

/// Where the newest item of each key lies. Without it, emptying a full sector looks each of its items up in all of the
/// flash, which takes more seconds than a client waits.
type ItemCache = Cache<Uncached, Uncached, ArrayKeyPointers<u8, KEYS>, u8>;

/// A configuration's place in flash: at least two sectors.
pub struct SettingsStore<F: NorFlash, B> {
    map: MapStorage<u8, F, ItemCache>,
    scratch: B,
}

/// A calibration on its way into the flash.
struct Record<'a>(&'a Calibration);

impl<'a> Value<'a> for Record<'_> {
    fn serialize_into(&self, buffer: &mut [u8]) -> Result<usize, SerializationError> {
        // Of an array that was not measured there is nothing to store.
        let length = if self.0.is_measured() { self.0.encode(buffer) } else { Some(0) };
        length.ok_or(SerializationError::BufferTooSmall)
    }

    fn deserialize_from(_: &'a [u8]) -> Result<(Self, usize), SerializationError> {
        // Read as bytes: see `load_calibration`.
        Err(SerializationError::InvalidFormat)
    }
}

/// A range of flash that cannot hold settings: not whole sectors, fewer than two, or words above 32 bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RangeError;

impl<F: NorFlash, B: BorrowMut<Scratch>> SettingsStore<F, B> {
    /// Settings live in `range` of the flash, addresses as the flash counts them.
    pub fn new(flash: F, range: Range<u32>, scratch: B) -> Result<Self, RangeError> {
        // A sector must hold a configuration beside the marks at its ends, four words of at most 32 bytes.
        if F::ERASE_SIZE < SETTINGS_BYTES.next_multiple_of(32) + 4 * 32 {
            return Err(RangeError);
        }
        let config = MapConfig::try_new(range).map_err(|_| RangeError)?;
        let map = MapStorage::new(flash, config, Cache::new(Uncached, Uncached, ArrayKeyPointers::new()));
        Ok(Self { map, scratch })
    }

    /// The stored configuration, or the defaults; and what was wrong. A flash that holds nothing readable is
    /// left as it is, the next store mends it.
    pub async fn load(&mut self) -> (Settings, LoadReport) {
        let found = match self.map.fetch_item::<&[u8]>(self.scratch.borrow_mut(), &KEY).await {
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
        for address in range.step_by(SCRATCH_BYTES) {
            let left = self.map.flash_range().end.saturating_sub(address) as usize;
            let Some(part) = self.scratch.borrow_mut().get_mut(..left.min(SCRATCH_BYTES)) else { continue };
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
        let bytes = &settings.encode()[..];
        self.store_item(KEY, &bytes, |held| held == Some(bytes)).await
    }

    async fn store_item<'v>(
        &mut self,
        key: u8,
        item: &impl Value<'v>,
        is_item: impl Fn(Option<&[u8]>) -> bool,
    ) -> Result<(), StoreError> {
        if self.holds(key, &is_item).await {
            return Ok(());
        }
        if key != KEY {
            self.put_first_settings().await?;
        }
        self.put(key, item).await?;
        if self.holds(key, is_item).await { Ok(()) } else { Err(StoreError::Verify) }
    }

    /// A flash that holds anything holds settings: where they are missing, they are damaged.
    async fn put_first_settings(&mut self) -> Result<(), StoreError> {
        let found = self.map.fetch_item::<&[u8]>(self.scratch.borrow_mut(), &KEY).await;
        if matches!(found, Ok(None)) && self.blank_or_damaged().await == Origin::Blank {
            self.put(KEY, &&Settings::new().encode()[..]).await?;
        }
        Ok(())
    }

    async fn holds(&mut self, key: u8, is_item: impl Fn(Option<&[u8]>) -> bool) -> bool {
        self.map.fetch_item::<&[u8]>(self.scratch.borrow_mut(), &key).await.is_ok_and(is_item)
    }

    /// The version that no model may be below, as [`store_model_floor`](Self::store_model_floor) was given it; zeros
    /// before the first time.
    pub async fn model_floor(&mut self) -> [u8; 4] {
        let held = self.map.fetch_item::<&[u8]>(self.scratch.borrow_mut(), &FLOOR_KEY).await;
        held.ok().flatten().and_then(|held| held.try_into().ok()).unwrap_or_default()
    }

    /// Store it; a factory reset leaves it. As with [`store`](Self::store), what is stored already is not written again.
    pub async fn store_model_floor(&mut self, version: [u8; 4]) -> Result<(), StoreError> {
        let bytes = &version[..];
        self.store_item(FLOOR_KEY, &bytes, |held| held == Some(bytes)).await
    }

    /// Read the calibration of the array behind a connector; nominal values where none is stored, or none that can be
    /// read. `false`: there was something that could not.
    pub async fn load_calibration(&mut self, connector: usize, calibration: &mut Calibration) -> bool {
        calibration.set_nominal();
        let key = KEY + 1 + connector as u8;
        match self.map.fetch_item::<&[u8]>(self.scratch.borrow_mut(), &key).await {
            Ok(None | Some([])) => true,
            Ok(Some(record)) => calibration.decode(record),
            Err(_) => false,
        }
    }

    /// Store the calibration of the array behind a connector and read it back. Until it is there, the one before is. As
    /// with [`store`](Self::store), one that is stored already is not written again.
    pub async fn store_calibration(
        &mut self,
        connector: usize,
        calibration: &Calibration,
    ) -> Result<(), StoreError> {
        let key = KEY + 1 + connector as u8;
        let is_it = |record: Option<&[u8]>| calibration.is_record(record.unwrap_or_default());
        self.store_item(key, &Record(calibration), is_it).await
    }

    async fn put<'v>(&mut self, key: u8, item: &impl Value<'v>) -> Result<(), StoreError> {
        let scratch = self.scratch.borrow_mut();
        match self.map.store_item(scratch, &key, item).await {
            Ok(()) => Ok(()),
            Err(sequential_storage::Error::Storage { .. }) => Err(StoreError::Flash),
            Err(sequential_storage::Error::ItemTooBig) => Err(StoreError::Verify),
            Err(_) => {
                // Beyond repair: begin anew. Only here can a power cut lose what was stored, and it was lost
                // already.
                self.map.erase_all().await.map_err(|_| StoreError::Flash)?;
                self.map.store_item(scratch, &key, item).await.map_err(|_| StoreError::Corrupted)
            }
        }
    }

    /// The flash.
    pub fn into_flash(self) -> F {
        self.map.destroy().0
    }
}
