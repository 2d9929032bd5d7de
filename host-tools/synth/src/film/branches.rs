//! A film that loads along one power law and unloads from its peak along a flatter one; it forgets the peak.

use libm::{exp, pow};
use serde::Serialize;
use slipsense::params::FRAME_RATE_HZ;
use slipsense_recording::film::FULL_SCALE_KPA;

use super::curve::Curve;
use crate::draw::{Draw, Rng};

#[derive(Serialize)]
pub(super) struct Branches {
    /// Of the conductance over pressure, loading; unloading it is less by `flatter`.
    exponent: f64,
    flatter: f64,
    /// Conductance at full scale, share of a nominal taxel's.
    full_scale: f64,
    /// Share of the peak that is left after a frame; it lasts for 0.3 to 10 s.
    keeps: f64,
    #[serde(skip)]
    loading: Curve,
    #[serde(skip)]
    lift: Curve,
}

impl Branches {
    pub fn draw(rng: &mut Rng) -> Self {
        let exponent = rng.between(0.8, 1.1);
        let flatter = rng.between(0.02, 0.12);
        Self {
            exponent,
            flatter,
            full_scale: rng.between(0.6, 1.2),
            keeps: exp(-1.0 / (rng.log_between(0.3, 10.0) * FRAME_RATE_HZ as f64)),
            loading: Curve::tabulate(|kpa| pow(kpa / FULL_SCALE_KPA, exponent)),
            lift: Curve::tabulate(|ratio| pow(ratio, flatter)),
        }
    }

    /// Conductance of a taxel of gain 1 after a frame of `kpa`; `peak_kpa` is the load that it remembers.
    pub fn conductance(&self, peak_kpa: &mut f64, kpa: f64) -> f64 {
        *peak_kpa = (*peak_kpa * self.keeps).max(kpa);
        if kpa <= 0.0 {
            return 0.0;
        }
        // (p/peak)^(m − flatter) of the peak's own conductance.
        self.full_scale * self.loading.at(kpa) * self.lift.at(*peak_kpa / kpa)
    }
}
