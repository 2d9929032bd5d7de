//! How an object rocks in the grip without slipping: slowly by itself, and with the grip force.

use libm::sin;
use serde::Serialize;

use crate::draw::{Draw, Rng};

/// Slow sway about both axes, and a tilt that follows the force.
#[derive(Serialize)]
pub(crate) struct Rocking {
    /// Frequency in Hz, slope and phase of two sines about each axis.
    wander: [(f64, f64, f64); 4],
    with_force: [f64; 2],
}

impl Rocking {
    pub(crate) fn draw(rng: &mut Rng) -> Self {
        Self {
            wander: std::array::from_fn(|_| {
                (rng.log_between(0.2, 3.0), rng.log_between(0.2e-3, 2e-3), rng.phase())
            }),
            with_force: [0.002 * rng.normal(), 0.002 * rng.normal()],
        }
    }

    /// Slopes at time `t` under `excess` = F / F at the start of the grip − 1.
    pub(crate) fn at(&self, t: f64, excess: f64) -> [f64; 2] {
        std::array::from_fn(|axis| {
            let wander = self.wander[2 * axis..2 * axis + 2]
                .iter()
                .map(|(hz, slope, phase)| slope * sin(std::f64::consts::TAU * hz * t + phase));
            wander.sum::<f64>() + self.with_force[axis] * excess
        })
    }
}
