//! From acceleration to samples: mounting, gain, bandwidth, noise, clock, clipping, resolution.

use libm::exp;
use slipsense::sensor::XlSample;

use crate::draw::{Draw, Rng};
use crate::unit::XlUnit;

/// Samples of one part: `motion_g` holds the acceleration in finger axes at the part's own sample times.
pub(crate) fn sample(unit: &XlUnit, lsb_g: f64, motion_g: &[[f64; 3]], rng: &mut Rng) -> Vec<XlSample> {
    let blend = 1.0 - exp(-std::f64::consts::TAU * unit.bandwidth_hz / unit.rate_hz);
    let noise = unit.noise_g * (unit.rate_hz / 2.0).sqrt();
    let mut state: Option<[f64; 3]> = None;
    motion_g
        .iter()
        .map(|g| {
            let seen: [f64; 3] = unit.matrix.map(|row| row[0] * g[0] + row[1] * g[1] + row[2] * g[2]);
            let state = state.get_or_insert(seen);
            std::array::from_fn(|axis| {
                state[axis] += blend * (seen[axis] - state[axis]);
                let value = state[axis] + unit.bias_g[axis] + noise * rng.normal();
                let clipped = value.clamp(-unit.range_g, unit.range_g);
                (clipped / lsb_g).round().clamp(-32768.0, 32767.0) as i16
            })
        })
        .collect()
}

/// Samples available at the end of each frame, by the part's own clock. `start` is the fraction of a
/// sample period by which its first sample comes after the first tick's period begins, 0–1.
pub(crate) fn ends(unit: &XlUnit, start: f64, frames: usize, frame_rate_hz: f64) -> Vec<u32> {
    (1..=frames)
        .map(|f| {
            let periods = f as f64 / frame_rate_hz * unit.rate_hz - start;
            (periods.floor() + 1.0).max(0.0) as u32
        })
        .collect()
}
