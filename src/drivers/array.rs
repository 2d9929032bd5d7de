//! One taxel array: picks its codes out of the scan of all, makes counts of them where they are on the pad, finds the
//! taxels that are stuck, and detects when the whole array is dead.

use crate::params::{
    CONTACT_SUM_MIN, COUNT_MAX, FRAME_RATE_HZ, TAXEL_COLS, TAXEL_ROWS, TAXEL_TOUCH_MIN, TAXELS,
};
use crate::sensor::{PiezoFrame, TaxelMask, active_cols};
use crate::transfer::{self, IDLE_CODE};

/// Frames that all taxels must agree for the array to be dead: 100 ms.
pub const DEAD_FRAMES: u32 = FRAME_RATE_HZ / 10;
/// From this count on an input may be at the rail of its amplifier, which need not reach the ADC's.
pub const RAIL: u16 = COUNT_MAX - 15;
/// Equal readings of a taxel in a row after which it is stuck: a third of a second. A live taxel has a noise of 0.5 LSB
/// rms at least, so it repeats a reading with a probability of 0.68 at most, and 80 times with one of 4e-14.
pub const STUCK_FRAMES: u32 = FRAME_RATE_HZ / 3;

/// How an array sits on its pad: where a taxel is on the pad, of which the scan knows row and column lines.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Mounting {
    /// Row lines run along the columns of the pad. Before the flips.
    pub transposed: bool,
    /// Row 0 of the scan is row 31 of the pad.
    pub rows_flipped: bool,
    /// Column 0 of the scan is column 31 of the pad.
    pub cols_flipped: bool,
}

impl Mounting {
    /// As a register holds it: transposed, rows flipped, columns flipped in bits 0, 1, 2. `None`: more bits are set.
    pub const fn from_bits(bits: u8) -> Option<Self> {
        if bits > 7 {
            return None;
        }
        Some(Self { transposed: bits & 1 != 0, rows_flipped: bits & 2 != 0, cols_flipped: bits & 4 != 0 })
    }

    /// Where on the pad the taxel of this slot is, row-major.
    pub const fn place(self, slot: usize) -> usize {
        let (row, col) = (slot / TAXEL_COLS % TAXEL_ROWS, slot % TAXEL_COLS);
        let (row, col) = if self.transposed { (col, row) } else { (row, col) };
        let row = if self.rows_flipped { TAXEL_ROWS - 1 - row } else { row };
        let col = if self.cols_flipped { TAXEL_COLS - 1 - col } else { col };
        row * TAXEL_COLS + col
    }
}

/// One array and what is known of it.
///
/// **Dead** is an array of which, for [`DEAD_FRAMES`] frames, all taxels read the same, or all are at the upper rail:
/// live taxels differ by their noise. It is alive again with the first frame that shows otherwise. All taxels at 0 is
/// an untouched pad, whose noise the amplifier may cut off; so that an open cable does not look like one, the wiring
/// page lets it read full scale.
///
/// **Stuck** is a taxel that reads exactly the same in [`STUCK_FRAMES`] frames, and would be felt: it reads
/// [`TAXEL_TOUCH_MIN`] or more. One row is looked at after the other, so it takes up to 10.7 s to be found, and as long
/// to count as live again once it moves. At full scale a taxel is judged only while nothing else touches the pad,
/// because a firm grasp may hold it there for as long.
#[derive(Clone, Debug)]
pub struct Array {
    /// How it sits.
    pub mounting: Mounting,
    stuck: TaxelMask,
    /// Frames in a row whose taxels agree.
    uniform_frames: u32,
    /// The row that is looked at, and for how many frames already.
    row: usize,
    frames: u32,
    /// What it read in the first of them.
    held: [u16; TAXEL_COLS],
    /// Its taxels that are not stuck, and those that cannot be judged.
    live: u32,
    open: u32,
}

impl Array {
    /// Of which nothing is known yet.
    pub const fn new(mounting: Mounting) -> Self {
        Self {
            mounting,
            stuck: TaxelMask::NONE,
            uniform_frames: 0,
            row: 0,
            frames: 0,
            held: [0; TAXEL_COLS],
            live: 0,
            open: 0,
        }
    }

    /// Taxels that are stuck, for the pipeline to mask.
    pub const fn stuck(&self) -> &TaxelMask {
        &self.stuck
    }

    /// Is the array dead?
    pub const fn is_dead(&self) -> bool {
        self.uniform_frames >= DEAD_FRAMES
    }

    /// Take this array's codes out of a scan of `arrays` (see [`TaxelScan::codes`]), of which it is number `index`.
    /// `false`: it is dead.
    ///
    /// [`TaxelScan::codes`]: crate::board::TaxelScan::codes
    pub fn read(&mut self, codes: &[u16], index: usize, arrays: usize, frame: &mut PiezoFrame) -> bool {
        frame.rescan(|counts| {
            for (slot, codes) in codes.chunks_exact(arrays.max(1)).take(TAXELS).enumerate() {
                // `place` is below `TAXELS`, `index` below `arrays`.
                if let (Some(count), Some(&code)) =
                    (counts.get_mut(self.mounting.place(slot)), codes.get(index))
                {
                    *count = transfer::count(code.saturating_sub(IDLE_CODE).into());
                }
            }
            self.monitor(counts);
        });
        !self.is_dead()
    }

    fn monitor(&mut self, counts: &[u16; TAXELS]) {
        let (mut least, mut most, mut sum_below_full) = (COUNT_MAX, 0, 0);
        for (row, cells) in counts.as_chunks::<TAXEL_COLS>().0.iter().enumerate() {
            for &count in cells.get(active_cols(row)).unwrap_or_default() {
                least = least.min(count);
                most = most.max(count);
                sum_below_full += if count < COUNT_MAX { u32::from(count) } else { 0 };
            }
        }
        let uniform = least == most && most > 0 || least >= RAIL;
        self.uniform_frames = if uniform { self.uniform_frames.saturating_add(1) } else { 0 };

        self.watch_row(counts, sum_below_full >= CONTACT_SUM_MIN);
    }

    fn watch_row(&mut self, counts: &[u16; TAXELS], touched: bool) {
        let (row, cells) = (self.row % TAXEL_ROWS, counts.as_chunks::<TAXEL_COLS>().0);
        let Some(cells) = cells.get(row) else { return };
        if self.frames == 0 {
            (self.held, self.live, self.open) = (*cells, 0, 0);
        }
        let mut active = 0;
        let pad = active_cols(row);
        let readings = cells.iter().zip(&self.held).enumerate().skip(pad.start).take(pad.len());
        for (col, (&count, &held)) in readings {
            let bit = 1 << col;
            active |= bit;
            if count != held || count < TAXEL_TOUCH_MIN {
                self.live |= bit;
            } else if count == COUNT_MAX && touched {
                self.open |= bit;
            }
        }
        self.frames += 1;
        if self.frames >= STUCK_FRAMES {
            if let Some(stuck) = self.stuck.0.get_mut(row) {
                *stuck = active & !self.live & (*stuck | !self.open);
            }
            (self.row, self.frames) = ((row + 1) % TAXEL_ROWS, 0);
        }
    }
}
