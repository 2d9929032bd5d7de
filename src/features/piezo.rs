//! What the network sees of an array: count and delta of every taxel, zeros of an untouched pad.
//!
//! A slip moves load between neighbouring taxels by a few counts within a few frames, on top of hundreds of counts that
//! stay. Each taxel keeps a running average of its counts; the *delta* from it has that motion alone, at eight times
//! the gain. With `x = 16 · count` and `a` the average before this frame, both in 1/16 count:
//! `delta = floor((x − a) / 2)`, then `a ← a + round((x − a) / 8)`: a time constant of 8 frames, 33 ms. A delta is
//! limited to what a convolution takes, −16384 to 16383, half of full scale.
//!
//! Below the paper's contact threshold a pad holds noise only. It enters the network as zeros, so that it looks the same
//! on every unit and its embedding is a constant of the model that costs nothing. The averages go on.

use crate::params::{
    CONTACT_SUM_MIN, CONV_INPUT_MAX, COUNT_MAX, PIEZO_CHANNELS, TAXEL_COLS, TAXEL_ROWS, TAXELS,
};

/// Fraction bits of the average.
const AVERAGE_FRAC_BITS: u32 = 4;
/// The average moves by `2^-AVERAGE_SHIFT` of the difference each frame.
pub const AVERAGE_SHIFT: u32 = 3;

const ROUND: i32 = 1 << (AVERAGE_SHIFT - 1);

const _: () = assert!((COUNT_MAX as u32) << AVERAGE_FRAC_BITS <= u16::MAX as u32, "the average fits");

/// A row of taxels, count and delta of each.
pub type TaxelRow = [[i16; PIEZO_CHANNELS]; TAXEL_COLS];

/// The front end of one array.
#[derive(Clone, Debug)]
pub struct PiezoFrontEnd {
    /// Row-major, 1/16 count.
    average: [u16; TAXELS],
    /// Has there been a scan since the start or the last gap?
    started: bool,
}

impl PiezoFrontEnd {
    /// Before the first scan, whose delta is 0 everywhere.
    pub const fn new() -> Self {
        Self { average: [0; TAXELS], started: false }
    }

    /// Take a scan whose counts sum to `sum`, and write count and delta of every taxel to `rows`, from row 0 on. `false`
    /// below [`CONTACT_SUM_MIN`]: count and delta are 0 everywhere, and `rows` are not written.
    #[inline]
    pub fn push_rows<'r>(
        &mut self,
        counts: &[u16; TAXELS],
        sum: u32,
        rows: impl Iterator<Item = &'r mut TaxelRow>,
    ) -> bool {
        if !self.started {
            self.started = true;
            for (average, &count) in self.average.iter_mut().zip(counts) {
                *average = count << AVERAGE_FRAC_BITS;
            }
        }
        let touched = sum >= CONTACT_SUM_MIN;
        if touched {
            let averages = self.average.as_chunks_mut::<TAXEL_COLS>().0.iter_mut();
            for ((averages, counts), row) in averages.zip(counts.as_chunks::<TAXEL_COLS>().0).zip(rows) {
                for ((average, &count), cell) in averages.iter_mut().zip(counts).zip(row) {
                    *cell = [count as i16, update(average, count)];
                }
            }
        } else {
            for (average, &count) in self.average.iter_mut().zip(counts) {
                update(average, count);
            }
        }
        touched
    }

    /// As [`push_rows`](Self::push_rows), with every taxel's index, count and delta to `take`, row-major.
    pub fn push(
        &mut self,
        counts: &[u16; TAXELS],
        mut take: impl FnMut(usize, [i16; PIEZO_CHANNELS]),
    ) -> bool {
        let mut rows = [[[0; PIEZO_CHANNELS]; TAXEL_COLS]; TAXEL_ROWS];
        let sum = counts.iter().map(|&count| count as u32).sum();
        let touched = self.push_rows(counts, sum, rows.iter_mut());
        rows.as_flattened().iter().enumerate().for_each(|(index, &cell)| take(index, cell));
        touched
    }

    /// A scan is missing: the next one is not compared with those before the gap.
    pub fn reset(&mut self) {
        self.started = false;
    }
}

/// Update an average with a count of 12 bits; the delta.
#[inline]
fn update(average: &mut u16, count: u16) -> i16 {
    let difference = ((count as i32) << AVERAGE_FRAC_BITS) - *average as i32;
    // Between the old average and x, so within u16.
    *average = (*average as i32 + ((difference + ROUND) >> AVERAGE_SHIFT)) as u16;
    (difference >> 1).clamp(-CONV_INPUT_MAX - 1, CONV_INPUT_MAX) as i16
}
