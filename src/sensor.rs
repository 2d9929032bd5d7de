//! What the sensors deliver: one array scan, one batch of accelerometer samples, and which taxels are
//! masked.

use crate::params::{COUNT_MAX, ROW_CUT, TAXEL_COLS, TAXEL_ROWS, TAXELS, XL_BATCH_MAX};

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

/// Two neighbouring counts in one word, as they lie in memory: one load where two would be.
///
/// A sum of 16 such words, half a row, keeps its two sums apart: 16 · 4095 has 16 bits.
#[inline]
pub const fn pair([left, right]: [u16; 2]) -> u32 {
    left as u32 | (right as u32) << 16
}

/// Left and right of a [`pair`] together.
#[inline]
pub const fn sum_halves(pair: u32) -> u32 {
    (pair & 0xffff) + (pair >> 16)
}

const _: () =
    assert!(TAXEL_COLS / 2 * COUNT_MAX as usize <= u16::MAX as usize, "a row's pairs add up in a word");

/// One scan of one array: counts 0–4095 ([`transfer`](crate::transfer)), row-major, inactive taxels 0.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PiezoFrame {
    counts: [u16; TAXELS],
    /// Of all counts.
    sum: u32,
    saturated: bool,
    /// Has a mask that masks anything been laid over the counts?
    masked: bool,
}

/// Faulty taxels: stuck, shorted, torn. Row by row, bit `col` of a row's word stands for the
/// taxel in that column; a 1 masks it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TaxelMask(pub [u32; TAXEL_ROWS]);

const _: () = assert!(TAXEL_COLS == u32::BITS as usize, "a word masks a row");

/// The taxels of the pad, as a mask has them.
const ON_PAD: [u32; TAXEL_ROWS] = {
    let mut rows = [0; TAXEL_ROWS];
    let mut row = 0;
    while row < TAXEL_ROWS {
        rows[row] = u32::MAX << ROW_CUT[row] & u32::MAX >> ROW_CUT[row];
        row += 1;
    }
    rows
};

impl TaxelMask {
    /// No taxel is masked.
    pub const NONE: Self = Self([0; TAXEL_ROWS]);

    /// Mask one taxel more. One that the grid does not have changes nothing.
    pub const fn with(mut self, row: usize, col: usize) -> Self {
        if row < TAXEL_ROWS && col < TAXEL_COLS {
            self.0[row] |= 1 << col;
        }
        self
    }

    /// The taxels that one of the two masks.
    #[must_use]
    pub fn union(&self, other: &Self) -> Self {
        Self(core::array::from_fn(|row| self.0[row] | other.0[row]))
    }

    /// How many taxels it masks, on the pad or not.
    #[inline(never)]
    pub fn count(&self) -> u32 {
        self.0.iter().map(|word| word.count_ones()).sum()
    }

    /// How many taxels of the pad it masks.
    pub fn len(&self) -> u32 {
        self.0.iter().zip(&ON_PAD).map(|(word, on_pad)| (word & on_pad).count_ones()).sum()
    }

    /// Is the taxel masked? One that the grid does not have is not.
    pub const fn masks(&self, row: usize, col: usize) -> bool {
        row < TAXEL_ROWS && col < TAXEL_COLS && self.0[row] >> col & 1 != 0
    }

    /// Does it mask nothing on the pad? Cells beside the pad do not count: they read 0 anyway.
    pub fn is_empty(&self) -> bool {
        self.0.iter().zip(&ON_PAD).all(|(word, on_pad)| word & on_pad == 0)
    }
}

/// A count that a [`PiezoFrame`] cannot hold; `index` is its position, row-major.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the fields are named after what they are, and the text says it")]
pub enum TaxelError {
    OutOfRange { index: usize, count: u16 },
    Inactive { index: usize, count: u16 },
}

impl core::fmt::Display for TaxelError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let (index, count, rule) = match *self {
            Self::OutOfRange { index, count } => (index, count, "must have 12 bits"),
            Self::Inactive { index, count } => (index, count, "must be 0, the pad has no taxel there"),
        };
        write!(f, "row {}, column {}: {count}, {rule}", index / TAXEL_COLS, index % TAXEL_COLS)
    }
}

impl core::error::Error for TaxelError {}

impl PiezoFrame {
    /// An untouched pad.
    pub const fn zeroed() -> Self {
        Self { counts: [0; TAXELS], sum: 0, saturated: false, masked: false }
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
        let mut frame = Self { counts, sum: 0, saturated: false, masked: false };
        frame.update_totals();
        Ok(frame)
    }

    /// Recompute sum and saturation.
    fn update_totals(&mut self) {
        self.sum = self
            .rows()
            .fold(0, |sum, row| sum + sum_halves(row.iter().fold(0, |sums, &two| sums + pair(two))));
        // One more than a count has 13 bits at full scale only.
        const ONES: u32 = pair([1; 2]);
        let more = self.rows().flatten().fold(0, |bits, &two| bits | (pair(two) + ONES));
        self.saturated = more & pair([COUNT_MAX + 1; 2]) != 0;
    }

