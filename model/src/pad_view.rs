//! How much of a pad a network gets to see: all taxels or every second or fourth, with or without the
//! change channel. The shipped network sees everything; the comparisons take away.

use slipsense::features::piezo::PiezoFrontEnd;
use slipsense::params::{PIEZO_CHANNELS, TAXEL_COLS, TAXEL_ROWS, TAXELS};

/// What a network sees of every scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PadView {
    /// Cells along a side: [`TAXEL_ROWS`], or a divisor of it, each cell then the first of a block of taxels.
    pub side: usize,
    /// Is the change there; else it is 0 everywhere.
    pub change: bool,
}

impl Default for PadView {
    fn default() -> Self {
        Self { side: TAXEL_ROWS, change: true }
    }
}

impl PadView {
    /// Before a sequence's first scan.
    pub fn start(self) -> Viewed {
        Viewed { view: self, pad: PiezoFrontEnd::new() }
    }
}

/// One pad in the course of a sequence.
#[derive(Clone, Debug)]
pub struct Viewed {
    view: PadView,
    pad: PiezoFrontEnd,
}

impl Viewed {
    /// Take a scan in and hand count and change of every taxel to `take`, row-major. A block's taxels all
    /// have its first one's count, so any network takes any view.
    pub fn push(&mut self, counts: &[u16; TAXELS], mut take: impl FnMut(usize, [i16; PIEZO_CHANNELS])) {
        let PadView { side, change: has_change } = self.view;
        let strided = (side < TAXEL_ROWS).then(|| strided(counts, side));
        let counts = strided.as_ref().unwrap_or(counts);
        self.pad.push(counts, |index, [count, change]| {
            take(index, [count, if has_change { change } else { 0 }]);
        });
    }
}

/// Every taxel replaced by the first of its block: `side` rows and columns of the pad, strided as in the paper.
fn strided(counts: &[u16; TAXELS], side: usize) -> [u16; TAXELS] {
    const { assert!(TAXEL_ROWS == TAXEL_COLS, "blocks are square") };
    let first = |at: usize| at - at % (TAXEL_ROWS / side);
    std::array::from_fn(|index| counts[first(index / TAXEL_COLS) * TAXEL_COLS + first(index % TAXEL_COLS)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_block_has_its_first_taxels_count_and_changes_as_one() {
        let mut counts = [0u16; TAXELS];
        // The first taxel of the block of rows 4 to 7, columns 8 to 11, and another that is not seen.
        counts[4 * TAXEL_COLS + 8] = 100;
        counts[7 * TAXEL_COLS + 11] = 900;
        let mut view = PadView { side: 8, change: true }.start();
        view.push(&[0; TAXELS], |_, cell| assert_eq!(cell, [0, 0]));
        view.push(&counts, |index, cell| {
            let inside = (4..8).contains(&(index / TAXEL_COLS)) && (8..12).contains(&(index % TAXEL_COLS));
            // A change of 100 counts in units of 1/8.
            assert_eq!(cell, if inside { [100, 800] } else { [0, 0] }, "taxel {index}");
        });
        let mut still = PadView { side: TAXEL_ROWS, change: false }.start();
        still.push(&[0; TAXELS], |_, _| ());
        still.push(&counts, |index, cell| assert_eq!(cell, [counts[index] as i16, 0]));
    }
}
