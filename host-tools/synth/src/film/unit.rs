//! One array and its readout as built: what differs from unit to unit and stays.
//!
//! The ranges of everything that is drawn are here, and only here.

use libm::cos;
use serde::Serialize;
use slipsense::params::{TAXEL_COLS, TAXELS};
use slipsense::sensor::is_active;
use slipsense_recording::film::EXPONENT;

use super::circuit::{self, Circuit};
use super::creep::Creep;
use crate::contact::cell_mm;
use crate::draw::{Draw, Rng};

/// Standard deviation of the smooth variation of gain over the pad: two of them are ±15 %.
const GAIN_SMOOTH: f64 = 0.075;
/// Variation of each taxel by itself, standard deviation.
const GAIN_OWN: f64 = 0.05;
/// Deviation of the exponent from the nominal film's.
const EXPONENT_SPREAD: f64 = 0.05;

#[derive(Clone, Serialize)]
pub(crate) struct FilmUnit {
    /// Factor on the conductance of each taxel; 0 for dead and stuck ones.
    #[serde(skip)]
    pub gain: Box<[f64; TAXELS]>,
    /// Taxels without conductance, as row and column.
    pub dead: Vec<[usize; 2]>,
    /// Taxels that read a level whatever happens: row, column, counts.
    pub stuck: Vec<[usize; 3]>,
    /// Correlation length of the smooth variation of gain.
    pub gain_length_mm: f64,
    pub exponent: f64,
    pub mains_counts: f64,
    /// Time constant of a taxel.
    pub lag_s: f64,
    /// Duration of one scan; a frame is 4.17 ms.
    pub scan_s: f64,
    pub creep: Creep,
    /// Loop width, share of the excursion.
    pub hysteresis: f64,
    pub circuit: Circuit,
    /// Relative change of gain per °C.
    pub per_degree: f64,
    /// Relative loss of gain in four months.
    pub ageing: f64,
}

impl FilmUnit {
    pub(crate) fn draw(rng: &mut Rng) -> Self {
        let gain_length_mm = rng.between(5.0, 10.0);
        let mut gain = gain_map(rng, gain_length_mm);
        let noise = rng.uniform(circuit::NOISE);
        let (dead, stuck) = faulty(rng);
        for [row, col] in dead.iter().copied().chain(stuck.iter().map(|&[row, col, _]| [row, col])) {
            gain[row * TAXEL_COLS + col] = 0.0;
        }
        let idle_counts = rng.uniform(circuit::IDLE_COUNTS);
        let mains_counts = rng.between(0.0, 0.5);
        let residual = Box::new(std::array::from_fn(|_| circuit::TRIMMED_CODES * rng.normal()));
        Self {
            gain,
            dead,
            stuck,
            gain_length_mm,
            exponent: EXPONENT + rng.between(-EXPONENT_SPREAD, EXPONENT_SPREAD),
            mains_counts,
            lag_s: rng.log_between(0.5e-3, 5e-3),
            scan_s: rng.between(2e-3, 4.1e-3),
            creep: Creep {
                per_decade: rng.between(0.01, 0.05),
                slowdown: rng.between(1.5, 4.0),
                residual: rng.between(0.03, 0.15),
            },
            hysteresis: rng.between(0.02, 0.08),
            circuit: Circuit::draw(rng, noise, idle_counts, residual),
            per_degree: rng.sign() * rng.between(0.002, 0.005),
            ageing: rng.between(0.0, 0.15),
        }
    }
}

/// Factor of each taxel: a field of covariance `exp(−d²/2L²)`, cosines of Gaussian wave vectors, and its own part.
fn gain_map(rng: &mut Rng, length_mm: f64) -> Box<[f64; TAXELS]> {
    const WAVES: usize = 24;
    let waves: [_; WAVES] =
        std::array::from_fn(|_| (rng.normal() / length_mm, rng.normal() / length_mm, rng.phase()));
    let amplitude = GAIN_SMOOTH * (2.0 / WAVES as f64).sqrt();
    let mut gain = Box::new([0.0; TAXELS]);
    for (cell, gain) in gain.iter_mut().enumerate() {
        let (x, y) = cell_mm(cell);
        let smooth: f64 = waves.iter().map(|(kx, ky, phase)| cos(kx * x + ky * y + phase)).sum();
        *gain = (1.0 + amplitude * smooth + GAIN_OWN * rng.normal()).max(0.2);
    }
    gain
}

/// Taxels that are dead, and those, one in ten, that are stuck at a level instead.
fn faulty(rng: &mut Rng) -> (Vec<[usize; 2]>, Vec<[usize; 3]>) {
    let (mut dead, mut stuck) = (Vec::new(), Vec::new());
    let share = rng.between(0.0, 0.01);
    for cell in 0..TAXELS {
        let (row, col) = (cell / TAXEL_COLS, cell % TAXEL_COLS);
        if !rng.chance(share) || !is_active(row, col) {
            continue;
        }
        if rng.chance(0.1) {
            stuck.push([row, col, rng.log_between(3.0, 25.0).round() as usize]);
        } else {
            dead.push([row, col]);
        }
    }
    (dead, stuck)
}
