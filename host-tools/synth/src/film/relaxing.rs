//! A film whose conductance relaxes: a share follows at once, two with time constants of rise and fall; all fluctuates.

use libm::{exp, pow};
use serde::Serialize;
use slipsense::params::FRAME_RATE_HZ;
use slipsense_recording::film::FULL_SCALE_KPA;

use crate::draw::{Draw, Rng};

#[derive(Serialize)]
pub(super) struct Relaxing {
    /// Of the slower elements, and what one frame takes of their distance to the load, rising and falling.
    shares: [f64; 2],
    rise: [f64; 2],
    fall: [f64; 2],
    /// Of the conductance over pressure.
    exponent: f64,
    /// Conductance at full scale, share of a nominal taxel's.
    full_scale: f64,
    /// Of the gain: relative rms and its pace.
    fluctuation: f64,
    pace: f64,
    #[serde(skip)]
    gain: f64,
}

impl Relaxing {
    pub fn draw(rng: &mut Rng) -> Self {
        let blend = |tau_s: f64| 1.0 - exp(-1.0 / (tau_s * FRAME_RATE_HZ as f64));
        let slowdown = rng.between(1.0, 2.0);
        // Under load.
        let tau_s = [(0.02, 0.15), (0.2, 1.0)].map(|span| rng.log_uniform(span));
        Self {
            shares: [(0.05, 0.3), (0.01, 0.1)].map(|span| rng.uniform(span)),
            rise: tau_s.map(blend),
            fall: tau_s.map(|tau| blend(tau * slowdown)),
            exponent: rng.between(0.85, 1.05),
            full_scale: rng.log_between(0.4, 1.0),
            fluctuation: rng.between(0.0, 0.01),
            pace: blend(rng.log_between(0.3, 5.0)),
            gain: 0.0,
        }
    }

    /// Once a frame, before its taxels.
    pub fn advance(&mut self, rng: &mut Rng) {
        self.gain += self.pace * (rng.normal() * (2.0 / self.pace).sqrt() - self.gain);
    }

    /// Conductance of a taxel of gain 1 after a frame of `kpa`.
    pub fn conductance(&self, state: &mut [f64; 2], kpa: f64) -> f64 {
        let mut shown = kpa;
        for (i, state) in state.iter_mut().enumerate() {
            let blend = if kpa > *state { self.rise[i] } else { self.fall[i] };
            *state += blend * (kpa - *state);
            shown += self.shares[i] * (*state - kpa);
        }
        let gain = self.full_scale * (1.0 + self.fluctuation * self.gain);
        gain * pow(shown.max(0.0) / FULL_SCALE_KPA, self.exponent)
    }
}
