//! The slot of a model: its header, then the model file. A new one is checked in RAM before the slot is erased; its
//! header is written last, so that what has one is whole.

use core::fmt;

use embassy_futures::yield_now;
use embedded_storage_async::nor_flash::{NorFlash, ReadNorFlash};

use super::Refusal;
use super::image::{HEADER_BYTES, Header, ImageVersion};
use super::key::Keys;
use super::partitions::{NUCLEO_H743ZI2, Partitions};
use super::slot::{self, PayloadHash, Writer, check_hash, header_bytes};
use crate::net::Model;
use crate::node::UpdateTarget;
use crate::params::limits::MODEL_BYTES;

/// Where the model lies in its slot.
pub(super) const MODEL_AT: u32 = HEADER_BYTES as u32;
const _: () =
    assert!(MODEL_AT + MODEL_BYTES as u32 <= NUCLEO_H743ZI2.model.bytes(), "the longest does not fit");
/// Bytes of a model that are hashed between two chances for other tasks.
const HASH_AT_ONCE: usize = 4096;

/// Which model runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SlotModel {
    /// The one of the slot, of this version.
    Slot(ImageVersion),
    /// The one in the firmware, because the slot was not usable. [`Refusal::Blank`]: none was ever installed.
    BuiltIn(Refusal),
}

impl fmt::Display for SlotModel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Slot(version) => write!(f, "model: version {version} of the model slot"),
            Self::BuiltIn(Refusal::Blank) => f.write_str("model: the one in the firmware"),
            Self::BuiltIn(why) => write!(f, "model: the one in the firmware; that of the slot: {why}"),
        }
    }
}

/// The slot of a model.
pub struct ModelSlot<M> {
    pub(super) flash: M,
    board: &'static Partitions,
    keys: &'static Keys,
    pub(super) floor: ImageVersion,
}

impl<M: ReadNorFlash> ModelSlot<M> {
    /// `flash` holds the slot from its address 0 on, and nothing else. `floor`: the newest version that has confirmed.
    pub const fn new(flash: M, board: &'static Partitions, keys: &'static Keys, floor: ImageVersion) -> Self {
        Self { flash, board, keys, floor }
    }

    /// From now on none below this version is taken.
    pub const fn raise_floor(&mut self, version: ImageVersion) {
        self.floor = version;
    }

    /// What is installed, going by its header: signed, for this board, and not below the floor.
    pub async fn header(&mut self) -> Result<Header, Refusal> {
        let header = Header::verify(&header_bytes(&mut self.flash, 0).await?, self.keys)?;
        let room = (self.flash.capacity() as u32).saturating_sub(MODEL_AT);
        header.admit(UpdateTarget::Model, self.board, self.floor, room)?;
        Ok(header)
    }

    /// Copy the installed model to `place`, which begins at a multiple of four bytes, and prove that it may run:
    /// signature, hash, version, bounds. It fills the first `length` bytes, which [`Model::parse`] will read; on an
    /// error nothing there means anything.
    pub async fn load(&mut self, place: &mut [u8]) -> Result<Header, Refusal> {
        let header = self.header().await?;
        check_hash(&mut self.flash, MODEL_AT, &header).await?;
        let place = place.get_mut(..header.length as usize).ok_or(Refusal::TooLong)?;
        self.flash.read(MODEL_AT, place).await.map_err(|_| Refusal::Flash)?;
        Model::parse(place).map_err(Refusal::Model)?;
        Ok(header)
    }
}

impl<M: NorFlash> ModelSlot<M> {
    /// Write a model with its signed header, unless it is there already. `model` begins at a multiple of four bytes.
    pub(super) async fn install(
        &mut self,
        raw_header: &[u8; HEADER_BYTES],
        header: &Header,
        model: &[u8],
    ) -> Result<(), Refusal> {
        let mut hash = PayloadHash::new();
        for part in model.chunks(HASH_AT_ONCE) {
            hash.update(part);
            // Whoever decides frames must not wait for the whole of it.
            yield_now().await;
        }
        hash.check(header)?;
        Model::parse(model).map_err(Refusal::Model)?;
        let is_there = self.header().await.as_ref() == Ok(header);
        if is_there && check_hash(&mut self.flash, MODEL_AT, header).await.is_ok() {
            return Ok(());
        }
        let bytes = self.flash.capacity() as u32;
        slot::erase(&mut self.flash, bytes).await?;
        let mut writer = Writer::new(MODEL_AT);
        writer.put(&mut self.flash, model).await?;
        writer.flush(&mut self.flash).await?;
        check_hash(&mut self.flash, MODEL_AT, header).await?;
        Writer::new(0).put(&mut self.flash, raw_header).await?;
        self.header().await.map(|_| ())
    }

    /// The version that a new one may not be below: the installed one's, and the floor while there is no whole one.
    pub(super) async fn version(&mut self) -> ImageVersion {
        self.header().await.map_or(self.floor, |header| header.version)
    }
}
