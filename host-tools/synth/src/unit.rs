//! The sensors as built. There are five, drawn once from constant seeds, as a laboratory has them: two on
//! the jaws of the UMI, for all its recordings, and three others on the fingers of the Tesollo.

use libm::{cos, exp, sin};
use serde::Serialize;
use slipsense::params::{TAXELS, XL_RATE_HZ};

use crate::contact::cell_mm;
use crate::draw::{Draw, Rng, Stream, stream};
use crate::recipe::Platform;

/// Seed of the units, different from any recipe's by being no part of one.
const UNITS_SEED: u64 = 0x51f5_0001;

/// One of the sensors there are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub(crate) enum UnitId {
    #[serde(rename = "umi-a")]
    UmiA,
    #[serde(rename = "umi-b")]
    UmiB,
    #[serde(rename = "tesollo-a")]
    TesolloA,
    #[serde(rename = "tesollo-b")]
    TesolloB,
    #[serde(rename = "tesollo-c")]
    TesolloC,
}

impl UnitId {
    /// The units of a recording, in the order of its sensors: those of the platform in any order.
    pub(crate) fn mounted(rng: &mut Rng, platform: Platform, sensors: usize) -> Vec<Self> {
        let mut units = match platform {
            Platform::Umi => vec![Self::UmiA, Self::UmiB],
            Platform::Tesollo => vec![Self::TesolloA, Self::TesolloB, Self::TesolloC],
        };
        for last in (1..units.len()).rev() {
            units.swap(last, rng.count(0, last));
        }
        units.truncate(sensors);
        units
    }
}

/// What a unit is by its making.
pub(crate) struct Unit {
    pub film: FilmUnit,
    pub modes: [Mode; 4],
    pub xl: XlUnit,
    /// Factor on the vibration that reaches this accelerometer.
    pub coupling: f64,
}

impl Unit {
    /// The unit with this name; `noise` scales its electrical noise, `range_g` is how it is set.
    pub(crate) fn new(id: UnitId, noise: f64, range_g: f64) -> Self {
        let mut rng = stream(UNITS_SEED, Stream::Unit, id as usize);
        Self {
            film: FilmUnit::draw(&mut rng, noise),
            modes: modes(&mut rng),
            xl: XlUnit::draw(&mut rng, noise, XL_RATE_HZ as f64, range_g),
            coupling: exp(0.2 * rng.normal()),
        }
    }
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
