//! The film behind the simulated front end, calibrated as by a board: trimmed codes, and counts by the integer law.

use serde::Serialize;
use slipsense::calibration::{CODE_BITS, GATE_MIN, GATE_SIGMAS, Trim};
use slipsense::params::{TAXEL_COLS, TAXELS};
use slipsense::transfer::{ASYMPTOTE, HALF_CODE};

use super::front_end::{FrontEnd, table};
use super::transfer::{EXPONENT, FULL_SCALE_KPA, conductance};
use crate::draw::{Draw, Rng};

/// Codes of one count of an untouched taxel, in which pick-up and mains are given.
const CODES_PER_COUNT: f64 = HALF_CODE as f64 / ASYMPTOTE as f64;
/// Resistance of row drivers and lines, against the worst in the simulation.
const LINE: (f64, f64) = (0.4, 1.0);
/// Offset of a column's amplifier, µV: the data sheet's limit is three standard deviations.
const AMPLIFIER_UV: f64 = 125.0;

#[derive(Serialize)]
pub(super) struct Circuit {
    front_end: FrontEnd,
    /// Drift of the idle level since the calibration.
    drift_codes: f64,
    /// Against that of the simulation.
    noise: f64,
    #[serde(skip)]
    trims: [Trim; TAXEL_COLS],
    /// Deviation of the noise in each column of the scan that is read, codes.
    #[serde(skip)]
    sigma: [f64; TAXEL_COLS],
}

impl Circuit {
    pub fn draw(rng: &mut Rng) -> Self {
        let front_end = FrontEnd {
            row_drop: table::ROW_DROP * rng.uniform(LINE),
            col_drop: table::COL_DROP * rng.uniform(LINE),
            offset_uv: std::array::from_fn(|_| {
                (AMPLIFIER_UV / 3.0 * rng.normal()).clamp(-AMPLIFIER_UV, AMPLIFIER_UV)
            }),
        };
        let noise = rng.between(0.8, 2.0);
        let in_eighths = |codes: f64| (codes * f64::from(1 << CODE_BITS)).round() as u16;
        let gate = (GATE_SIGMAS as u16 * in_eighths(noise * table::NOISE)).max(GATE_MIN);
        let trims = front_end.offset_uv.map(|uv| Trim {
            offset: in_eighths(table::IDLE + uv * table::OFFSET_PER_UV),
            gate,
            ..Trim::NOMINAL
        });
        Self { front_end, drift_codes: rng.between(-10.0, 10.0), noise, trims, sigma: [0.0; TAXEL_COLS] }
    }

    /// Codes of conductances at [`conductance`]'s scale, in place.
    pub fn read(&mut self, taxels: &mut [f64; TAXELS]) {
        let full_scale = conductance(FULL_SCALE_KPA, EXPONENT);
        taxels.iter_mut().for_each(|g| *g /= full_scale);
        self.sigma = self.front_end.read(taxels).map(|variance| self.noise * variance.sqrt());
    }

    /// The count of a code with noise of unit variance and what the row has in common, counts.
    pub fn count(&self, cell: usize, code: f64, noise: f64, common_counts: f64) -> u16 {
        let col = cell % TAXEL_COLS;
        let level = code + self.drift_codes + self.sigma[col] * noise + CODES_PER_COUNT * common_counts;
        self.trims[col].count(level.round().clamp(0.0, u16::MAX.into()) as u16)
    }
}
