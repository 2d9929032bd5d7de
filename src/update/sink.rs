//! From the pieces of a file to an installed image.

use embedded_storage_async::nor_flash::NorFlash;

use super::Refusal;
use super::image::{HEADER_BYTES, Header, ImageVersion};
use super::key::Keys;
use super::model_slot::{MODEL_AT, ModelSlot};
use super::partitions::Partitions;
use super::slot::{self, Writer, check_hash, firmware_header_at, firmware_room};
use super::state::{Run, UpdateState};
use crate::node::{FileSink, UpdateTarget};

/// Where a new firmware goes.
pub struct FirmwareSlot<D, S> {
    /// The slot, from its address 0 on.
    pub dfu: D,
    /// What the bootloader acts on.
    pub state: UpdateState<S>,
}

/// Takes the pieces of an image, checks it, and installs it if nothing speaks against it.
///
/// The header is checked before anything is erased. A firmware is checked where it lies in flash, before it is marked;
/// a model is collected and checked in RAM, so that a transfer that ends early leaves the installed one.
pub struct UpdateSink<'a, D, S, M> {
    board: &'static Partitions,
    keys: &'static Keys,
    running: Option<Header>,
    /// The firmware that the next restart swaps in.
    ready: Option<Header>,
    firmware: Result<FirmwareSlot<D, S>, Refusal>,
    model: ModelSlot<M>,
    place: &'a mut [u8],
    image: Option<Image>,
}

/// An image on its way.
struct Image {
    target: UpdateTarget,
    /// Bytes of the file that have come.
    arrived: u32,
    raw_header: [u8; HEADER_BYTES],
    /// Once it is complete and has been found good.
    header: Option<Header>,
    /// Of a firmware.
    writer: Writer,
}

impl<'a, D: NorFlash, S: NorFlash, M: NorFlash> UpdateSink<'a, D, S, M> {
    /// `running`: the header of the firmware that runs, if it has one. `firmware`: where a new one goes, or why there is no such
    /// place. `place`: where a model is collected and tried before it is installed; it begins at a multiple of four
    /// bytes and is as long as the longest model that the board can run.
    pub const fn new(
        board: &'static Partitions,
        keys: &'static Keys,
        running: Option<Header>,
        firmware: Result<FirmwareSlot<D, S>, Refusal>,
        model: ModelSlot<M>,
        place: &'a mut [u8],
    ) -> Self {
        Self { board, keys, running, ready: None, firmware, model, place, image: None }
    }

    /// What the bootloader keeps; `None` on a board without one.
    pub fn state(&mut self) -> Option<&mut UpdateState<S>> {
        self.firmware.as_mut().ok().map(|firmware| &mut firmware.state)
    }

    /// The signed header of the firmware that runs.
    pub const fn running(&self) -> Option<&Header> {
        self.running.as_ref()
    }

    /// The model's slot.
    pub const fn model(&mut self) -> &mut ModelSlot<M> {
        &mut self.model
    }

    /// Bytes of the longest file that is taken, for [`Node::begin_download`](crate::node::Node::begin_download); or
    /// why none is.
    pub async fn begin(&mut self, target: UpdateTarget) -> Result<u32, Refusal> {
        self.image = None;
        if target == UpdateTarget::Firmware {
            self.firmware.as_mut().map_err(|why| *why)?.is_free().await?;
        }
        Ok(self.room(target).saturating_add(HEADER_BYTES as u32))
    }

    /// Bytes of the longest payload.
    fn room(&self, target: UpdateTarget) -> u32 {
        match target {
            UpdateTarget::Firmware => firmware_room(self.board),
            UpdateTarget::Model => {
                let slot = (self.model.flash.capacity() as u32).saturating_sub(MODEL_AT);
                slot.min(self.place.len() as u32)
            }
        }
    }

    /// A piece: the first ones go to the header, the others to flash.
    async fn take(&mut self, target: UpdateTarget, offset: u32, bytes: &[u8]) -> Result<(), Refusal> {
        // Taken, so that an error leaves nothing to go on with.
        let image = if offset == 0 { Some(Image::new(target)) } else { self.image.take() };
        let mut image = image.ok_or(Refusal::OutOfOrder)?;
        if image.target != target || image.arrived != offset {
            return Err(Refusal::OutOfOrder);
        }
        let bytes = image.take_header(bytes);
        if image.header.is_none() && image.arrived as usize >= HEADER_BYTES {
            image.header = Some(self.admit(target, &image.raw_header).await?);
        }
        if let Some(header) = &image.header {
            let at = image.arrived as usize - HEADER_BYTES;
            image.arrived = image.arrived.saturating_add(bytes.len() as u32);
            if image.arrived - HEADER_BYTES as u32 > header.length {
                return Err(Refusal::Trailing);
            }
            match target {
                UpdateTarget::Firmware => {
                    let firmware = self.firmware.as_mut().map_err(|why| *why)?;
                    image.writer.put(&mut firmware.dfu, bytes).await?;
                }
                UpdateTarget::Model => {
                    let place = self.place.get_mut(at..).and_then(|place| place.get_mut(..bytes.len()));
                    place.ok_or(Refusal::TooLong)?.copy_from_slice(bytes);
                }
            }
        }
        self.image = Some(image);
        Ok(())
    }

