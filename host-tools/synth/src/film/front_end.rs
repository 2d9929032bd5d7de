//! The analog front end: codes of the ADC from the film's conductances.
//!
//! The circuit (`host-tools/front-end`) holds every column at a virtual ground, so a reading is the taxel's own
//! conductance. What is left of the others, with `S_r` and `S_c` the sums over its row and column in taxels at full
//! scale:
//!
//! ```text
//! code = idle + offset·(a + b·S_c) + full scale · g / ((1 + ρ_r·S_r) · (1 + ρ_c·S_c))
//! ```
//!
//! The row's driver and line have a resistance (ρ_r), so has the column's line (ρ_c), and an offset of the column's
//! amplifier drives a current through all taxels of the column (b). The constants are fitted to the simulation;
//! `cargo xtask front-end` compares the formula with it over random contact patterns, and the test below compares this
//! code with samples of it. Settling adds at most [`table::RESIDUAL`] codes, less than half a count.

use serde::Serialize;
use slipsense::params::{TAXEL_COLS, TAXELS};

#[cfg_attr(not(test), expect(dead_code, reason = "the error of settling is for the test"))]
pub(crate) mod table;

#[derive(Clone, Debug, Serialize)]
pub(crate) struct FrontEnd {
    /// ρ_r and ρ_c, per taxel at full scale.
    pub row_drop: f64,
    pub col_drop: f64,
    /// Offset of the amplifier of each column, µV.
    pub offset_uv: [f64; TAXEL_COLS],
}

impl FrontEnd {
    /// Codes without noise and rounding of conductances over full scale, in place; the columns' noise variance, codes².
    pub(crate) fn read(&self, taxels: &mut [f64; TAXELS]) -> [f64; TAXEL_COLS] {
        let mut cols = [0.0; TAXEL_COLS];
        for row in taxels.chunks_exact(TAXEL_COLS) {
            cols.iter_mut().zip(row).for_each(|(sum, g)| *sum += g);
        }
        let idle: [f64; TAXEL_COLS] = std::array::from_fn(|col| {
            table::IDLE + self.offset_uv[col] * (table::OFFSET_PER_UV + table::LEAK_PER_UV * cols[col])
        });
        let gain = cols.map(|sum| table::FULL_SCALE / (1.0 + self.col_drop * sum));
        for row in taxels.chunks_exact_mut(TAXEL_COLS) {
            let drop = 1.0 + self.row_drop * row.iter().sum::<f64>();
            for ((value, gain), idle) in row.iter_mut().zip(gain).zip(idle) {
                *value = (idle + gain * *value / drop).min(table::CLIP);
            }
        }
        let variance = |sum: f64| sum * (table::NOISE_PER_LOAD + table::NOISE_PER_LOAD2 * sum);
        cols.map(|sum| table::NOISE * table::NOISE + variance(sum))
    }
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;
    use slipsense::params::COUNT_MAX;
    use slipsense::transfer;
    use slipsense_recording::film::{EXPONENT, FULL_SCALE_KPA, conductance, counts};

    use super::*;
    use crate::check::within;

    /// One pattern, one driven row, the codes of its taxels in the simulation of all 32 × 32 lines.
    #[derive(Deserialize)]
    struct Case {
        row: usize,
        offset_uv: [f64; TAXEL_COLS],
        /// Row, column, conductance.
        taxels: Vec<(usize, usize, f64)>,
        codes: [f64; TAXEL_COLS],
    }

    #[test]
    fn the_model_is_within_a_hundredth_of_the_simulation() {
        let cases: Vec<Case> = serde_json::from_str(include_str!("front_end_cases.json")).unwrap();
        within("error of settling, codes", table::RESIDUAL, ..table::FULL_SCALE / 8192.0);
        for (number, case) in cases.iter().enumerate() {
            let front_end =
                FrontEnd { row_drop: table::ROW_DROP, col_drop: table::COL_DROP, offset_uv: case.offset_uv };
            let mut taxels = [0.0; TAXELS];
            let idle = {
                front_end.read(&mut taxels);
                taxels
            };
            taxels.fill(0.0);
            case.taxels.iter().for_each(|&(row, col, g)| taxels[row * TAXEL_COLS + col] = g);
            front_end.read(&mut taxels);
            let cells = case.row * TAXEL_COLS..(case.row + 1) * TAXEL_COLS;
            let off = cells.zip(case.codes).map(|(cell, code)| {
                ((taxels[cell] - code).abs() - 0.5).max(0.0) / (code - idle[cell]).abs().max(1.0)
            });
            within(format!("pattern {number}: off, share of the reading"), off.fold(0.0, f64::max), ..0.01);
        }
    }

    #[test]
    fn codes_and_the_integer_law_give_the_counts_of_the_film() {
        let front_end = FrontEnd { row_drop: 0.0, col_drop: 0.0, offset_uv: [0.0; TAXEL_COLS] };
        for kpa in [0.0, 1.0, 5.0, 20.0, 100.0, 1_000.0, 3_000.0, FULL_SCALE_KPA] {
            let mut taxels = [0.0; TAXELS];
            taxels[300] = conductance(kpa, EXPONENT) / conductance(FULL_SCALE_KPA, EXPONENT);
            front_end.read(&mut taxels);
            let code = taxels[300].round() as u32 - u32::from(transfer::IDLE_CODE);
            let off = f64::from(transfer::count(code)) - counts(kpa, EXPONENT).min(f64::from(COUNT_MAX));
            within(format!("{kpa} kPa: counts off the film's law"), off.abs(), ..1.0);
        }
        let [idle, full] = [table::IDLE, table::FULL_SCALE].map(|value| value.round() as u32);
        assert_eq!((idle, full), (transfer::IDLE_CODE.into(), transfer::FULL_SCALE_CODES));
    }
}
