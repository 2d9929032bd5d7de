//! What the network sees of an array: count and change of every taxel, and nothing of an untouched pad.
//!
//! Below the paper's contact threshold a pad holds noise only, so it enters the network as zeros: it looks the
//! same on every unit, and its embedding is a constant of the model that costs nothing. The running averages
//! go on, so that the first touched frame is compared with what lay on the pad before.

use super::taxel_change::TaxelChange;
use crate::params::{CONTACT_SUM_MIN, PIEZO_CHANNELS, TAXEL_COLS, TAXEL_ROWS, TAXELS};

/// One array in the course of time.
#[derive(Clone, Debug)]
pub struct PadCells {
    change: TaxelChange,
}

impl PadCells {
    /// Before the first scan.
    pub const fn new() -> Self {
        Self { change: TaxelChange::new() }
    }

    /// Take a scan in and write every taxel's count and change ([`TaxelChange::push_rows`]) to `rows`, from row 0 on.
    /// `sum` is that of the counts. If the result is false, it is less than [`CONTACT_SUM_MIN`], count and change are
    /// 0 everywhere, and `rows` are left as they are.
    #[inline]
    pub fn push_rows<'r>(
        &mut self,
        counts: &[u16; TAXELS],
        sum: u32,
        rows: impl Iterator<Item = &'r mut [[i16; PIEZO_CHANNELS]; TAXEL_COLS]>,
    ) -> bool {
        let touched = sum >= CONTACT_SUM_MIN;
        if touched {
            self.change.push_rows(counts, rows);
        } else {
            self.change.follow(counts);
        }
        touched
    }

    /// As [`push_rows`](Self::push_rows), handing every taxel's index, count and change to `take`, row-major.
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

    /// A scan is missing: what comes after the gap is not compared with what was before it.
    pub fn forget(&mut self) {
        self.change.forget();
    }
}

impl Default for PadCells {
    fn default() -> Self {
        Self::new()
    }
}