    /// May the image with this header come in? What costs little is looked at first, the signature last. Then make
    /// room in flash for a firmware.
    async fn admit(&mut self, target: UpdateTarget, raw: &[u8; HEADER_BYTES]) -> Result<Header, Refusal> {
        let floor = match target {
            UpdateTarget::Firmware => {
                self.running.as_ref().map_or(ImageVersion::SOFTWARE, |header| header.version)
            }
            // A newer one may be installed: known once its signature has been checked.
            UpdateTarget::Model => self.model.floor,
        };
        let claimed = Header::inspect(raw)?;
        claimed.admit(target, self.board, floor, self.room(target))?;
        // Whoever recorded this header on the bus must not have the other slot erased by it.
        if [&self.running, &self.ready].into_iter().flatten().any(|held| *held == claimed) {
            return Err(Refusal::Held);
        }
        let header = Header::verify(raw, self.keys)?;
        match target {
            UpdateTarget::Firmware => {
                let firmware = self.firmware.as_mut().map_err(|why| *why)?;
                firmware.is_free().await?;
                // One that was ready to be swapped in is withdrawn before it is overwritten.
                self.ready = None;
                firmware.state.confirm().await?;
                slot::erase(&mut firmware.dfu, self.board.active.bytes()).await?;
            }
            UpdateTarget::Model if header.version < self.model.version().await => {
                return Err(Refusal::Older);
            }
            UpdateTarget::Model => {}
        }
        Ok(header)
    }

    /// All has come: check it where it lies, then say that it is whole.
    async fn complete(&mut self, target: UpdateTarget, length: u32) -> Result<(), Refusal> {
        let mut image = self.image.take().ok_or(Refusal::OutOfOrder)?;
        if image.target != target || image.arrived != length {
            return Err(Refusal::OutOfOrder);
        }
        let header = image.header.ok_or(Refusal::ShorterThanHeader)?;
        if length - HEADER_BYTES as u32 != header.length {
            return Err(Refusal::Truncated);
        }
        match target {
            UpdateTarget::Firmware => {
                let firmware = self.firmware.as_mut().map_err(|why| *why)?;
                let header_at = firmware_header_at(self.board);
                image.writer.flush(&mut firmware.dfu).await?;
                check_hash(&mut firmware.dfu, 0, &header).await?;
                Writer::new(header_at).put(&mut firmware.dfu, &image.raw_header).await?;
                // The header too counts only as it can be read.
                slot::check_firmware(&mut firmware.dfu, 0, self.board, self.keys).await?;
                firmware.state.mark_updated().await?;
                self.ready = Some(header);
                Ok(())
            }
            UpdateTarget::Model => {
                let model = self.place.get(..header.length as usize).ok_or(Refusal::TooLong)?;
                self.model.install(&image.raw_header, &header, model).await
            }
        }
    }
}

impl<D: NorFlash, S: NorFlash> FirmwareSlot<D, S> {
    /// May the slot be written?
    async fn is_free(&mut self) -> Result<(), Refusal> {
        match self.state.run().await? {
            Run::OnTrial => Err(Refusal::OnTrial),
            Run::Confirmed | Run::Pending | Run::RolledBack => Ok(()),
        }
    }
}

impl Image {
    const fn new(target: UpdateTarget) -> Self {
        Self { target, arrived: 0, raw_header: [0; HEADER_BYTES], header: None, writer: Writer::new(0) }
    }

    /// Fill the header; what is behind it.
    fn take_header<'b>(&mut self, bytes: &'b [u8]) -> &'b [u8] {
        let missing = HEADER_BYTES.saturating_sub(self.arrived as usize);
        let (header, behind) = bytes.split_at_checked(missing).unwrap_or((bytes, &[]));
        for (to, from) in self.raw_header.iter_mut().skip(self.arrived as usize).zip(header) {
            *to = *from;
        }
        self.arrived = self.arrived.saturating_add(header.len() as u32);
        behind
    }
}

impl<D: NorFlash, S: NorFlash, M: NorFlash> FileSink for UpdateSink<'_, D, S, M> {
    async fn write(&mut self, target: UpdateTarget, offset: u32, bytes: &[u8]) -> Result<(), &'static str> {
        self.take(target, offset, bytes).await.map_err(Refusal::reason)
    }

    async fn finish(&mut self, target: UpdateTarget, length: u32) -> Result<(), &'static str> {
        self.complete(target, length).await.map_err(Refusal::reason)
    }
}
