//! What is particular about the taxels of one array: what each reads untouched, how much it responds, how far it
//! scatters, and which of them do not work. Measured once for each array ([`Measurement`]), kept in flash, applied to
//! every reading before anything else sees it.
//!
//! Tables stand in the order of the scan: they belong to the array, however it is mounted.

mod measure;

use core::fmt;

use sha2::{Digest, Sha256};

use crate::params::{TAXEL_COLS, TAXEL_ROWS, TAXELS};
use crate::sensor::TaxelMask;
use crate::transfer::{self, IDLE_CODE};
pub use measure::{BLOCK_FRAMES, Measurement, Refusal, SECONDS_MAX};

/// Offsets, noise and gates are in 1/8 code.
pub const CODE_BITS: u32 = 3;
/// Gains are in 1/2048.
pub const GAIN_BITS: u32 = 11;
/// The gain of a nominal taxel.
pub const GAIN_ONE: u16 = 1 << GAIN_BITS;
/// Largest gain, a little below 2, so that a gain times a code in eighths has 32 bits.
pub const GAIN_MAX: u16 = 2 * GAIN_ONE - 1;
/// A taxel reads 0 below so many times its noise: an idle one comes above it in one of 31,000 frames.
pub const GATE_SIGMAS: u32 = 4;
/// And below so much, 1/8 code: 24 codes, 10 counts, some 1 kPa. It is what an offset may drift while a grasp keeps it
/// from being followed.
pub const GATE_MIN: u16 = 24 << CODE_BITS;

/// One taxel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Trim {
    /// What it reads untouched, 1/8 code.
    pub offset: u16,
    /// It reads 0 below so much above its offset, 1/8 code.
    pub gate: u16,
    /// Factor on its reading, 1/2048; 1 to [`GAIN_MAX`].
    pub gain: u16,
    /// Its noise, rms, 1/8 code; 0 where nobody measured it.
    pub noise: u16,
}

impl Trim {
    /// Of an array that was not measured: the circuit's nominal offset, gain 1, no gate.
    pub const NOMINAL: Self = Self { offset: IDLE_CODE << CODE_BITS, gate: 0, gain: GAIN_ONE, noise: 0 };

    /// The count of a code.
    #[inline]
    pub const fn count(self, code: u16) -> u16 {
        let above = ((code as i32) << CODE_BITS) - self.offset as i32;
        if above < self.gate as i32 {
            return 0;
        }
        // 19 bits times 12, and the half by which it is rounded.
        let codes = above as u32 * self.gain as u32 + (1 << (CODE_BITS + GAIN_BITS - 1));
        transfer::count(codes >> (CODE_BITS + GAIN_BITS))
    }

    /// Let the offset follow a reading of an untouched pad by 1/8 code at most, whatever it reads: it settles at the
    /// reading's median.
    pub const fn follow(&mut self, code: u16) {
        let code = (code as u32) << CODE_BITS;
        if code > self.offset as u32 {
            self.offset = self.offset.saturating_add(1);
        } else if code < self.offset as u32 {
            self.offset -= 1;
        }
    }

    /// A measured offset and noise, 1/8 code, and the gate that follows from them.
    fn set_measured(&mut self, offset: u16, noise: u16) {
        self.gate = noise.saturating_mul(GATE_SIGMAS as u16).max(GATE_MIN);
        (self.offset, self.noise) = (offset, noise);
    }
}

/// All taxels of one array.
#[derive(Debug, PartialEq, Eq)]
pub struct Calibration {
    /// Measurements of this array so far; 0: none, all values are nominal.
    version: u32,
    /// Names the contents: the first four bytes of the stored record's SHA-256; 0 where nothing was measured.
    id: u32,
    /// Taxels that do not work, in the order of the scan.
    pub faulty: TaxelMask,
    /// The taxels, in the order of the scan.
    pub trims: [Trim; TAXELS],
}

