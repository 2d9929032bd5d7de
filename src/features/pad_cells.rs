//! What the network sees of an array: count and change of every taxel, and nothing of an untouched pad.
//!
//! Below the paper's contact threshold a pad holds noise only, so it enters the network as zeros: it looks the
//! same on every unit, and its embedding is a constant of the model that costs nothing. The running averages
//! go on, so that the first touched frame is compared with what lay on the pad before.

use super::taxel_change::TaxelChange;
use crate::params::{CONTACT_SUM_MIN, PIEZO_CHANNELS, TAXELS};

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

    /// Take a scan in and hand every taxel's count and change ([`TaxelChange::push`]) to `take`, row-major.
    /// Both are 0 everywhere if the result is false: the counts sum to less than [`CONTACT_SUM_MIN`].
    #[inline]
    pub fn push(
        &mut self,
        counts: &[u16; TAXELS],
        mut take: impl FnMut(usize, [i16; PIEZO_CHANNELS]),
    ) -> bool {
        let touched = counts.iter().fold(0, |sum: u32, &count| sum + count as u32) >= CONTACT_SUM_MIN;
        // All ones or all zeros: no branch per taxel.
        let mask = -(touched as i16);
        self.change.push(counts, |index, count, change| take(index, [count as i16 & mask, change & mask]));
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
