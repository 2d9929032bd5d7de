//! Why the node restarted: a record in RAM that a reset does not clear.
//!
//! The board's handlers of panics and faults write it, and the start after the watchdog does; the next start reads it
//! and reports it on the bus. After power-on the RAM holds anything; magic and checksum tell a record from that.

use core::fmt::{self, Write};

use crate::health::RESTART_NUMBERS;
pub use crate::health::ResetCause;

/// Words of a [`CrashRecord`] in RAM: magic, count, line, hash of the reason, kind, four of a fault, file, checksum.
pub const CRASH_WORDS: usize = 10 + FILE_BYTES / 4;
/// The end of the source file's path that is kept.
pub const FILE_BYTES: usize = 48;

/// The tasks, in the order of their bits.
pub const TASK_NAMES: [&str; 4] = ["acquire", "infer", "transmit", "services"];
/// "SLPC": the layout above. Another layout gets another magic.
const MAGIC: u32 = u32::from_le_bytes(*b"SLPC");
// FNV-1a, 32 bits.
const HASH_START: u32 = 0x811c_9dc5;
const HASH_PRIME: u32 = 0x0100_0193;

/// The processor when it faulted (ARMv7-M, exception entry and system control block).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Fault {
    /// Address of the instruction.
    pub pc: u32,
    /// Return address of the function it is in.
    pub lr: u32,
    /// Configurable fault status register.
    pub cfsr: u32,
    /// BFAR or MMFAR where CFSR says that it is valid, else 0.
    pub address: u32,
}

/// What was seen at most 35 ms before the watchdog's reset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stall {
    /// Bit n is set if task n, in the order of [`TASK_NAMES`], stood still. None: nobody could look any more.
    pub tasks: u8,
    /// Address of the instruction that was next, below the interrupt that looked.
    pub pc: u32,
    /// Return address of the function it is in, or what an exception returns to.
    pub lr: u32,
}

/// What ended the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the names say it")]
pub enum CrashKind {
    Panic,
    Fault(Fault),
    Stall(Stall),
    /// There was no external clock, or a wrong one, of this frequency, Hz.
    NoClock(u32),
}

impl CrashKind {
    /// Which, and what is known of it, in the places of a fault's.
    fn numbers(self) -> [u32; 5] {
        match self {
            Self::Panic => [0; 5],
            Self::Fault(Fault { pc, lr, cfsr, address }) => [1, pc, lr, cfsr, address],
            Self::Stall(Stall { tasks, pc, lr }) => [2, pc, lr, tasks.into(), 0],
            Self::NoClock(found_hz) => [3, found_hz, 0, 0, 0],
        }
    }
}

/// What the last crash was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CrashRecord {
    /// Crashes since power-on; stays at its largest value.
    pub count: u32,
    /// What it was.
    pub kind: CrashKind,
    /// Line in the source file; 0 if unknown.
    pub line: u32,
    /// FNV-1a over the text of a panic's reason, PC and CFSR of a fault, the bits of a stall: the same reason has the
    /// same hash.
    pub reason_hash: u32,
    file: [u8; FILE_BYTES],
}

impl CrashRecord {
    /// The record of a panic. `previous` is what the RAM held; `file` and `line` say where the panic was.
    pub fn new(previous: Option<Self>, reason: impl fmt::Display, file: &str, line: u32) -> Self {
        let mut kept = [0; FILE_BYTES];
        let bytes = file.as_bytes();
        let end = bytes.get(bytes.len().saturating_sub(FILE_BYTES)..).unwrap_or(bytes);
        kept.iter_mut().zip(end).for_each(|(to, &from)| *to = from);
        let mut hash = Hash(HASH_START);
        // Hashing does not fail; a reason that cannot format itself is hashed as far as it gets.
        let _ = write!(hash, "{reason}");
        Self { line, file: kept, reason_hash: hash.0, ..Self::of(previous, CrashKind::Panic) }
    }

    /// The record of what is no panic. `previous` is what the RAM held.
    pub fn of(previous: Option<Self>, kind: CrashKind) -> Self {
        let mut hash = Hash(HASH_START);
        match kind {
            CrashKind::Panic => {}
            CrashKind::Fault(Fault { pc, cfsr, .. }) => {
                hash.add(&pc.to_le_bytes());
                hash.add(&cfsr.to_le_bytes());
            }
            CrashKind::Stall(Stall { tasks, .. }) => hash.add(&[tasks]),
            CrashKind::NoClock(found_hz) => hash.add(&found_hz.to_le_bytes()),
        }
        let count = previous.map_or(0, |previous| previous.count).saturating_add(1);
        Self { count, kind, line: 0, reason_hash: hash.0, file: [0; FILE_BYTES] }
    }