/// What there is to say of a calibration.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Summary {
    /// Measurements so far; 0: not calibrated.
    pub version: u32,
    /// Names the contents.
    pub id: u32,
    /// Taxels that do not work.
    pub faulty: u32,
    /// Mean noise of those that do, rms, 1/8 code.
    pub noise: u32,
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.version {
            0 => f.write_str("none"),
            version => write!(f, "{version} {:08x}", self.id),
        }
    }
}

/// What can be asked of a board: its vendor commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Request {
    /// Which array.
    pub sensor: u8,
    /// To do what.
    pub what: What,
}

/// What is done to the calibration of an array.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum What {
    /// Measure the untouched pad for so many seconds, 1 to [`SECONDS_MAX`].
    Measure(u8),
    /// Forget it: nominal values from now on.
    Forget,
    /// Multiply the gains by so much, 1/2048.
    Scale(u16),
}

/// How far the last measurement, or other change of a calibration, is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Progress {
    /// Which array.
    pub sensor: u8,
    /// How it stands.
    pub state: State,
    /// Frames measured.
    pub frames: u16,
    /// Frames to measure.
    pub wanted: u16,
    /// Row and column, of the scan, of the taxel that stood in the way.
    pub at: (u8, u8),
}

/// How a measurement stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
#[expect(missing_docs, reason = "the names say it, those of a [`Refusal`] too")]
pub enum State {
    /// There was none since start.
    #[default]
    None = 0,
    Measuring = 1,
    /// It is stored and in force.
    Done = 2,
    Touched = 3,
    Faulty = 4,
    TooShort = 5,
    /// The flash refused it.
    NotStored = 6,
    /// A gain would be 0, or 2 and more.
    Gain = 7,
}

const FORMAT: u8 = 1;
const ID_BYTES: usize = 4;
const TRIM_BYTES: usize = 6;
/// Bytes of a stored calibration.
pub const RECORD_BYTES: usize = 1 + 4 + 4 * TAXEL_ROWS + TRIM_BYTES * TAXELS + ID_BYTES;

impl Calibration {
    /// Zeros, for memory that is zeroed: not a calibration before [`set_nominal`](Self::set_nominal).
    pub const fn zeroed() -> Self {
        let trim = Trim { offset: 0, gate: 0, gain: 0, noise: 0 };
        Self { version: 0, id: 0, faulty: TaxelMask::NONE, trims: [trim; TAXELS] }
    }

    /// Nominal values. In place: it is too long for a stack.
    #[inline(never)]
    pub fn set_nominal(&mut self) {
        (self.version, self.id, self.faulty) = (0, 0, TaxelMask::NONE);
        self.trims.fill(Trim::NOMINAL);
    }

    /// Was the array measured?
    pub const fn is_measured(&self) -> bool {
        self.version > 0
    }

    /// The rows of taxels.
    #[inline]
    pub fn rows_mut(&mut self) -> &mut [[Trim; TAXEL_COLS]] {
        self.trims.as_chunks_mut().0
    }

    /// Multiply the gains by a factor, 1/2048. `false`: a gain would leave its range, and nothing has changed.
    #[inline(never)]
    pub fn scale(&mut self, factor: u16) -> bool {
        let scaled = |gain: u16| (u32::from(gain) * u32::from(factor) + (1 << (GAIN_BITS - 1))) >> GAIN_BITS;
        if !self.trims.iter().all(|trim| (1..=GAIN_MAX.into()).contains(&scaled(trim.gain))) {
            return false;
        }
        self.trims.iter_mut().for_each(|trim| trim.gain = scaled(trim.gain) as u16);
        self.seal();
        true
    }

    /// Become a copy of another one. In place: it is too long for a stack.
    #[inline(never)]
    pub fn copy_from(&mut self, other: &Self) {
        (self.version, self.id, self.faulty) = (other.version, other.id, other.faulty);
        self.trims.copy_from_slice(&other.trims);
    }

