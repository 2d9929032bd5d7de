//! One taxel array: picks its codes out of the scan of all, makes counts of them where they are on the pad, lets its
//! offsets follow a slow drift, finds the taxels that are stuck, and detects when the whole array is dead.

use crate::calibration::{CODE_BITS, Calibration};
use crate::params::{CONTACT_SUM_MIN, COUNT_MAX, FRAME_RATE_HZ, MAX_SENSORS, TAXEL_COLS, TAXEL_ROWS};
use crate::sensor::{PiezoFrame, TaxelMask, active_cols};

/// Frames that all taxels must agree for the array to be dead: 100 ms.
pub const DEAD_FRAMES: u32 = FRAME_RATE_HZ / 10;
/// From this code on an input may be at the upper rail of its amplifier, which need not reach the ADC's.
pub const RAIL: u16 = 0xFF00;
/// Below this code an input is shorted to ground: an idle one reads [`IDLE_CODE`](crate::transfer::IDLE_CODE) or so.
pub const GROUND: u16 = 16;
/// Equal codes of a taxel in a row after which it is stuck: a third of a second.
pub const STUCK_FRAMES: u32 = FRAME_RATE_HZ / 3;
/// Only a taxel of at least this noise is found stuck, 1/8 code: one code rms. Such a one repeats a code with a
/// probability of 0.38 at most, and 80 times in a row with one of 1e-33.
pub const LIVE_NOISE: u16 = 1 << CODE_BITS;
/// The pad must have been untouched for so many frames before its offsets follow: a second.
pub const QUIET_FRAMES: u32 = FRAME_RATE_HZ;

/// How an array sits on its pad: where a taxel is on the pad, of which the scan knows row and column lines.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Mounting {
    /// Row 0 of the scan is row 31 of the pad.
    pub rows_flipped: bool,
    /// Column 0 of the scan is column 31 of the pad.
    pub cols_flipped: bool,
}

const _: () =
    assert!(TAXEL_ROWS.is_power_of_two() && TAXEL_COLS.is_power_of_two(), "to flip is to invert bits");

impl Mounting {
    /// Bits of a row's and of a column's number that differ on the pad.
    const fn flips(self) -> (usize, usize) {
        let rows = if self.rows_flipped { TAXEL_ROWS - 1 } else { 0 };
        let cols = if self.cols_flipped { TAXEL_COLS - 1 } else { 0 };
        (rows, cols)
    }

    /// The taxels of the pad, in the order of the scan.
    pub fn pad(self) -> TaxelMask {
        // As many are cut from the left of a row as from the right.
        let row = |row: usize| active_cols(row ^ self.flips().0).fold(0, |bits, col| bits | 1 << col);
        TaxelMask(core::array::from_fn(row))
    }
}

/// One array and what is known of it.
///
/// **Dead** is an array of which, for [`DEAD_FRAMES`] frames, all taxels read the same code, or all are at a rail: live
/// taxels differ by their noise. It is alive again with the first frame that shows otherwise.
///
/// **Stuck** is a taxel that reads the same code in [`STUCK_FRAMES`] frames although it had a noise of [`LIVE_NOISE`]
/// when it was calibrated: a motionless grasp goes on scattering. One row is looked at after the other, so it takes up to
/// 10.7 s to be found, and as long to count as live again. At the upper rail, where nothing scatters, a taxel is judged
/// only while nothing else touches the pad: a firm grasp may hold it there. Where a whole row stands still, the scan
/// does, and no taxel is blamed.
///
/// **Offsets follow** a slow drift of a calibrated array while the pad is untouched, [`QUIET_FRAMES`] after the last
/// contact: each frame those of the row that is looked at, by 1/8 code, which is 0.94 codes a second at most.
#[derive(Debug)]
pub struct Array<'c> {
    /// Offsets, gains, gates, in the order of the scan.
    calibration: &'c mut Calibration,
    mounting: Mounting,
    /// Taxels found stuck, in the order of the scan.
    found: TaxelMask,
    /// Those and the faulty ones of the calibration, on the pad.
    masked: TaxelMask,
    /// Taxels that a setting switches off, on the pad.
    off: TaxelMask,
    /// Frames in a row whose taxels agree.
    uniform_frames: u32,
    /// Frames in a row without contact.
    quiet_frames: u32,
    /// The row that is looked at, and for how many frames already.
    row: usize,
    frames: u32,
    /// What it read in the first of them.
    held: [u16; TAXEL_COLS],
    /// Its taxels that are not stuck, and those that cannot be judged.
    live: u32,
    open: u32,
}

impl<'c> Array<'c> {
    /// Of which nothing is known but its calibration.
    pub const fn new(calibration: &'c mut Calibration) -> Self {
        Self {
            calibration,
            mounting: Mounting { rows_flipped: false, cols_flipped: false },
            found: TaxelMask::NONE,
            masked: TaxelMask::NONE,
            off: TaxelMask::NONE,
            uniform_frames: 0,
            quiet_frames: 0,
            row: 0,
            frames: 0,
            held: [0; TAXEL_COLS],
            live: 0,
            open: 0,
        }
    }

    /// From now on it sits so.
    #[inline(never)]
    pub fn mount(&mut self, mounting: Mounting) {
        self.mounting = mounting;
        self.update_mask();
    }

    /// From now on these taxels of the pad are no touch, whatever they read; the pipeline masks them.
    pub fn switch_off(&mut self, off: TaxelMask) {
        self.off = off;
    }

