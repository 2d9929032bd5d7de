//! Crosstalk of a passive matrix under a zero-potential scan, to first order.
//!
//! One row at a time is driven to V, the others are held at 0; one column at a time is switched to the
//! amplifier, whose input is a virtual ground, the others to ground. With ideal switches a reading is
//! the taxel's own conductance. Real switches have a resistance when closed, `R_on`, and leak when open,
//! `R_off`:
//!
//! - the driven row and the sensed column share their current with the other taxels on the line: the
//!   reading is divided by `1 + R_on·(Σ_k G_ik + Σ_k G_kj)`;
//! - each undriven row stands at `V·R_on/R_off` instead of 0, so the column's other taxels leak in:
//!   `ε_c · mean_k G_kj` with `ε_c = n·R_on/R_off` over n rows, the taxel itself left out;
//! - each unselected column's current leaks into the amplifier in the same ratio: `ε_r · mean_k G_ik`.
//!
//! `part_tests.rs` solves the whole network of 32 + 32 nodes and compares. With undriven lines left
//! floating instead, current finds its way round: three loaded corners of a rectangle show a fourth.

use serde::Serialize;
use slipsense::params::{TAXEL_COLS, TAXEL_ROWS, TAXELS};

#[derive(Clone, Copy, Debug, Serialize)]
pub struct Crosstalk {
    /// Resistance of a closed switch with its line, times the reference conductance of the divider.
    pub line: f64,
    /// Share of the mean of its row that a taxel reads on top: `n·R_on/R_off` of the column switches.
    pub row_leak: f64,
    /// Share of the mean of its column: the same of the row switches.
    pub col_leak: f64,
}

impl Crosstalk {
    /// Readings of the conductances in `own`, in place. `unit` is the value that stands for the
    /// reference conductance: 1 for conductances relative to it, the asymptote's counts for counts.
    pub fn apply(&self, own: &mut [f64; TAXELS], unit: f64) {
        let mut rows = [0.0; TAXEL_ROWS];
        let mut cols = [0.0; TAXEL_COLS];
        for (line, sum) in own.chunks_exact(TAXEL_COLS).zip(&mut rows) {
            for (value, col) in line.iter().zip(&mut cols) {
                *sum += value;
                *col += value;
            }
        }
        let drop = self.line / unit;
        let row_leak = self.row_leak / TAXEL_COLS as f64;
        let col_leak = self.col_leak / TAXEL_ROWS as f64;
        for (line, row) in own.chunks_exact_mut(TAXEL_COLS).zip(rows) {
            if row == 0.0 {
                line.iter_mut().zip(cols).for_each(|(value, col)| *value = col_leak * col);
                continue;
            }
            for (value, col) in line.iter_mut().zip(cols) {
                let leak = row_leak * (row - *value) + col_leak * (col - *value);
                *value = *value / (1.0 + drop * (row + col)) + leak;
            }
        }
    }
}
