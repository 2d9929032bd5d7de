//! What the bootloader decides: which firmware runs. Registers and the jump are in `src/firmware/bin/boot`.

use core::fmt;

use embassy_boot::{BootLoader, BootLoaderConfig};
use embassy_embedded_hal::adapter::BlockingAsync;
use embassy_futures::block_on;
use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash};

use super::Refusal;
use super::image::{Header, ImageVersion};
use super::key::Keys;
use super::partitions::{FLASH_BASE, Partitions};
use super::slot::{WORD, check_firmware, firmware_header_at, header_bytes, vectors};
use super::state::{Run, UpdateState};

/// The firmware to jump to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the fields are named after what they are")]
pub enum Firmware {
    /// It came by an update; the hash is that of what lies in the slot.
    Signed { version: ImageVersion, hash: [u8; 32] },
    /// Nothing vouches for it: a debug probe wrote it.
    Flashed,
}

/// Why no firmware is jumped to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BootFailure {
    /// The flash refused.
    Flash,
    /// There is none that is whole.
    NoFirmware(Refusal),
}

impl fmt::Display for BootFailure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Flash => f.write_str("the flash refused"),
            Self::NoFirmware(why) => write!(f, "no firmware: {why}"),
        }
    }
}

impl core::error::Error for BootFailure {}

/// The three partitions, each from its address 0 on.
pub struct Slots<A, D, S> {
    /// The firmware that runs.
    pub active: A,
    /// The one that is to run, or ran before.
    pub dfu: D,
    /// embassy-boot's state.
    pub state: S,
}

impl<A: NorFlash, D: NorFlash, S: NorFlash> Slots<A, D, S> {
    /// Swap a new firmware in, swap one that did not confirm out, and see that what then lies in the active slot is
    /// whole. `buffer` divides a sector and is aligned as the flash wants it. A new one is checked before it is swapped
    /// in, and where it will run; if it is not whole there, the one before comes back at once. If the one that is to run
    /// is damaged and the other slot holds a whole signed one, that one is copied in.
    pub fn prepare(
        &mut self,
        board: &Partitions,
        keys: &Keys,
        buffer: &mut [u8],
    ) -> Result<Firmware, BootFailure> {
        let mut state = UpdateState::new(BlockingAsync::new(&mut self.state));
        let run = block_on(state.run()).map_err(|_| BootFailure::Flash)?;
        let withdraw = match run {
            Run::Pending => {
                block_on(check_firmware(&mut BlockingAsync::new(&mut self.dfu), 0, board, keys)).is_err()
            }
            // Confirming was cut off half way: embassy-boot would call that a rollback.
            Run::Confirmed => true,
            Run::OnTrial | Run::RolledBack => false,
        };
        if withdraw {
            block_on(state.confirm()).map_err(|_| BootFailure::Flash)?;
        }
        self.swap(buffer)?;
        let found = self.firmware(board, keys);
        let swapped_in = run == Run::Pending && !withdraw;
        if found.is_err() && swapped_in {
            // It looks to embassy-boot as a firmware that did not confirm.
            self.swap(buffer)?;
            return self.firmware(board, keys).map_err(BootFailure::NoFirmware);
        }
        let why = match found {
            Ok(firmware) => return Ok(firmware),
            Err(why) => why,
        };
        self.recover(board, keys, buffer)?;
        self.firmware(board, keys).map_err(|_| BootFailure::NoFirmware(why))
    }

    /// Check once more the signature of the firmware that [`prepare`](Self::prepare) found, and its hash against the signed
    /// one. A skipped instruction, in this check or in the one before, then does not start a firmware that must not run.
    pub fn check_again(
        &mut self,
        firmware: &Firmware,
        board: &Partitions,
        keys: &Keys,
    ) -> Result<(), BootFailure> {
        let at = firmware_header_at(board);
        let header = block_on(header_bytes(&mut BlockingAsync::new(&mut self.active), at));
        let checked = match (firmware, header) {
            (Firmware::Signed { hash, .. }, Ok(bytes)) => Header::verify(&bytes, keys)
                .and_then(|header| if header.sha256 == *hash { Ok(()) } else { Err(Refusal::WrongHash) }),
            (Firmware::Flashed, Err(Refusal::Blank)) => self.has_vectors(board),
            (Firmware::Flashed, Ok(_)) => Err(Refusal::WrongSignature),
            (_, Err(why)) => Err(why),
        };
        checked.map_err(BootFailure::NoFirmware)
    }