    /// Take a scan of which cells off the pad are zeroed and 12 bits are kept.
    pub fn from_scan(counts: [u16; TAXELS]) -> Self {
        let mut frame = Self::zeroed();
        frame.rescan(|own| *own = counts.map(|count| count & COUNT_MAX));
        frame
    }

    /// As [`from_scan`](Self::from_scan), in place: `write` changes the counts of the scan before, and to 12 bits.
    pub fn rescan(&mut self, write: impl FnOnce(&mut [u16; TAXELS])) {
        write(&mut self.counts);
        for (row, cells) in self.counts.as_chunks_mut::<TAXEL_COLS>().0.iter_mut().enumerate() {
            let pad = active_cols(row);
            cells.get_mut(..pad.start).unwrap_or_default().fill(0);
            cells.get_mut(pad.end..).unwrap_or_default().fill(0);
        }
        self.masked = false;
        self.update_totals();
    }

    /// Zero the taxels that `mask` names. An empty mask changes nothing.
    pub fn mask(&mut self, mask: &TaxelMask) {
        if mask.is_empty() {
            return;
        }
        // In place: a copy of the counts would be 2 KB of stack.
        for (cells, &word) in self.counts.as_chunks_mut::<TAXEL_COLS>().0.iter_mut().zip(&mask.0) {
            for (col, count) in cells.iter_mut().enumerate() {
                // All ones where the taxel is not masked.
                *count &= ((word >> col & 1) as u16 ^ 1).wrapping_neg();
            }
        }
        self.masked = true;
        self.update_totals();
    }

    /// Has a mask been laid over the counts?
    pub const fn is_masked(&self) -> bool {
        self.masked
    }

    /// The counts, row-major.
    #[inline]
    pub const fn counts(&self) -> &[u16; TAXELS] {
        &self.counts
    }

    /// Row by row, the counts in words of two neighbours: see [`pair`].
    #[inline]
    pub fn rows(&self) -> impl Iterator<Item = &[[u16; 2]; TAXEL_COLS / 2]> {
        self.counts.as_chunks::<2>().0.as_chunks().0.iter()
    }

    /// Sum over the pad, counts; at most 942 · 4095.
    pub const fn sum(&self) -> u32 {
        self.sum
    }

    /// Is any taxel at full scale?
    pub const fn is_saturated(&self) -> bool {
        self.saturated
    }

    /// Counts of the active taxels only, row by row, in neighbouring twos: the order of the raw frame on the bus.
    #[inline]
    pub fn active_rows(&self) -> impl Iterator<Item = &[[u16; 2]]> {
        // The same number is cut from both sides of an even row: no two cross its end.
        let rows = self.counts.as_chunks::<TAXEL_COLS>().0.iter().enumerate();
        rows.map(|(row, cells)| cells.get(active_cols(row)).unwrap_or_default().as_chunks().0)
    }

    /// Counts of the active taxels only, row by row.
    pub fn active(&self) -> impl Iterator<Item = u16> + '_ {
        self.active_rows().flatten().flatten().copied()
    }
}

/// One accelerometer sample, x, y, z, in LSB of the part.
pub type XlSample = [i16; 3];

/// What one sensor delivered for one frame. `None` is a part that is dead or missed this frame.
#[derive(Clone, Copy, Debug, Default)]
pub struct SensorInput<'a> {
    /// The array scan that the frame tick closed.
    pub piezo: Option<&'a PiezoFrame>,
    /// The samples that arrived since the previous tick, oldest first. May be empty. A board reads them shortly before
    /// the tick: with three sensors the newest is up to 1.0 ms older than it, of an ADXL382 2.0 ms.
    pub xl: Option<&'a [XlSample]>,
    /// Index of the sample after the last of `xl`, counted since start, wraps. If it is ahead of the index before by
    /// more samples than `xl` holds, samples are missing in between.
    pub xl_end: u32,
}

/// What one sensor delivered for one frame, in a buffer that is filled again and again.
#[derive(Clone, Debug)]
pub struct SensorReadings {
    /// The array scan; valid only if `piezo_arrived`.
    pub piezo: PiezoFrame,
    /// Did the array deliver for this frame?
    pub piezo_arrived: bool,
    /// Taxels that the driver found stuck; the pipeline masks them.
    pub stuck: TaxelMask,
    /// Samples since the previous tick, oldest first; valid only if `xl_arrived`.
    pub xl: heapless::Vec<XlSample, XL_BATCH_MAX>,
    /// Did the accelerometer deliver for this frame? It may have delivered zero samples.
    pub xl_arrived: bool,
    /// As [`SensorInput::xl_end`].
    pub xl_end: u32,
}

impl SensorReadings {
    /// Nothing arrived.
    pub const fn new() -> Self {
        Self {
            piezo: PiezoFrame::zeroed(),
            piezo_arrived: false,
            stuck: TaxelMask::NONE,
            xl: heapless::Vec::new(),
            xl_arrived: false,
            xl_end: 0,
        }
    }

    /// The readings as the pipeline takes them.
    pub fn input(&self) -> SensorInput<'_> {
        SensorInput {
            piezo: self.piezo_arrived.then_some(&self.piezo),
            xl: self.xl_arrived.then_some(self.xl.as_slice()),
            xl_end: self.xl_end,
        }
    }
}