    /// The last [`FILE_BYTES`] bytes of the source file's path; empty where they are no text.
    pub fn file(&self) -> &str {
        let length = self.file.iter().position(|&byte| byte == 0).unwrap_or(FILE_BYTES);
        self.file.get(..length).and_then(|bytes| str::from_utf8(bytes).ok()).unwrap_or_default()
    }

    /// As it lies in RAM.
    pub fn to_words(&self) -> [u32; CRASH_WORDS] {
        let mut words = [0; CRASH_WORDS];
        let [kind, pc, lr, cfsr, address] = self.kind.numbers();
        let file = self.file.as_chunks::<4>().0.iter().map(|&bytes| u32::from_le_bytes(bytes));
        let fields = [MAGIC, self.count, self.line, self.reason_hash, kind, pc, lr, cfsr, address];
        words.iter_mut().zip(fields.into_iter().chain(file)).for_each(|(word, field)| *word = field);
        words[CRASH_WORDS - 1] = checksum(&words);
        words
    }

    /// Read what the RAM holds; `None` if that is no record.
    pub fn from_words(words: &[u32; CRASH_WORDS]) -> Option<Self> {
        let [magic, count, line, reason_hash, kind, pc, lr, cfsr, address, ref file @ .., sum] = *words;
        if magic != MAGIC || sum != checksum(words) {
            return None;
        }
        let kind = match kind {
            0 => CrashKind::Panic,
            1 => CrashKind::Fault(Fault { pc, lr, cfsr, address }),
            2 => CrashKind::Stall(Stall { tasks: cfsr as u8, pc, lr }),
            3 => CrashKind::NoClock(pc),
            _ => return None,
        };
        let mut kept = [0; FILE_BYTES];
        for (to, word) in kept.as_chunks_mut::<4>().0.iter_mut().zip(file) {
            *to = word.to_le_bytes();
        }
        Some(Self { count, kind, line, reason_hash, file: kept })
    }
}

impl fmt::Display for CrashRecord {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { count, line, reason_hash, .. } = self;
        match self.kind {
            CrashKind::Panic => {
                write!(f, "panic {count} since power-on, at {}:{line}, reason {reason_hash:08x}", self.file())
            }
            CrashKind::Fault(Fault { pc, lr, cfsr, address }) => {
                write!(f, "fault {count} since power-on, pc {pc:08x}, lr {lr:08x}, ")?;
                write!(f, "cfsr {cfsr:08x}, at {address:08x}")
            }
            CrashKind::Stall(Stall { tasks, pc, lr }) => {
                write!(f, "watchdog {count} since power-on, pc {pc:08x}, lr {lr:08x}, stalled:")?;
                for (bit, name) in TASK_NAMES.into_iter().enumerate() {
                    if tasks >> bit & 1 != 0 {
                        write!(f, " {name}")?;
                    }
                }
                if tasks == 0 { f.write_str(" all that look") } else { Ok(()) }
            }
            CrashKind::NoClock(found_hz) => {
                write!(f, "start {count} since power-on without its clock, {found_hz} Hz found")
            }
        }
    }
}

/// How the program came to start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Start {
    /// What reset the chip.
    pub cause: ResetCause,
    /// The crash before, if that is why.
    pub crash: Option<CrashRecord>,
}

impl Start {
    /// For [`Status::restart`](crate::health::Status::restart).
    pub fn numbers(&self) -> [u32; RESTART_NUMBERS] {
        let cause = self.cause as u32;
        let Some(crash) = self.crash else { return [cause, 0, 0, 0, 0, 0] };
        let [kind, pc, lr, cfsr, address] = crash.kind.numbers();
        [cause, kind + 1, pc, lr, cfsr, address]
    }
}

/// Over all words but the last.
fn checksum(words: &[u32; CRASH_WORDS]) -> u32 {
    let mut hash = Hash(HASH_START);
    words.iter().take(CRASH_WORDS - 1).for_each(|word| hash.add(&word.to_le_bytes()));
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