    /// How it sits.
    pub const fn mounting(&self) -> Mounting {
        self.mounting
    }

    /// From now on it is trimmed so: by a new measurement, or by new gains alone, whose offsets stay where they have
    /// followed to.
    pub fn calibrate(&mut self, calibration: &Calibration, gains_only: bool) {
        if gains_only {
            self.calibration.take_gains(calibration);
        } else {
            self.calibration.copy_from(calibration);
            (self.found, self.frames) = (TaxelMask::NONE, 0);
            self.update_mask();
        }
    }

    /// Taxels that are faulty or stuck, for the pipeline to mask.
    pub const fn stuck(&self) -> &TaxelMask {
        &self.masked
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
        let arrays = arrays.clamp(1, MAX_SENSORS);
        let (flip_row, flip_col) = self.mounting.flips();
        // Bits that all codes have, and that any has: all codes are equal where the two are.
        let (mut all, mut any) = (u16::MAX, 0);
        frame.rescan(|counts| {
            let pad = counts.as_chunks_mut::<TAXEL_COLS>().0;
            let lines = codes.chunks_exact(TAXEL_COLS * arrays);
            for ((row, line), trims) in lines.enumerate().zip(self.calibration.rows_mut()) {
                let on_pad = row ^ flip_row;
                // As many are cut from the left of a row as from the right.
                let cols = active_cols(on_pad % TAXEL_ROWS);
                let line = line.get(cols.start * arrays..cols.end * arrays).unwrap_or_default();
                let trims = trims.get(cols.clone()).unwrap_or_default();
                let Some(counts) = pad.get_mut(on_pad) else { return };
                for (col, (slot, trim)) in (cols.start..).zip(line.chunks_exact(arrays).zip(trims)) {
                    let Some(&code) = slot.get(index) else { return };
                    all &= code;
                    any |= code;
                    if let Some(count) = counts.get_mut(col ^ flip_col) {
                        *count = trim.count(code);
                    }
                }
            }
        });
        let uniform = all == any || all >= RAIL || any < GROUND;
        self.uniform_frames = if uniform { self.uniform_frames.saturating_add(1) } else { 0 };
        let touched = self.contact_sum(frame) >= CONTACT_SUM_MIN;
        // An array that says nothing of its taxels is no untouched one: its offsets stay.
        self.quiet_frames = if touched || uniform { 0 } else { self.quiet_frames.saturating_add(1) };
        let mut watched = [0; TAXEL_COLS];
        let row = codes.chunks_exact(arrays).skip(self.row * TAXEL_COLS).filter_map(|slot| slot.get(index));
        watched.iter_mut().zip(row).for_each(|(to, &code)| *to = code);
        self.watch_row(&watched, touched);
        !self.is_dead()
    }

    /// Counts of the taxels that are neither masked nor off nor at full scale, which one that is shorted would be.
    fn contact_sum(&self, frame: &PiezoFrame) -> u32 {
        let mut sum = frame.sum();
        let masked = self.masked.0.iter().zip(&self.off.0).map(|(masked, off)| masked | off);
        let rows = frame.counts().as_chunks::<TAXEL_COLS>().0.iter().zip(masked);
        for (row, masked) in rows.filter(|&(_, masked)| frame.is_saturated() || masked != 0) {
            for (col, &count) in row.iter().enumerate() {
                if masked >> col & 1 != 0 || count == COUNT_MAX {
                    sum -= u32::from(count);
                }
            }
        }
        sum
    }

    #[inline(never)]
    fn watch_row(&mut self, codes: &[u16; TAXEL_COLS], touched: bool) {
        let row = self.row % TAXEL_ROWS;
        if self.frames == 0 {
            (self.held, self.live, self.open) = (*codes, 0, 0);
        }
        let follow = self.calibration.is_measured() && self.quiet_frames >= QUIET_FRAMES;
        let mut active = 0;
        let cols = active_cols((row ^ self.mounting.flips().0) % TAXEL_ROWS);
        let stuck = self.found.0.get(row).copied().unwrap_or(0);
        let Some(trims) = self.calibration.rows_mut().get_mut(row) else { return };
        let readings = codes.iter().zip(&self.held).zip(trims).enumerate();
        for (col, ((&code, &held), trim)) in readings.skip(cols.start).take(cols.len()) {
            let bit = 1 << col;
            active |= bit;
            if code != held || trim.noise < LIVE_NOISE && code < RAIL {
                self.live |= bit;
            } else if code >= RAIL && touched {
                self.open |= bit;
            }
            if follow && stuck & bit == 0 {
                trim.follow(code);
            }
        }
        self.frames += 1;
        if self.frames >= STUCK_FRAMES {
            if let Some(found) = self.found.0.get_mut(row)
                && self.live & active != 0
            {
                *found = active & !self.live & (*found | !self.open);
            }
            self.update_mask();
            (self.row, self.frames) = ((row + 1) % TAXEL_ROWS, 0);
        }
    }

    #[inline(never)]
    fn update_mask(&mut self) {
        let (flip_row, flip_col) = self.mounting.flips();
        let both = self.found.union(&self.calibration.faulty);
        for (row, masked) in self.masked.0.iter_mut().enumerate() {
            let bits = both.0.get(row ^ flip_row).copied().unwrap_or(0);
            *masked = if flip_col == 0 { bits } else { bits.reverse_bits() };
        }
    }
}
