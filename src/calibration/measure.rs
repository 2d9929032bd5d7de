//! The measurement: some seconds of an untouched pad.
//!
//! Sums are taken in blocks of a second. The noise is that within blocks, so that a slow drift does not count as noise;
//! how far the means of blocks lie apart says whether somebody touched the pad.

use core::fmt;

use super::{CODE_BITS, Calibration, Trim};
use crate::params::{ACTIVE_TAXELS, FRAME_RATE_HZ, TAXEL_COLS, TAXEL_ROWS, TAXELS};
use crate::sensor::TaxelMask;
use crate::transfer::IDLE_CODE;

/// Frames of a block: a second.
pub const BLOCK_FRAMES: u32 = FRAME_RATE_HZ;
/// Longest measurement, s.
pub const SECONDS_MAX: u32 = 60;

/// A taxel whose offset is farther from [`IDLE_CODE`] does not work, codes: 30 and 80 of 4096 of the linear range,
/// beyond the −20 to +60 that a front end in order may have.
const OFFSET_RANGE: (i32, i32) = (-480, 1_280);
/// A taxel of less noise is stuck, 1/8 code: a quarter of a code rms. The ADC alone has more.
const STUCK_NOISE: u32 = 2;
/// A taxel of more noise does not work, 1/8 code: 6 of 4096 of the linear range.
const NOISE_MAX: u32 = 96 << CODE_BITS;
/// Means of blocks lie apart by less, beside the noise, or the taxel moved, 1/8 code: 1 of 4096 of the linear range.
const MOVED: u32 = 16 << CODE_BITS;
/// With more faulty taxels, a tenth, the array is not one to be calibrated.
const FAULTY_MAX: u32 = ACTIVE_TAXELS as u32 / 10;
/// Deviations from the first reading are cut here: their squares over a block then have 34 bits, and saturate.
const DEVIATION_MAX: i32 = 8_191;

/// Why there is no calibration. Rows and columns are those of the scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the fields are named after what they are")]
pub enum Refusal {
    /// Neighbouring taxels moved, this one among them: somebody touched the pad.
    Touched { row: u8, col: u8 },
    /// More taxels are faulty than a pad may have, this one first.
    Faulty { count: u16, row: u8, col: u8 },
    /// No whole second was measured.
    TooShort,
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Touched { row, col } => write!(f, "touched at row {row}, column {col}"),
            Self::Faulty { count, row, col } => {
                write!(f, "{count} taxels out of order, the first at row {row}, column {col}")
            }
            Self::TooShort => f.write_str("less than a second of scans"),
        }
    }
}

/// What is known of a taxel: of this block, and of those before.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    /// The first reading, from which all deviate.
    first: u16,
    /// Of this block: deviations, codes, and their squares.
    sum: i32,
    squares: u32,
    /// Of all blocks: deviations, codes; variances, 1/64 code²; least and largest mean, 1/8 code.
    total: i32,
    variances: u32,
    least: i32,
    most: i32,
}

/// Sums over the codes of one array, in the order of the scan.
#[derive(Clone, Debug)]
pub struct Measurement {
    taxels: [Sums; TAXELS],
    frames: u32,
    blocks: u32,
}

impl Measurement {
    /// Before the first frame. Zeros.
    pub const fn new() -> Self {
        const NONE: Sums = Sums { first: 0, sum: 0, squares: 0, total: 0, variances: 0, least: 0, most: 0 };
        Self { taxels: [NONE; TAXELS], frames: 0, blocks: 0 }
    }

    /// Forget everything, in place.
    pub fn clear(&mut self) {
        (self.frames, self.blocks) = (0, 0);
        self.taxels.fill(Sums::default());
    }

    /// Frames taken in.
    pub const fn frames(&self) -> u32 {
        self.frames
    }

    #[inline(never)]
    /// Take in the codes of array `index` out of a scan of `arrays`.
    pub fn add(&mut self, codes: &[u16], index: usize, arrays: usize) {
        if self.frames == SECONDS_MAX * BLOCK_FRAMES {
            return;
        }
        let codes = codes.chunks_exact(arrays.max(1)).filter_map(|slot| slot.get(index));
        let (is_first, ends) = (self.frames == 0, (self.frames + 1).is_multiple_of(BLOCK_FRAMES));
        for (taxel, &code) in self.taxels.iter_mut().zip(codes) {
            if is_first {
                taxel.first = code;
            }
            let deviation = (i32::from(code) - i32::from(taxel.first)).clamp(-DEVIATION_MAX, DEVIATION_MAX);
            taxel.sum += deviation;
            taxel.squares = taxel.squares.saturating_add(deviation.unsigned_abs().pow(2));
            if ends {
                taxel.end_block(self.blocks == 0);
            }
        }
        self.frames += 1;
        self.blocks += u32::from(ends);
    }

