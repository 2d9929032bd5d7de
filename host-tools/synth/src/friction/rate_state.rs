//! Friction by rate and state (J. H. Dieterich 1979, regularised after J. R. Rice):
//! `μ = a·asinh(v/2v₀ · e^{(μ₀ + b ln(v₀θ/D))/a})` with the age of the contacts `dθ/dt = 1 − vθ/D`. Nothing ever sticks: a load makes it creep.

use libm::{asinh, exp, log};
use serde::Serialize;

use super::patch::{Law, Moved, frictions, size};
use super::{STEP_S, Springs};
use crate::draw::{Draw, Rng};
use crate::objects::Object;

/// Speed at which μ₀ holds, mm/s.
const REFERENCE_MM_S: f64 = 0.1;
/// Speed at which half of the load counts as sliding, mm/s.
const HALF_SLIDING_MM_S: f64 = 0.03;

#[derive(Serialize)]
pub(super) struct RateState {
    mu: f64,
    /// Direct effect a; below it b, the ageing effect, drawn as its difference from a.
    direct: f64,
    ageing: f64,
    /// Slip over which the contacts are renewed.
    renewal_mm: f64,
    /// Damping at 1 N, N s/mm.
    viscous: f64,
    /// θ, seconds.
    #[serde(skip)]
    age_s: f64,
}

impl RateState {
    pub fn draw(rng: &mut Rng, object: &Object) -> Self {
        let direct = rng.between(0.01, 0.03);
        Self {
            mu: frictions(rng, object).1,
            direct,
            ageing: direct + rng.between(-0.005, 0.02),
            renewal_mm: rng.log_between(0.005, 0.08),
            viscous: rng.log_between(5e-4, 5e-3),
            age_s: 1.0,
        }
    }
}

impl Law for RateState {
    fn step(&mut self, springs: &Springs, load_n: f64) -> Moved {
        let pull_n: [f64; 3] = std::array::from_fn(|axis| springs.stiffness[axis] * springs.stretch[axis]);
        let most_n = size(pull_n);
        if most_n < 1e-9 {
            self.age_s += STEP_S;
            return Moved::default();
        }
        let towards = pull_n.map(|n| n / most_n);
        let stiffness: f64 = (0..3).map(|axis| towards[axis] * towards[axis] * springs.stiffness[axis]).sum();
        let state = self.mu + self.ageing * log(REFERENCE_MM_S * self.age_s / self.renewal_mm);
        let scale = exp(state / self.direct) / (2.0 * REFERENCE_MM_S);
        let friction = |v: f64| load_n * (self.direct * asinh(v * scale) + self.viscous * v);
        // What the spring has left falls with the speed, what friction asks rises: halve the logarithm between them.
        let (mut low, mut high) = (log(1e-9), log(2e3));
        for _ in 0..40 {
            let middle = (low + high) / 2.0;
            let v = exp(middle);
            if most_n - stiffness * v * STEP_S > friction(v) { low = middle } else { high = middle }
        }
        let v = exp(low);
        self.age_s = (self.age_s + STEP_S) / (1.0 + v * STEP_S / self.renewal_mm);
        let force_n = friction(v);
        Moved {
            by_mm: towards.map(|t| t * v * STEP_S),
            force_n: towards.map(|t| t * force_n),
            sliding: v * v / (v * v + HALF_SLIDING_MM_S * HALF_SLIDING_MM_S),
        }
    }

    fn rest(&mut self) {
        self.age_s = 1.0;
    }
}
