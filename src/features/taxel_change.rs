//! What changed on a pad against its own recent past: the second channel that the network sees of an array.
//!
//! A slip moves load between neighbouring taxels by a few counts within a few frames, on top of hundreds of
//! counts that stay. Each taxel keeps a running average of its counts; the difference from it has that
//! motion alone, at eight times the gain.
//!
//! Per taxel, with `x = 16 · count` and `a` the average before this frame, both in 1/16 count:
//! `change = floor((x − a) / 2)`, then `a ← a + round((x − a) / 8)`: a time constant of 8 frames, 33 ms. A change of
//! half of full scale or more is cut to what a convolution can take, −16384 to 16383.

use crate::params::{CONV_INPUT_MAX, COUNT_MAX, TAXEL_COLS, TAXEL_ROWS, TAXELS};

/// Fraction bits of the average.
const AVERAGE_FRAC_BITS: u32 = 4;
/// The average moves by `2^-AVERAGE_SHIFT` of the difference each frame.
pub const AVERAGE_SHIFT: u32 = 3;
/// Units of the change in one count: it is as many times the count's scale.
pub const CHANGE_GAIN: i32 = 1 << (AVERAGE_FRAC_BITS - 1);

/// Half of the last bit that the average keeps.
const ROUND: i32 = 1 << (AVERAGE_SHIFT - 1);

const _: () = assert!((COUNT_MAX as u32) << AVERAGE_FRAC_BITS <= u16::MAX as u32, "the average fits");

/// The running averages of one array.
#[derive(Clone, Debug)]
pub struct TaxelChange {
    /// Row-major, 1/16 count.
    average: [u16; TAXELS],
    /// Has there been a scan since the start or the last gap?
    started: bool,
}

impl TaxelChange {
    /// Before the first scan, whose change is 0 everywhere.
    pub const fn new() -> Self {
        Self { average: [0; TAXELS], started: false }
    }

    /// Take a scan in and write every taxel's count and change to `rows`, from row 0 on: the change in 1/8 count,
    /// −16384 to 16383.
    #[inline]
    pub fn push_rows<'r>(
        &mut self,
        counts: &[u16; TAXELS],
        rows: impl Iterator<Item = &'r mut [[i16; 2]; TAXEL_COLS]>,
    ) {
        self.start(counts);
        let averages = self.average.as_chunks_mut::<TAXEL_COLS>().0.iter_mut();
        for ((averages, counts), row) in averages.zip(counts.as_chunks::<TAXEL_COLS>().0).zip(rows) {
            for ((average, &count), cell) in averages.iter_mut().zip(counts).zip(row) {
                *cell = [count as i16, update(average, count)];
            }
        }
    }

    /// Take a scan in whose change nobody asks for.
    #[inline]
    pub fn follow(&mut self, counts: &[u16; TAXELS]) {
        self.start(counts);
        for (average, &count) in self.average.iter_mut().zip(counts) {
            update(average, count);
        }
    }

    /// As [`push_rows`](Self::push_rows), handing every taxel's index, count and change to `take`, row-major.
    pub fn push(&mut self, counts: &[u16; TAXELS], mut take: impl FnMut(usize, u16, i16)) {
        let mut rows = [[[0; 2]; TAXEL_COLS]; TAXEL_ROWS];
        self.push_rows(counts, rows.iter_mut());
        for (index, (&[_, change], &count)) in rows.as_flattened().iter().zip(counts).enumerate() {
            take(index, count, change);
        }
    }

    /// The first scan is its own past.
    fn start(&mut self, counts: &[u16; TAXELS]) {
        if !self.started {
            self.started = true;
            for (average, &count) in self.average.iter_mut().zip(counts) {
                *average = count << AVERAGE_FRAC_BITS;
            }
        }
    }

    /// A scan is missing: what comes after the gap is not compared with what was before it.
    pub fn forget(&mut self) {
        self.started = false;
    }
}

/// Take a count of 12 bits into its average; the change.
#[inline]
fn update(average: &mut u16, count: u16) -> i16 {
    let difference = ((count as i32) << AVERAGE_FRAC_BITS) - *average as i32;
    // Between the old average and x, so within u16.
    *average = (*average as i32 + ((difference + ROUND) >> AVERAGE_SHIFT)) as u16;
    (difference >> 1).clamp(-CONV_INPUT_MAX - 1, CONV_INPUT_MAX) as i16
}

impl Default for TaxelChange {
    fn default() -> Self {
        Self::new()
    }
}
