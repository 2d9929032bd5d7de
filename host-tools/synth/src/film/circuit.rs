//! The board behind the film: codes of the simulated front end, trimmed, and counts by the firmware's integer law.

use serde::Serialize;
use slipsense::calibration::{CODE_BITS, GATE_MIN, GATE_SIGMAS, Trim};
use slipsense::params::{TAXEL_COLS, TAXELS};
use slipsense::transfer::{ASYMPTOTE, HALF_CODE};

use super::front_end::{FrontEnd, table};
use crate::draw::{Draw, Rng};

/// Codes of one count of an untouched taxel, in which pick-up and mains are given.
pub(super) const CODES_PER_COUNT: f64 = HALF_CODE as f64 / ASYMPTOTE as f64;
/// Resistance of row drivers and lines, against the worst in the simulation.
const LINE: (f64, f64) = (0.4, 1.0);
/// Offset of a column's amplifier, µV: the data sheet's limit is three standard deviations.
const AMPLIFIER_UV: f64 = 125.0;
/// Noise of a board as the paper's, against that of the simulation, and the untouched level against the beginning of its
/// range, counts: modelling ranges, set so that the paper's baselines land where they do in it.
pub(super) const NOISE: (f64, f64) = (0.22, 0.38);
pub(super) const IDLE_COUNTS: (f64, f64) = (-0.9, -0.1);
/// What trimming leaves of a taxel's offset, rms.
pub(super) const TRIMMED_CODES: f64 = 0.25;
/// Noise of a calibrated board, and how far its idle level has drifted since, codes.
const CALIBRATED_NOISE: (f64, f64) = (0.8, 2.0);
const DRIFT_CODES: (f64, f64) = (-10.0, 10.0);

#[derive(Clone, Serialize)]
pub(crate) struct Circuit {
    front_end: FrontEnd,
    /// Against that of the simulation.
    pub noise: f64,
    pub idle_counts: f64,
    drift_codes: f64,
    #[serde(skip)]
    residual: Box<[f64; TAXELS]>,
    #[serde(skip)]
    trims: Box<[Trim; TAXELS]>,
    /// Deviation of the noise in each column of the scan that is read, codes.
    #[serde(skip)]
    sigma: [f64; TAXEL_COLS],
}

impl Circuit {
    /// A board as the paper's: its range begins above the idle level, so that most of the noise reads 0. Its amplifiers
    /// have no offset yet.
    pub fn draw(rng: &mut Rng, noise: f64, idle_counts: f64, residual: Box<[f64; TAXELS]>) -> Self {
        let (driver, row, col) = (rng.uniform(LINE), rng.uniform(LINE), rng.uniform(LINE));
        let mut circuit = Self {
            front_end: FrontEnd {
                row_drop: table::ROW_DROP * (driver + row) / 2.0,
                col_drop: table::COL_DROP * col,
                offset_uv: [0.0; TAXEL_COLS],
            },
            noise,
            idle_counts,
            drift_codes: 0.0,
            residual,
            trims: Box::new([Trim::NOMINAL; TAXELS]),
            sigma: [0.0; TAXEL_COLS],
        };
        circuit.trim(0);
        circuit
    }

    /// Give the amplifiers the offsets of theirs, and trim them.
    pub fn draw_amplifiers(&mut self, rng: &mut Rng) {
        let offset_uv = |_| (AMPLIFIER_UV / 3.0 * rng.normal()).clamp(-AMPLIFIER_UV, AMPLIFIER_UV);
        self.front_end.offset_uv = std::array::from_fn(offset_uv);
        self.trim(0);
    }

    /// The same board calibrated by the firmware: every taxel has a gate, and the idle level has drifted since.
    pub fn calibrated(mut self, rng: &mut Rng) -> Self {
        (self.noise, self.drift_codes) = (rng.uniform(CALIBRATED_NOISE), rng.uniform(DRIFT_CODES));
        self.idle_counts = 0.0;
        let gate = (GATE_SIGMAS as u16 * in_eighths(self.noise * table::NOISE)).max(GATE_MIN);
        self.trim(gate);
        self
    }

    fn trim(&mut self, gate: u16) {
        let margin = -self.idle_counts * CODES_PER_COUNT;
        let idle = |col: usize| table::IDLE + self.front_end.offset_uv[col] * table::OFFSET_PER_UV + margin;
        for (cell, (trim, residual)) in self.trims.iter_mut().zip(&*self.residual).enumerate() {
            (trim.offset, trim.gate) = (in_eighths(idle(cell % TAXEL_COLS) + residual), gate);
        }
    }

    /// Codes of conductances, share of a nominal taxel's at full scale, in place.
    pub fn read(&mut self, taxels: &mut [f64; TAXELS]) {
        self.sigma = self.front_end.read(taxels).map(|variance| self.noise * variance.sqrt());
    }

    /// Deviation of the noise of each column of the scan that was read, codes: the circuit's, and what is induced
    /// in every taxel, counts.
    pub fn sigmas(&self, factor: f64, induced_counts: f64) -> [f64; TAXEL_COLS] {
        let induced = CODES_PER_COUNT * induced_counts;
        self.sigma.map(|own| (own * own * factor * factor + induced * induced).sqrt())
    }

    /// The count of a code with its noise and what the row has in common, counts.
    pub fn count(&self, cell: usize, code: f64, common_counts: f64) -> u16 {
        let level = code + self.drift_codes + CODES_PER_COUNT * common_counts;
        // `round` is a call; this adds what it adds, and the conversion cuts off and ends at 0 and 65,535.
        self.trims[cell].count((level + 0.499_999_999_999_999_94) as u16)
    }
}

fn in_eighths(codes: f64) -> u16 {
    (codes * f64::from(1 << CODE_BITS)).round() as u16
}
