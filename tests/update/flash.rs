//! A NOR flash in memory, whole or in partitions, that loses its power after a given number of steps: a word that is
//! written, or each byte of it, and a sixteenth of a sector that is erased are a step each. The step that the power
//! fails in leaves its word or sixteenth as [`Tear`] says.
//!
//! It checks what real flash asks for: whole words, written once after an erase; a word whose write was cut short may
//! be written again with the same bytes, which leaves the same bits and check bits behind.

use std::cell::RefCell;
use std::ops::Range;
use std::rc::Rc;

use embedded_storage::nor_flash as blocking;
use embedded_storage_async::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};
use rand::RngCore;
use rand_chacha::ChaCha8Rng;
use slipsense::update::partitions::Span;

/// As the STM32H7 writes.
pub const WORD: usize = 32;
/// Small, so that all steps can be tried.
pub const SECTOR: usize = 1024;
/// Of a sector, each erased in one step.
const PARTS: usize = 16;

/// What the power cut leaves of the word or the sixteenth of a sector.
#[derive(Clone, Debug)]
pub enum Tear {
    /// What was there.
    Nothing,
    /// The first half done.
    Half,
    /// Every bit old or new by chance.
    Chance(Box<ChaCha8Rng>),
    /// Two bits wrong: error correction gives up, and the board reads zeros.
    Zeros,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Failure {
    NoPower,
    /// The error of a worn flash.
    Worn,
}

impl NorFlashError for Failure {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

/// A whole flash; of sectors of so many bytes.
#[derive(Clone)]
pub struct Cells<const SECTOR: usize> {
    pub bytes: Vec<u8>,
    /// What each word was meant to hold, since the last erase; `true`: the write ended.
    pub words: Vec<Option<([u8; WORD], bool)>>,
    /// Bytes that a step writes: 1 or [`WORD`].
    pub grain: usize,
    /// Steps until the power fails.
    pub power: u64,
    pub steps: u64,
    pub erases: u32,
    pub bytes_read: u64,
    pub tear: Tear,
    /// Does an erase begin at the sector's end?
    pub backwards: bool,
    /// Writes to this address change nothing.
    pub stuck: Option<usize>,
    /// The next write to this address leaves a bit wrong, and says nothing.
    pub weak: Option<usize>,
}

impl<const SECTOR: usize> Cells<SECTOR> {
    /// Written `grain` bytes a step.
    pub fn new(sectors: usize, grain: usize) -> Self {
        Self {
            bytes: vec![0xFF; SECTOR * sectors],
            words: vec![None; SECTOR * sectors / WORD],
            grain,
            power: u64::MAX,
            steps: 0,
            erases: 0,
            bytes_read: 0,
            tear: Tear::Nothing,
            backwards: false,
            stuck: None,
            weak: None,
        }
    }

    pub fn range(&self) -> Range<u32> {
        0..self.bytes.len() as u32
    }

    /// One step: `part` of what becomes `new` at `at`. Without power, all of it is torn.
    fn step(&mut self, at: usize, new: &[u8], part: Range<usize>) -> Result<(), Failure> {
        let cells = &mut self.bytes[at..at + new.len()];
        if let Some(left) = self.power.checked_sub(1) {
            self.power = left;
            self.steps += 1;
            cells[part.clone()].copy_from_slice(&new[part]);
            return Ok(());
        }
        if part.start == 0 && part.len() < new.len() {
            // Not begun yet.
            return Err(Failure::NoPower);
        }
        match &mut self.tear {
            Tear::Nothing => {}
            Tear::Half => cells[..new.len() / 2].copy_from_slice(&new[..new.len() / 2]),
            Tear::Chance(chance) => {
                for (cell, new) in cells.iter_mut().zip(new) {
                    *cell ^= (*cell ^ new) & chance.next_u32() as u8;
                }
            }
            Tear::Zeros => cells.fill(0),
        }
        Err(Failure::NoPower)
    }

    fn erase_bytes(&mut self, from: usize, to: usize) -> Result<(), Failure> {
        let size = SECTOR / PARTS;
        assert!(from.is_multiple_of(SECTOR) && to.is_multiple_of(SECTOR), "erase of parts of sectors");
        self.erases += 1;
        for sector in (from..to).step_by(SECTOR) {
            for part in 0..PARTS {
                let part = if self.backwards { PARTS - 1 - part } else { part };
                let at = sector + part * size;
                self.step(at, &vec![0xFF; size], 0..size)?;
                self.words[at / WORD..(at + size) / WORD].fill(None);
            }
        }
        Ok(())
    }

    fn write_bytes(&mut self, offset: usize, bytes: &[u8]) -> Result<(), Failure> {
        let whole = offset.is_multiple_of(WORD) && bytes.len().is_multiple_of(WORD);
        assert!(whole, "write of parts of words");
        for (index, word) in bytes.chunks(WORD).enumerate() {
            let at = offset + index * WORD;
            let word: [u8; WORD] = word.try_into().expect("a whole word");
            match self.words[at / WORD] {
                Some((_, true)) => panic!("word at {at:#x} written twice"),
                Some((meant, false)) => assert_eq!(meant, word, "torn word at {at:#x} overwritten"),
                None => {}
            }
            if self.stuck == Some(at) {
                return Err(Failure::Worn);
            }
            for from in (0..WORD).step_by(self.grain) {
                if from > 0 || self.grain == WORD {
                    self.words[at / WORD] = Some((word, false));
                }
                self.step(at, &word, from..from + self.grain)?;
            }
            self.words[at / WORD] = Some((word, true));
            if self.weak.take_if(|weak| *weak == at).is_some() {
                self.bytes[at] ^= 1;
            }
        }
        Ok(())
    }
}

impl<const SECTOR: usize> ErrorType for Cells<SECTOR> {
    type Error = Failure;
}

impl<const SECTOR: usize> ReadNorFlash for Cells<SECTOR> {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, out: &mut [u8]) -> Result<(), Failure> {
        out.copy_from_slice(&self.bytes[offset as usize..offset as usize + out.len()]);
        self.bytes_read += out.len() as u64;
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.bytes.len()
    }
}

impl<const SECTOR: usize> NorFlash for Cells<SECTOR> {
    const WRITE_SIZE: usize = WORD;
    const ERASE_SIZE: usize = SECTOR;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), Failure> {
        self.erase_bytes(from as usize, to as usize)
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Failure> {
        self.write_bytes(offset as usize, bytes)
    }
}

/// A partition of a flash. Addresses count from its begin.
#[derive(Clone)]
pub struct Part {
    pub cells: Rc<RefCell<Cells<SECTOR>>>,
    pub span: Span,
}

impl Part {
    fn at(&self, from: u32, length: usize) -> usize {
        assert!(from as usize + length <= self.span.bytes() as usize, "outside of the partition");
        (self.span.start + from) as usize
    }
}

impl ErrorType for Part {
    type Error = Failure;
}

impl blocking::ReadNorFlash for Part {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, out: &mut [u8]) -> Result<(), Failure> {
        let at = self.at(offset, out.len());
        out.copy_from_slice(&self.cells.borrow().bytes[at..at + out.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.span.bytes() as usize
    }
}

impl blocking::NorFlash for Part {
    const WRITE_SIZE: usize = WORD;
    const ERASE_SIZE: usize = SECTOR;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Failure> {
        let at = self.at(from, (to - from) as usize);
        self.cells.borrow_mut().erase_bytes(at, at + (to - from) as usize)
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Failure> {
        let at = self.at(offset, bytes.len());
        self.cells.borrow_mut().write_bytes(at, bytes)
    }
}