    /// What lies in the active slot is damaged: copy a whole signed firmware of the other slot there, if it has one.
    /// The copy can be cut off: the next start finds the same again.
    fn recover(&mut self, board: &Partitions, keys: &Keys, buffer: &mut [u8]) -> Result<(), BootFailure> {
        // A swap leaves the one before behind the first sector; one that came by an update begins in it.
        let at = [D::ERASE_SIZE as u32, 0].into_iter().find(|&at| {
            block_on(check_firmware(&mut BlockingAsync::new(&mut self.dfu), at, board, keys)).is_ok()
        });
        let Some(at) = at else { return Ok(()) };
        let bytes = board.active.bytes();
        self.active.erase(0, bytes).map_err(|_| BootFailure::Flash)?;
        // From the end down, so that the header comes first: vectors without one would pass as written by a probe.
        for at_piece in (0..bytes).step_by(buffer.len().max(1)).rev() {
            self.dfu.read(at + at_piece, buffer).map_err(|_| BootFailure::Flash)?;
            // Erased flash stays erased, so that it can be written later.
            if buffer.iter().any(|&byte| byte != 0xFF) {
                self.active.write(at_piece, buffer).map_err(|_| BootFailure::Flash)?;
            }
        }
        Ok(())
    }

    fn swap(&mut self, buffer: &mut [u8]) -> Result<(), BootFailure> {
        let Self { active, dfu, state } = self;
        let config = BootLoaderConfig { active, dfu, state: Unchanged(state) };
        BootLoader::new(config).prepare_boot(buffer).map_err(|_| BootFailure::Flash)?;
        Ok(())
    }

    /// What lies in the active slot.
    fn firmware(&mut self, board: &Partitions, keys: &Keys) -> Result<Firmware, Refusal> {
        match block_on(check_firmware(&mut BlockingAsync::new(&mut self.active), 0, board, keys)) {
            Ok((header, hash)) => Ok(Firmware::Signed { version: header.version, hash }),
            Err(Refusal::Blank) => self.has_vectors(board).map(|()| Firmware::Flashed),
            Err(why) => Err(why),
        }
    }

    /// Could the first two words be a program's, its stack and where it begins?
    fn has_vectors(&mut self, board: &Partitions) -> Result<(), Refusal> {
        let mut bytes = [0; 8];
        self.active.read(0, &mut bytes).map_err(|_| Refusal::Flash)?;
        let (stack, reset) = vectors(bytes);
        let slot = FLASH_BASE + board.active.start..FLASH_BASE + board.active.end;
        // DTCM or AXI SRAM, as deep as they are on the larger part.
        let in_ram = matches!(stack, 0x2000_0001..=0x2002_0000 | 0x2400_0001..=0x2408_0000);
        if in_ram && reset & 1 == 1 && slot.contains(&reset) { Ok(()) } else { Err(Refusal::Blank) }
    }
}

/// A flash that does not write a word again that holds the same already: embassy-boot would, after a power cut, and
/// words of an STM32H7 have check bits that are made for one write.
struct Unchanged<F>(F);

impl<F: ErrorType> ErrorType for Unchanged<F> {
    type Error = F::Error;
}

impl<F: ReadNorFlash> ReadNorFlash for Unchanged<F> {
    const READ_SIZE: usize = F::READ_SIZE;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), F::Error> {
        self.0.read(offset, bytes)
    }

    fn capacity(&self) -> usize {
        self.0.capacity()
    }
}

impl<F: NorFlash> NorFlash for Unchanged<F> {
    const WRITE_SIZE: usize = F::WRITE_SIZE;
    const ERASE_SIZE: usize = F::ERASE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), F::Error> {
        self.0.erase(from, to)
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), F::Error> {
        let mut held = [0; WORD];
        if let Some(held) = held.get_mut(..bytes.len()) {
            self.0.read(offset, held)?;
            if held == bytes {
                return Ok(());
            }
        }
        self.0.write(offset, bytes)
    }
}