    /// Take the gains, and the name, of another calibration of the same array.
    #[inline(never)]
    pub fn take_gains(&mut self, other: &Self) {
        (self.version, self.id) = (other.version, other.id);
        self.trims.iter_mut().zip(&other.trims).for_each(|(own, other)| own.gain = other.gain);
    }

    /// What there is to say of it.
    #[inline(never)]
    pub fn summary(&self) -> Summary {
        // A faulty taxel has none.
        let (mut count, mut sum) = (0u32, 0u32);
        for trim in &self.trims {
            count += u32::from(trim.noise > 0);
            sum += u32::from(trim.noise);
        }
        Summary {
            version: self.version,
            id: self.id,
            faulty: self.faulty.count(),
            noise: sum.checked_div(count).unwrap_or(0),
        }
    }

    /// The contents are new: they get the next version and their name.
    fn seal(&mut self) {
        self.version = self.version.saturating_add(1);
        let mut hash = Sha256::new();
        self.bytes(|bytes| hash.update(bytes));
        self.id = hash.finalize().first_chunk().map_or(0, |first| u32::from_be_bytes(*first));
    }

    /// The stored record but for its end.
    fn bytes(&self, mut put: impl FnMut(&[u8])) {
        put(&[FORMAT]);
        put(&self.version.to_le_bytes());
        self.faulty.0.iter().for_each(|row| put(&row.to_le_bytes()));
        for Trim { offset, gain, noise, .. } in &self.trims {
            [offset, gain, noise].into_iter().for_each(|number| put(&number.to_le_bytes()));
        }
    }

    /// Write the record; its length. `None`: there is no room.
    pub fn encode(&self, out: &mut [u8]) -> Option<usize> {
        let mut rest = out.get_mut(..RECORD_BYTES)?.iter_mut();
        let mut put = |bytes: &[u8]| bytes.iter().zip(rest.by_ref()).for_each(|(&byte, to)| *to = byte);
        self.bytes(&mut put);
        put(&self.id.to_be_bytes());
        Some(RECORD_BYTES)
    }

    /// Is this its stored record: nothing, if the array was not measured?
    pub fn is_record(&self, record: &[u8]) -> bool {
        match record.split_last_chunk() {
            None => !self.is_measured(),
            Some((contents, id)) => {
                record.len() == RECORD_BYTES
                    && u32::from_be_bytes(*id) == self.id
                    && Sha256::digest(contents).starts_with(id)
            }
        }
    }

    /// Take a stored record. `false`: it is none, or no longer, and the values are nominal.
    pub fn decode(&mut self, record: &[u8]) -> bool {
        let taken = self.take(record).is_some();
        if !taken {
            self.set_nominal();
        }
        taken
    }

    #[inline(never)]
    fn take(&mut self, record: &[u8]) -> Option<()> {
        let (contents, id) = record.split_last_chunk::<ID_BYTES>()?;
        let hash = Sha256::digest(contents);
        let (&[format, version @ ..], rest) = contents.split_first_chunk::<5>()?;
        if record.len() != RECORD_BYTES || format != FORMAT || !hash.starts_with(id) {
            return None;
        }
        (self.version, self.id) = (u32::from_le_bytes(version), u32::from_be_bytes(*id));
        let (rows, trims) = rest.split_at_checked(4 * TAXEL_ROWS)?;
        for (row, bytes) in self.faulty.0.iter_mut().zip(rows.as_chunks::<4>().0) {
            *row = u32::from_le_bytes(*bytes);
        }
        for (trim, bytes) in self.trims.iter_mut().zip(trims.as_chunks::<TRIM_BYTES>().0) {
            let [offset, gain, noise] = [0, 2, 4].map(|at| u16::from_le_bytes([bytes[at], bytes[at + 1]]));
            if gain == 0 || gain > GAIN_MAX {
                return None;
            }
            trim.gain = gain;
            trim.set_measured(offset, noise);
        }
        Some(())
    }
}
