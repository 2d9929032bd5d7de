//! One sensor as built: what differs from unit to unit, drawn once per episode and sensor.

use libm::{cos, sin};
use slipsense::params::TAXELS;

use crate::accelerometer::XlUnit;
use crate::contact::cell_mm;
use crate::draw::{Draw, Rng};
use crate::recipe::Platform;
use crate::vibration::Modes;

/// A unit's draws.
pub(crate) struct Unit {
    pub film: FilmUnit,
    pub modes: Modes,
    pub xl: XlUnit,
}

/// Array and readout.
pub(crate) struct FilmUnit {
    /// Factor on the conductance of each taxel; 0 for dead ones.
    pub gain: Box<[f64; TAXELS]>,
    /// Idle reading, counts.
    pub offset: Box<[f64; TAXELS]>,
    /// Exponent of conductance over pressure.
    pub exponent: f64,
    /// Electrical noise, counts rms.
    pub noise_counts: f64,
    /// Time constant of the film, seconds.
    pub lag_s: f64,
    /// Duration of one scan, seconds.
    pub scan_s: f64,
    /// Share of the row's and of the column's mean that leaks into a taxel.
    pub crosstalk: f64,
    /// Weight and time constant in seconds of the creep terms.
    pub creep: [(f64, f64); 2],
}

impl Unit {
    /// `noise` scales the electrical noise of the array.
    pub(crate) fn draw(rng: &mut Rng, noise: f64, platform: Platform) -> Self {
        Self { film: FilmUnit::draw(rng, noise), modes: Modes::draw(rng, platform), xl: XlUnit::draw(rng) }
    }
}

impl FilmUnit {
    fn draw(rng: &mut Rng, noise: f64) -> Self {
        // A smooth map of ±15 % with a correlation of 5–10 mm, and 5 % of its own for each taxel.
        let waves: [_; 4] = std::array::from_fn(|_| {
            let (k, angle) = (std::f64::consts::TAU / rng.between(12.0, 30.0), rng.phase());
            (k * cos(angle), k * sin(angle), rng.phase())
        });
        let mut gain = Box::new([0.0; TAXELS]);
        let mut offset = Box::new([0.0; TAXELS]);
        let level = rng.between(0.0, 0.5);
        let dead = rng.between(0.0, 0.01);
        for cell in 0..TAXELS {
            let (x, y) = cell_mm(cell);
            let smooth: f64 = waves.iter().map(|(kx, ky, phase)| cos(kx * x + ky * y + phase)).sum();
            let own = 1.0 + 0.053 * smooth + 0.05 * rng.normal();
            gain[cell] = if rng.chance(dead) { 0.0 } else { own.max(0.2) };
            offset[cell] = (level + 0.1 * rng.normal()).clamp(0.0, 0.8);
        }
        Self {
            gain,
            offset,
            exponent: rng.between(0.94, 1.0),
            noise_counts: rng.between(0.25, 0.6) * noise,
            lag_s: rng.log_between(0.5e-3, 5e-3),
            scan_s: rng.between(2e-3, 4.1e-3),
            crosstalk: rng.log_between(0.001, 0.005),
            creep: [(rng.between(0.002, 0.008), 0.1), (rng.between(0.002, 0.008), 1.0)],
        }
    }
}
