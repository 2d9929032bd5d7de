//! A payload on its way into flash, and read back from there.

use embedded_storage_async::nor_flash::{NorFlash, ReadNorFlash};
use sha2::{Digest, Sha256};

use super::Refusal;
use super::image::{HEADER_BYTES, Header};
use super::key::Keys;
use super::partitions::{Partitions, TRAILER_BYTES};

/// Bytes that flash is written in: a word of the STM32H7.
pub(super) const WORD: usize = 32;

/// Erase one sector after the other, so that other tasks run in between.
pub(super) async fn erase<F: NorFlash>(flash: &mut F, bytes: u32) -> Result<(), Refusal> {
    let sector = F::ERASE_SIZE as u32;
    let mut from = 0;
    while from < bytes {
        let to = from.saturating_add(sector);
        flash.erase(from, to).await.map_err(|_| Refusal::Flash)?;
        from = to;
    }
    Ok(())
}

/// Collects bytes to whole words.
pub(super) struct Writer {
    word: [u8; WORD],
    filled: usize,
    /// Where the next word goes.
    at: u32,
}

impl Writer {
    /// Begins at `at`, a multiple of [`WORD`].
    pub const fn new(at: u32) -> Self {
        Self { word: [0xFF; WORD], filled: 0, at }
    }

    pub async fn put<F: NorFlash>(&mut self, flash: &mut F, bytes: &[u8]) -> Result<(), Refusal> {
        const { assert!(WORD.is_multiple_of(F::WRITE_SIZE)) };
        let mut rest = bytes;
        while !rest.is_empty() {
            if self.filled == 0
                && let Some((whole, behind)) = rest.split_at_checked(rest.len() / WORD * WORD)
                && !whole.is_empty()
            {
                self.write(flash, whole).await?;
                rest = behind;
                continue;
            }
            for (to, from) in self.word.iter_mut().skip(self.filled).zip(rest) {
                *to = *from;
            }
            let taken = rest.len().min(WORD - self.filled);
            self.filled += taken;
            rest = rest.get(taken..).unwrap_or(&[]);
            if self.filled == WORD {
                self.flush(flash).await?;
            }
        }
        Ok(())
    }

    /// The last word, filled up with what erased flash holds.
    pub async fn flush<F: NorFlash>(&mut self, flash: &mut F) -> Result<(), Refusal> {
        if self.filled == 0 {
            return Ok(());
        }
        let word = core::mem::replace(&mut self.word, [0xFF; WORD]);
        self.filled = 0;
        self.write(flash, &word).await
    }

    async fn write<F: NorFlash>(&mut self, flash: &mut F, words: &[u8]) -> Result<(), Refusal> {
        flash.write(self.at, words).await.map_err(|_| Refusal::Flash)?;
        self.at = self.at.saturating_add(words.len() as u32);
        Ok(())
    }
}

/// The first two words of a program: its stack and where it begins.
pub(super) const fn vectors(bytes: [u8; 8]) -> (u32, u32) {
    let [s0, s1, s2, s3, r0, r1, r2, r3] = bytes;
    (u32::from_le_bytes([s0, s1, s2, s3]), u32::from_le_bytes([r0, r1, r2, r3]))
}

/// Where the header of a firmware lies, in its slot.
pub(super) const fn firmware_header_at(board: &Partitions) -> u32 {
    board.active.bytes().saturating_sub(HEADER_BYTES as u32)
}

/// Bytes of the longest firmware.
pub(super) const fn firmware_room(board: &Partitions) -> u32 {
    board.active.bytes().saturating_sub(TRAILER_BYTES)
}

/// The bytes that lie where a header would; [`Refusal::Blank`] if nothing does.
pub(super) async fn header_bytes<F: ReadNorFlash>(
    flash: &mut F,
    at: u32,
) -> Result<[u8; HEADER_BYTES], Refusal> {
    let mut bytes = [0; HEADER_BYTES];
    flash.read(at, &mut bytes).await.map_err(|_| Refusal::Flash)?;
    if bytes.iter().all(|&byte| byte == 0xFF) { Err(Refusal::Blank) } else { Ok(bytes) }
}

/// The SHA-256 of a payload, piece by piece. Once in a firmware.
pub struct PayloadHash(Sha256);

impl PayloadHash {
    /// Of nothing yet.
    pub fn new() -> Self {
        Self(Sha256::new())
    }

    /// The next piece.
    #[inline(never)]
    pub fn update(&mut self, bytes: &[u8]) {
        self.0.update(bytes);
    }

    /// The hash; the next piece begins another.
    #[inline(never)]
    pub fn finish(&mut self) -> [u8; 32] {
        self.0.finalize_reset().into()
    }

    /// The hash, if it is the one that the header says.
    pub(super) fn check(mut self, header: &Header) -> Result<[u8; 32], Refusal> {
        let hash = self.finish();
        if hash == header.sha256 { Ok(hash) } else { Err(Refusal::WrongHash) }
    }
}

/// The hash of what lies from `at` on in flash, if it is what `header` stands before.
pub(super) async fn check_hash<F: ReadNorFlash>(
    flash: &mut F,
    at: u32,
    header: &Header,
) -> Result<[u8; 32], Refusal> {
    let mut hash = PayloadHash::new();
    let mut part = [0; 8 * WORD];
    let mut done = 0;
    while done < header.length {
        let length = (header.length - done).min(part.len() as u32);
        let part = part.get_mut(..length as usize).ok_or(Refusal::TooLong)?;
        flash.read(at.saturating_add(done), part).await.map_err(|_| Refusal::Flash)?;
        hash.update(part);
        done += length;
    }
    hash.check(header)
}

/// Header and hash of the firmware that lies from `at` on, if it is whole and for this board. How old it is does not matter here: a firmware that is
/// rolled back to is older.
pub(super) async fn check_firmware<F: ReadNorFlash>(
    flash: &mut F,
    at: u32,
    board: &Partitions,
    keys: &Keys,
) -> Result<(Header, [u8; 32]), Refusal> {
    let header_at = at.saturating_add(firmware_header_at(board));
    let header = Header::verify(&header_bytes(flash, header_at).await?, keys)?;
    let any_version = header.version;
    header.admit(crate::node::UpdateTarget::Firmware, board, any_version, firmware_room(board))?;
    let hash = check_hash(flash, at, &header).await?;
    Ok((header, hash))
}
