//! Why the node restarted: a record in RAM that a reset does not clear.
//!
//! The board's panic handler writes it, the next start reads it and reports it on the bus. After power-on the RAM
//! holds anything; magic and checksum tell a record from that.

use core::fmt::{self, Write};

/// Words of a [`PanicRecord`] in RAM: magic, count, line, hash of the reason, file, checksum.
pub const PANIC_WORDS: usize = 5 + FILE_BYTES / 4;
/// The end of the source file's path that is kept.
pub const FILE_BYTES: usize = 48;

/// "SLPP": the layout above. Another layout gets another magic.
const MAGIC: u32 = u32::from_le_bytes(*b"SLPP");
// FNV-1a, 32 bits.
const HASH_START: u32 = 0x811c_9dc5;
const HASH_PRIME: u32 = 0x0100_0193;

/// What the last panic was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PanicRecord {
    /// Panics since power-on; stays at its largest value.
    pub count: u32,
    /// Line in the source file; 0 if unknown.
    pub line: u32,
    /// FNV-1a over the text of the reason: the same reason has the same hash.
    pub reason_hash: u32,
    file: [u8; FILE_BYTES],
}

impl PanicRecord {
    /// The record of a panic. `previous` is what the RAM held; `file` and `line` say where the panic was.
    pub fn new(previous: Option<Self>, reason: impl fmt::Display, file: &str, line: u32) -> Self {
        let count = previous.map_or(0, |previous| previous.count).saturating_add(1);
        let mut hash = Hash(HASH_START);
        // Hashing does not fail; a reason that cannot format itself is hashed as far as it gets.
        let _ = write!(hash, "{reason}");
        let mut kept = [0; FILE_BYTES];
        let bytes = file.as_bytes();
        let end = bytes.get(bytes.len().saturating_sub(FILE_BYTES)..).unwrap_or(bytes);
        kept.iter_mut().zip(end).for_each(|(to, &from)| *to = from);
        Self { count, line, reason_hash: hash.0, file: kept }
    }

    /// The last [`FILE_BYTES`] bytes of the source file's path; empty where they are no text.
    pub fn file(&self) -> &str {
        let length = self.file.iter().position(|&byte| byte == 0).unwrap_or(FILE_BYTES);
        self.file.get(..length).and_then(|bytes| str::from_utf8(bytes).ok()).unwrap_or_default()
    }

    /// As it lies in RAM.
    pub fn to_words(&self) -> [u32; PANIC_WORDS] {
        let mut words = [0; PANIC_WORDS];
        let file = self.file.as_chunks::<4>().0.iter().map(|&bytes| u32::from_le_bytes(bytes));
        let fields = [MAGIC, self.count, self.line, self.reason_hash].into_iter().chain(file);
        words.iter_mut().zip(fields).for_each(|(word, field)| *word = field);
        words[PANIC_WORDS - 1] = checksum(&words);
        words
    }

    /// Read what the RAM holds; `None` if that is no record.
    pub fn from_words(words: &[u32; PANIC_WORDS]) -> Option<Self> {
        let [magic, count, line, reason_hash, ref file @ .., sum] = *words;
        if magic != MAGIC || sum != checksum(words) {
            return None;
        }
        let mut kept = [0; FILE_BYTES];
        for (to, word) in kept.as_chunks_mut::<4>().0.iter_mut().zip(file) {
            *to = word.to_le_bytes();
        }
        Some(Self { count, line, reason_hash, file: kept })
    }
}

impl fmt::Display for PanicRecord {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { count, line, reason_hash, .. } = self;
        write!(f, "panic {count} since power-on, at {}:{line}, reason {reason_hash:08x}", self.file())
    }
}

/// Over all words but the last.
fn checksum(words: &[u32; PANIC_WORDS]) -> u32 {
    let mut hash = Hash(HASH_START);
    words.iter().take(PANIC_WORDS - 1).for_each(|word| hash.add(&word.to_le_bytes()));
    hash.0
}

struct Hash(u32);

impl Hash {
    fn add(&mut self, bytes: &[u8]) {
        self.0 = bytes.iter().fold(self.0, |hash, &byte| (hash ^ u32::from(byte)).wrapping_mul(HASH_PRIME));
    }
}

impl Write for Hash {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        self.add(text.as_bytes());
        Ok(())
    }
}
