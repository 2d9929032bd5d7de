//! One sensor as built: what differs from unit to unit, drawn once per episode and sensor.

use libm::exp;

use crate::draw::{Draw, Rng};
use crate::film::FilmUnit;

/// A unit's draws.
pub(crate) struct Unit {
    pub film: FilmUnit,
    pub modes: [Mode; 4],
    pub xl: XlUnit,
    /// Factor on the vibration that reaches this accelerometer.
    pub coupling: f64,
}

/// One mode of the finger's structure.
#[derive(Clone, Copy)]
pub(crate) struct Mode {
    pub hz: f64,
    pub damping: f64,
    pub direction: [f64; 3],
    pub weight: f64,
}

/// Accelerometer.
pub(crate) struct XlUnit {
    /// From finger axes to sensor axes: mounting rotation, gain errors and cross-axis terms together.
    pub matrix: [[f64; 3]; 3],
    /// Offset, g.
    pub bias_g: [f64; 3],
    /// Noise density, g/√Hz.
    pub noise_g: f64,
    /// Corner of the part's own low-pass, Hz.
    pub bandwidth_hz: f64,
    /// Actual rate, Hz.
    pub rate_hz: f64,
    /// Full scale, g.
    pub range_g: f64,
}

impl Unit {
    /// `noise` scales the electrical noise; `nominal_rate_hz` and `range_g` are the accelerometer's.
    pub(crate) fn draw(rng: &mut Rng, noise: f64, nominal_rate_hz: f64, range_g: f64) -> Self {
        Self {
            film: FilmUnit::draw(rng),
            modes: modes(rng),
            xl: XlUnit::draw(rng, noise, nominal_rate_hz, range_g),
            coupling: exp(0.2 * rng.normal()),
        }
    }
}

/// Modes of a parallel-jaw finger, with directions and weights of their own.
fn modes(rng: &mut Rng) -> [Mode; 4] {
    [(80.0, 180.0), (250.0, 550.0), (700.0, 1500.0), (2200.0, 3500.0)].map(|(lo, hi)| Mode {
        hz: rng.log_between(lo, hi),
        damping: rng.log_between(0.03, 0.12),
        direction: rng.direction(),
        weight: rng.log_between(0.4, 1.2),
    })
}

impl XlUnit {
    fn draw(rng: &mut Rng, noise: f64, nominal_rate_hz: f64, range_g: f64) -> Self {
        let rotation = rotation(rng);
        let mut matrix = [[0.0; 3]; 3];
        let gain: [f64; 3] = std::array::from_fn(|_| 1.0 + 0.02 * rng.between(-1.0, 1.0));
        let cross = rng.between(-0.015, 0.015);
        for (axis, row) in matrix.iter_mut().enumerate() {
            for (from, value) in row.iter_mut().enumerate() {
                *value = gain[axis] * (rotation[axis][from] + cross * rotation[(axis + 1) % 3][from]);
            }
        }
        Self {
            matrix,
            bias_g: std::array::from_fn(|_| rng.between(-0.05, 0.05)),
            noise_g: rng.log_between(30e-6, 150e-6) * noise,
            bandwidth_hz: rng.between(2_400.0, 3_600.0),
            rate_hz: nominal_rate_hz * (1.0 + rng.between(-0.01, 0.01)),
            range_g,
        }
    }
}

/// A rotation drawn uniformly: two random directions made orthogonal, and their cross product.
fn rotation(rng: &mut Rng) -> [[f64; 3]; 3] {
    let a = rng.direction();
    let b = rng.direction();
    let dot: f64 = a.iter().zip(&b).map(|(x, y)| x * y).sum();
    let mut c = [b[0] - dot * a[0], b[1] - dot * a[1], b[2] - dot * a[2]];
    let norm = c.iter().map(|x| x * x).sum::<f64>().sqrt().max(1e-9);
    c.iter_mut().for_each(|x| *x /= norm);
    let d = [a[1] * c[2] - a[2] * c[1], a[2] * c[0] - a[0] * c[2], a[0] * c[1] - a[1] * c[0]];
    [a, c, d]
}
