//! A board of small sectors: what its firmware and its bootloader do with the flash, without both.

use std::cell::RefCell;
use std::rc::Rc;

use ed25519_dalek::{Signer, SigningKey};
use embassy_embedded_hal::adapter::BlockingAsync;
use embassy_futures::block_on;
use rand::{RngCore, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sha2::{Digest, Sha256};
use slipsense::net::Aligned;
use slipsense::net::format::Dims;
use slipsense::node::{CHUNK_BYTES, FileSink, UpdateTarget};
use slipsense::update::boot::{BootFailure, Firmware, Slots};
use slipsense::update::partitions::{Partitions, Span};
use slipsense::update::{
    DEVELOPMENT_KEY, DEVELOPMENT_SEED, FirmwareSlot, HEADER_BYTES, Header, ImageVersion, ModelSlot, Refusal,
    Run, UpdateSink, UpdateState,
};

use super::flash::{Cells, Part, SECTOR, WORD};

const fn sectors(first: u32, count: u32) -> Span {
    Span { start: first * SECTOR as u32, end: (first + count) * SECTOR as u32 }
}

/// Partitions as those of the NUCLEO-H743ZI2, of small sectors; the model's has several.
pub static BOARD: Partitions = Partitions {
    id: 77,
    label: "TEST",
    boot: sectors(0, 1),
    active: sectors(1, 3),
    dfu: sectors(4, 4),
    state: sectors(8, 1),
    model: sectors(9, MODEL_SECTORS),
    settings: sectors(9 + MODEL_SECTORS, 2),
    flash: sectors(0, 11 + MODEL_SECTORS),
};
const MODEL_SECTORS: u32 = 8;
/// RAM that a model may take.
pub const PLACE: usize = MODEL_SECTORS as usize * SECTOR - HEADER_BYTES;

pub const OLD: ImageVersion = ImageVersion { major: 1, minor: 0, patch: 3 };
pub const NEW: ImageVersion = ImageVersion { major: 1, minor: 1, patch: 0 };
pub const NEWEST: ImageVersion = ImageVersion { major: 1, minor: 1, patch: 1 };

/// A partition as the firmware sees it.
pub type AsyncPart = BlockingAsync<Part>;
pub type Sink<'a> = UpdateSink<'a, AsyncPart, AsyncPart, AsyncPart>;

/// Any bytes.
pub fn payload(seed: u64, length: usize) -> Vec<u8> {
    let mut bytes = vec![0; length];
    ChaCha8Rng::seed_from_u64(seed).fill_bytes(&mut bytes);
    bytes
}

/// Words at the begin of a program in the active slot: its stack's end, and where to begin.
pub const VECTORS: [u32; 2] = [0x2000_6000, 0x0800_0000 + BOARD.active.start + 0x299];

/// Any bytes behind vectors.
pub fn firmware(version: ImageVersion) -> Vec<u8> {
    let mut bytes = payload(version.minor.into(), 1500 + usize::from(version.patch) * 7);
    bytes[..8].copy_from_slice(VECTORS.map(u32::to_le_bytes).as_flattened());
    bytes
}

pub fn model(seed: u64) -> Vec<u8> {
    let dims = Dims { conv_channels: [1; 3], embed: 1, xl_kernel: 1, xl_channels: 1, heads: 1, window: 1 };
    slipsense_recording::model_file::random_model(dims, seed).to_bytes().unwrap()
}

pub fn header(target: UpdateTarget, version: ImageVersion, payload: &[u8]) -> Header {
    let sha256 = Sha256::digest(payload).into();
    Header { target, board: BOARD.id, version, length: payload.len() as u32, sha256 }
}

pub fn sign(header: &Header, payload: &[u8]) -> Vec<u8> {
    let signature = SigningKey::from_bytes(&DEVELOPMENT_SEED).sign(&header.signed_bytes());
    [&header.encode(&signature.to_bytes())[..], payload].concat()
}

pub fn image(version: ImageVersion) -> Vec<u8> {
    let payload = firmware(version);
    sign(&header(UpdateTarget::Firmware, version, &payload), &payload)
}

pub fn model_image(version: ImageVersion, seed: u64) -> Vec<u8> {
    let payload = model(seed);
    sign(&header(UpdateTarget::Model, version, &payload), &payload)
}

pub struct Device {
    pub cells: Rc<RefCell<Cells<SECTOR>>>,
    /// As the settings' store has it.
    pub floor: ImageVersion,
}

impl Device {
    /// With [`OLD`] in its active slot, nothing else.
    pub fn new() -> Self {
        let mut cells = Cells::new(BOARD.flash.end as usize / SECTOR, WORD);
        let active = &mut cells.bytes[BOARD.active.start as usize..BOARD.active.end as usize];
        let image = image(OLD);
        let (header, firmware) = image.split_at(HEADER_BYTES);
        active[..firmware.len()].copy_from_slice(firmware);
        let end = active.len();
        active[end - HEADER_BYTES..].copy_from_slice(header);
        Self { cells: Rc::new(RefCell::new(cells)), floor: ImageVersion::default() }
    }

    /// With [`NEW`] received, which the bootloader has not swapped in yet.
    pub fn updating() -> Self {
        let device = Self::new();
        assert_eq!(device.install(OLD, UpdateTarget::Firmware, &image(NEW)), Ok(()));
        device
    }

    /// With [`NEW`] on trial.
    pub fn on_trial() -> Self {
        let device = Self::updating();
        assert_eq!(device.boots(), NEW);
        device
    }

    /// A device with the same flash.
    pub fn twin(&self) -> Self {
        Self { cells: Rc::new(RefCell::new(self.cells.borrow().clone())), floor: self.floor }
    }

    pub fn part(&self, span: Span) -> AsyncPart {
        BlockingAsync::new(Part { cells: self.cells.clone(), span })
    }

    fn state(&self) -> UpdateState<AsyncPart> {
        UpdateState::new(self.part(BOARD.state))
    }

    pub fn run(&self) -> Run {
        block_on(self.state().run()).unwrap()
    }

    pub fn model_slot(&self) -> ModelSlot<AsyncPart> {
        ModelSlot::new(self.part(BOARD.model), &BOARD, &[DEVELOPMENT_KEY], self.floor)
    }

    /// Do something with a sink, as the firmware of this version would.
    pub fn sink<R>(&self, running: ImageVersion, act: impl FnOnce(&mut Sink<'_>) -> R) -> R {
        let mut place = Box::new(Aligned([0; PLACE]));
        let slot = FirmwareSlot { dfu: self.part(BOARD.dfu), state: self.state() };
        act(&mut UpdateSink::new(
            &BOARD,
            &[DEVELOPMENT_KEY],
            Some(header(UpdateTarget::Firmware, running, &firmware(running))),
            Ok(slot),
            self.model_slot(),
            &mut place.0,
        ))
    }

    pub fn install(&self, running: ImageVersion, target: UpdateTarget, file: &[u8]) -> Taken {
        self.sink(running, |sink| feed(sink, target, file))
    }

    fn slots(&self) -> Slots<Part, Part, Part> {
        let part = |span| Part { cells: self.cells.clone(), span };
        Slots { active: part(BOARD.active), dfu: part(BOARD.dfu), state: part(BOARD.state) }
    }

    pub fn boot(&self) -> Result<Firmware, BootFailure> {
        let mut slots = self.slots();
        let firmware = slots.prepare(&BOARD, &[DEVELOPMENT_KEY], &mut [0; 64])?;
        slots.check_again(&firmware, &BOARD, &[DEVELOPMENT_KEY])?;
        Ok(firmware)
    }

    /// What the bootloader's second look says, if the first had found this.
    pub fn check_again(&self, found: &Firmware) -> Result<(), BootFailure> {
        self.slots().check_again(found, &BOARD, &[DEVELOPMENT_KEY])
    }

    /// Start, and see that every byte of the firmware is there.
    pub fn boots(&self) -> ImageVersion {
        let Ok(Firmware::Signed { version, .. }) = self.boot() else { panic!("{:?}", self.boot()) };
        let at = BOARD.active.start as usize;
        let firmware = firmware(version);
        assert_eq!(self.cells.borrow().bytes[at..at + firmware.len()], firmware, "{version}");
        version
    }

    pub fn confirm(&self) {
        assert!(self.try_confirm());
    }

    /// Did the flash take it?
    pub fn try_confirm(&self) -> bool {
        block_on(self.state().confirm()).is_ok()
    }

    /// The model that runs, if it is not the one in the firmware.
    pub fn model(&self) -> Result<(ImageVersion, Vec<u8>), Refusal> {
        let mut place = Box::new(Aligned([0; PLACE]));
        let header = block_on(self.model_slot().load(&mut place.0))?;
        Ok((header.version, place.0[..header.length as usize].to_vec()))
    }

    /// The power fails after this number of steps; it comes back with [`Self::power_on`].
    pub fn power_fails_after(&self, steps: u64) {
        self.cells.borrow_mut().power = steps;
    }

    /// Did it fail?
    pub fn power_on(&self) -> bool {
        std::mem::replace(&mut self.cells.borrow_mut().power, u64::MAX) == 0
    }

    /// Damage one bit of the flash.
    pub fn flip(&self, at: usize) {
        self.cells.borrow_mut().bytes[at] ^= 1;
    }

    /// Words at the begin of a partition, as a probe writes them: a stack's end, and where to begin.
    pub fn write_vectors(&self, span: Span, words: [u32; 2]) {
        let bytes = words.map(u32::to_le_bytes);
        self.cells.borrow_mut().bytes[span.start as usize..][..8].copy_from_slice(bytes.as_flattened());
    }

    pub fn steps(&self) -> u64 {
        self.cells.borrow().steps
    }
}

/// Whether a file was taken, or why not.
pub type Taken = Result<(), &'static str>;

pub fn feed(sink: &mut Sink<'_>, target: UpdateTarget, file: &[u8]) -> Taken {
    let room = block_on(sink.begin(target)).map_err(Refusal::reason)?;
    assert!(room > HEADER_BYTES as u32);
    for (index, piece) in file.chunks(CHUNK_BYTES).enumerate() {
        block_on(sink.write(target, (index * CHUNK_BYTES) as u32, piece))?;
    }
    block_on(sink.finish(target, file.len() as u32))
}
