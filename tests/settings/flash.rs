//! A NOR flash in memory that loses its power after a given number of steps: every byte that is written and
//! every sixteenth of a sector that is erased is a step. It checks what real flash asks for: whole words,
//! written once after an erase. A word whose write was cut short may be written again with the same bytes,
//! which leaves the same bits and the same check bits behind as the first write would have. A word or a
//! sixteenth of a sector that the power fails in is left as its first bytes say, or, as `torn`, with every
//! bit old or new by chance.

use embedded_storage_async::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};
use rand::RngCore;

/// As the STM32H7 writes.
pub const WORD: usize = 32;

#[derive(Clone)]
pub struct Flash<const SECTOR: usize> {
    pub bytes: Vec<u8>,
    /// What each word was meant to hold, since the last erase; `true`: the write ended.
    words: Vec<Option<([u8; WORD], bool)>>,
    /// Steps until the power fails.
    pub power: u64,
    pub steps: u64,
    pub erases: u32,
    /// Chance for bits that the power fails on.
    pub torn: Option<rand_chacha::ChaCha8Rng>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Failure {
    NoPower,
    Misuse(&'static str),
}

impl NorFlashError for Failure {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

impl<const SECTOR: usize> Flash<SECTOR> {
    pub fn new(sectors: usize) -> Self {
        let bytes = vec![0xFF; SECTOR * sectors];
        let words = vec![None; bytes.len() / WORD];
        Self { bytes, words, power: u64::MAX, steps: 0, erases: 0, torn: None }
    }

    pub fn range(&self) -> std::ops::Range<u32> {
        0..self.bytes.len() as u32
    }

    fn step(&mut self) -> Result<(), Failure> {
        self.power = self.power.checked_sub(1).ok_or(Failure::NoPower)?;
        self.steps += 1;
        Ok(())
    }
}

impl<const SECTOR: usize> Flash<SECTOR> {
    /// Flip, by chance, the bits that may flip.
    fn tear(&mut self, range: std::ops::Range<usize>, may: impl Fn(usize, u8) -> u8) {
        let Some(chance) = &mut self.torn else { return };
        for (index, byte) in self.bytes[range].iter_mut().enumerate() {
            *byte ^= may(index, *byte) & chance.next_u32() as u8;
        }
    }
}

impl<const SECTOR: usize> ErrorType for Flash<SECTOR> {
    type Error = Failure;
}

impl<const SECTOR: usize> ReadNorFlash for Flash<SECTOR> {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, out: &mut [u8]) -> Result<(), Failure> {
        let range = offset as usize..offset as usize + out.len();
        let bytes = self.bytes.get(range).ok_or(Failure::Misuse("read outside"))?;
        out.copy_from_slice(bytes);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.bytes.len()
    }
}

impl<const SECTOR: usize> NorFlash for Flash<SECTOR> {
    const WRITE_SIZE: usize = WORD;
    const ERASE_SIZE: usize = SECTOR;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), Failure> {
        let (from, to) = (from as usize, to as usize);
        if from % SECTOR != 0 || to % SECTOR != 0 || to > self.bytes.len() {
            return Err(Failure::Misuse("erase of parts of sectors"));
        }
        self.erases += 1;
        for start in (from..to).step_by(SECTOR / 16) {
            if let Err(failure) = self.step() {
                self.tear(start..start + SECTOR / 16, |_, old| !old);
                return Err(failure);
            }
            self.bytes[start..start + SECTOR / 16].fill(0xFF);
            self.words[start / WORD..(start + SECTOR / 16) / WORD].fill(None);
        }
        Ok(())
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Failure> {
        let offset = offset as usize;
        if !offset.is_multiple_of(WORD) || !bytes.len().is_multiple_of(WORD) {
            return Err(Failure::Misuse("write of parts of words"));
        }
        for (index, word) in bytes.chunks(WORD).enumerate() {
            let at = offset + index * WORD;
            let word: [u8; WORD] = word.try_into().expect("a whole word");
            match self.words[at / WORD] {
                Some((_, true)) => return Err(Failure::Misuse("word written twice")),
                Some((meant, false)) if meant != word => {
                    return Err(Failure::Misuse("torn word overwritten"));
                }
                _ => {}
            }
            for (byte, &new) in word.iter().enumerate() {
                if let Err(failure) = self.step() {
                    if byte > 0 {
                        self.tear(at..at + WORD, |index, old| old & !word[index]);
                    }
                    return Err(failure);
                }
                self.words[at / WORD] = Some((word, byte == WORD - 1));
                self.bytes[at + byte] = new;
            }
        }
        Ok(())
    }
}
