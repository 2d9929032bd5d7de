//! What the sensors deliver: one array scan, one batch of accelerometer samples, and whether they can
//! be believed.

use crate::params::{COUNT_MAX, ROW_CUT, TAXEL_COLS, TAXELS};

/// Is the taxel at this row and column on the pad? Cells outside always read 0.
#[inline]
pub const fn is_active(row: usize, col: usize) -> bool {
    let cut = ROW_CUT[row] as usize;
    col >= cut && col < TAXEL_COLS - cut
}

/// The active columns of a row.
#[inline]
pub const fn active_cols(row: usize) -> core::ops::Range<usize> {
    let cut = ROW_CUT[row] as usize;
    cut..TAXEL_COLS - cut
}

/// One scan of one array: ADC counts 0–4095, row-major, inactive taxels 0.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PiezoFrame([u16; TAXELS]);

/// A count that a [`PiezoFrame`] cannot hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TaxelError {
    /// More than 12 bits.
    OutOfRange {
        /// Position, row-major.
        index: usize,
        /// The count found.
        count: u16,
    },
    /// A reading where the pad has no taxel.
    Inactive {
        /// Position, row-major.
        index: usize,
        /// The count found.
        count: u16,
    },
}

impl PiezoFrame {
    /// An untouched pad.
    pub const fn zeroed() -> Self {
        Self([0; TAXELS])
    }

    /// Take counts from outside, refusing what breaks the rules.
    pub fn from_counts(counts: [u16; TAXELS]) -> Result<Self, TaxelError> {
        for (index, &count) in counts.iter().enumerate() {
            if count > COUNT_MAX {
                return Err(TaxelError::OutOfRange { index, count });
            }
            if count != 0 && !is_active(index / TAXEL_COLS, index % TAXEL_COLS) {
                return Err(TaxelError::Inactive { index, count });
            }
        }
        Ok(Self(counts))
    }

    /// Take a scan as the ADC wrote it: cells off the pad are zeroed, 12 bits are kept.
    pub fn from_scan(mut counts: [u16; TAXELS]) -> Self {
        for (index, count) in counts.iter_mut().enumerate() {
            let on_pad = is_active(index / TAXEL_COLS, index % TAXEL_COLS);
            *count = if on_pad { *count & COUNT_MAX } else { 0 };
        }
        Self(counts)
    }

    /// The counts, row-major.
    #[inline]
    pub const fn counts(&self) -> &[u16; TAXELS] {
        &self.0
    }

    /// Sum over the pad, counts; at most 942 · 4095.
    pub fn sum(&self) -> u32 {
        self.0.iter().fold(0, |sum, &count| sum + count as u32)
    }

    /// Counts of the active taxels only, row by row: the order of the raw frame on the bus.
    pub fn active(&self) -> impl Iterator<Item = u16> + '_ {
        self.0
            .chunks_exact(TAXEL_COLS)
            .enumerate()
            .flat_map(|(row, counts)| counts[active_cols(row)].iter().copied())
    }
}

/// One accelerometer sample, x, y, z, in LSB of the part.
pub type XlSample = [i16; 3];

/// What one sensor delivered for one frame. `None` is a part that is dead or missed this frame.
#[derive(Clone, Copy, Debug, Default)]
pub struct SensorInput<'a> {
    /// The array scan that the frame tick closed.
    pub piezo: Option<&'a PiezoFrame>,
    /// The samples that arrived since the previous tick, oldest first. May be empty.
    pub xl: Option<&'a [XlSample]>,
}