    /// Give a calibration the measured offsets and noise, and mask what does not work; gains stay. `on_pad` has
    /// the taxels that there are.
    ///
    /// Never inlined, as all here that is not for every frame: flash is short.
    #[inline(never)]
    pub fn evaluate(&self, on_pad: &TaxelMask, calibration: &mut Calibration) -> Result<(), Refusal> {
        if self.blocks == 0 {
            return Err(Refusal::TooShort);
        }
        let (mut faulty, mut moved) = (TaxelMask::NONE, TaxelMask::NONE);
        for (slot, taxel) in self.taxels.iter().enumerate() {
            let (row, col) = (slot / TAXEL_COLS, slot % TAXEL_COLS);
            if !on_pad.masks(row, col) {
                continue;
            }
            let (offset, noise) = taxel.result(self.blocks);
            let from_idle = (offset >> CODE_BITS) - i32::from(IDLE_CODE);
            if from_idle < OFFSET_RANGE.0 || from_idle > OFFSET_RANGE.1 || noise < STUCK_NOISE {
                faulty = faulty.with(row, col);
            } else if taxel.most.abs_diff(taxel.least) > MOVED + noise || noise > NOISE_MAX {
                moved = moved.with(row, col);
            }
        }
        // One that moves alone has a bad contact; a finger takes its neighbours along.
        for (row, &word) in moved.0.iter().enumerate() {
            let beside = |at: usize| moved.0.get(at).copied().unwrap_or(0);
            let neighbours = word << 1 | word >> 1 | beside(row.wrapping_sub(1)) | beside(row + 1);
            if word & neighbours != 0 {
                let (row, col) = (row as u8, (word & neighbours).trailing_zeros() as u8);
                return Err(Refusal::Touched { row, col });
            }
        }
        faulty = faulty.union(&moved);
        let count = faulty.count();
        if count > FAULTY_MAX {
            let row = faulty.0.iter().position(|&row| row != 0).unwrap_or(0);
            let col = faulty.0.get(row).map_or(0, |row| row.trailing_zeros()) as u8;
            return Err(Refusal::Faulty { count: count as u16, row: row as u8, col });
        }
        for (slot, (trim, taxel)) in calibration.trims.iter_mut().zip(&self.taxels).enumerate() {
            trim.set_measured(Trim::NOMINAL.offset, 0);
            let (row, col) = (slot / TAXEL_COLS, slot % TAXEL_COLS);
            if on_pad.masks(row, col) && !faulty.masks(row, col) {
                let (offset, noise) = taxel.result(self.blocks);
                // In range: checked above.
                trim.set_measured(offset as u16, noise as u16);
            }
        }
        calibration.faulty = faulty;
        calibration.seal();
        Ok(())
    }
}

impl Sums {
    #[inline(never)]
    fn end_block(&mut self, is_first: bool) {
        const N: i64 = BLOCK_FRAMES as i64;
        let sum = i64::from(self.sum);
        // Rounded as everywhere: floor(x + 1/2).
        let mean = ((sum << CODE_BITS) * 2 + N).div_euclid(2 * N) as i32;
        let variance = ((i64::from(self.squares) * N - sum * sum).max(0) << (2 * CODE_BITS)) / (N * N);
        self.variances = self.variances.saturating_add(u32::try_from(variance).unwrap_or(u32::MAX));
        self.least = if is_first { mean } else { self.least.min(mean) };
        self.most = if is_first { mean } else { self.most.max(mean) };
        self.total += self.sum;
        (self.sum, self.squares) = (0, 0);
    }

    /// Offset and noise, 1/8 code, of the whole blocks.
    #[inline(never)]
    fn result(&self, blocks: u32) -> (i32, u32) {
        let frames = i64::from(blocks.max(1)) * i64::from(BLOCK_FRAMES);
        let mean = ((i64::from(self.total) << CODE_BITS) * 2 + frames).div_euclid(2 * frames) as i32;
        let offset = (i32::from(self.first) << CODE_BITS) + mean;
        (offset, self.variances.checked_div(blocks).unwrap_or(0).isqrt())
    }
}

const _: () = assert!(TAXEL_COLS == u32::BITS as usize && TAXELS == TAXEL_ROWS * TAXEL_COLS);
// The sum of a whole measurement's deviations, and an offset in range, in eighths.
const _: () = assert!(SECONDS_MAX as i64 * BLOCK_FRAMES as i64 * DEVIATION_MAX as i64 <= i32::MAX as i64);
const _: () = assert!((IDLE_CODE as i32 + OFFSET_RANGE.1 + 1) << CODE_BITS <= u16::MAX as i32);
