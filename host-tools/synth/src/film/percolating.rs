//! A film of conducting grains: conductance by the logarithm of pressure above a threshold, which a load lowers for a while.

use libm::{exp, log};
use serde::Serialize;
use slipsense::params::FRAME_RATE_HZ;
use slipsense_recording::film::FULL_SCALE_KPA;

use crate::draw::{Draw, Rng};

/// Load that lowers the threshold half as far as it goes.
const HALF_LOWERED_KPA: f64 = 30.0;

#[derive(Serialize)]
pub(super) struct Percolating {
    threshold_kpa: f64,
    /// Pressure above the threshold at which the logarithm bends.
    bend_kpa: f64,
    /// Share of the threshold that a firm load takes away.
    lowered: f64,
    /// Share of the lowering that is left after a frame; it lasts for 0.5 to 20 s.
    forgets: f64,
    /// Conductance at full scale, share of a nominal taxel's.
    full_scale: f64,
}

impl Percolating {
    pub fn draw(rng: &mut Rng) -> Self {
        Self {
            threshold_kpa: rng.log_between(0.5, 8.0),
            bend_kpa: rng.log_between(80.0, 500.0),
            lowered: rng.between(0.2, 0.7),
            forgets: exp(-1.0 / (rng.log_between(0.5, 20.0) * FRAME_RATE_HZ as f64)),
            full_scale: rng.log_between(0.1, 0.4),
        }
    }

    /// Conductance of a taxel of gain 1 after a frame of `kpa`; `peak_kpa` is the load that it remembers.
    pub fn conductance(&self, peak_kpa: &mut f64, kpa: f64) -> f64 {
        *peak_kpa = (*peak_kpa * self.forgets).max(kpa);
        let lowered = self.lowered * *peak_kpa / (*peak_kpa + HALF_LOWERED_KPA);
        let above = (kpa - self.threshold_kpa * (1.0 - lowered)).max(0.0);
        self.full_scale * log(1.0 + above / self.bend_kpa) / log(1.0 + FULL_SCALE_KPA / self.bend_kpa)
    }
}
