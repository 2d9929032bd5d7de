//! Pressures of one scan of the array.

use slipsense::params::{COL_PITCH_MM, ROW_PITCH_MM, TAXEL_COLS, TAXEL_ROWS, TAXELS};
use slipsense::sensor::active_cols;

/// Area of one cell, mm²: pressure in kPa times this is force in mN.
pub const CELL_MM2: f64 = COL_PITCH_MM as f64 * ROW_PITCH_MM as f64;

/// Centre of a cell in the pad's frame: x along columns, y along rows, origin in the middle.
pub(crate) fn cell_mm(cell: usize) -> (f64, f64) {
    let (row, col) = (cell / TAXEL_COLS, cell % TAXEL_COLS);
    (
        (col as f64 - (TAXEL_COLS as f64 - 1.0) / 2.0) * COL_PITCH_MM as f64,
        (row as f64 - (TAXEL_ROWS as f64 - 1.0) / 2.0) * ROW_PITCH_MM as f64,
    )
}

/// Cells that hold a taxel, in rising order.
pub(crate) fn active_cells() -> impl Iterator<Item = usize> {
    (0..TAXEL_ROWS).flat_map(|row| active_cols(row).map(move |col| row * TAXEL_COLS + col))
}

/// Pressures of one sensor, with the cells that carry any.
#[derive(Clone)]
pub struct PressureMap {
    /// Row-major, kPa.
    pub kpa: Box<[f64; TAXELS]>,
    /// Cells with pressure, in rising order.
    pub loaded: Vec<usize>,
    /// The point the object turns about: its own centre, in the pad's frame.
    pub pivot_mm: [f64; 2],
}

impl PressureMap {
    pub fn empty() -> Self {
        Self { kpa: Box::new([0.0; TAXELS]), loaded: Vec::new(), pivot_mm: [0.0; 2] }
    }

    pub fn force_n(&self) -> f64 {
        self.loaded.iter().map(|&i| self.kpa[i]).sum::<f64>() * CELL_MM2 * 1e-3
    }

    /// Scale the pressures so that they carry this force.
    pub(crate) fn carry(&mut self, force_n: f64) {
        let scale = force_n / self.force_n();
        for &cell in &self.loaded {
            self.kpa[cell] *= scale;
        }
    }

    pub(crate) fn clear(&mut self) {
        for &cell in &self.loaded {
            self.kpa[cell] = 0.0;
        }
        self.loaded.clear();
    }
}
