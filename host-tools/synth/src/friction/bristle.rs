//! One elastic bristle with memory (C. Canudas de Wit and others 1995, "LuGre"): `dz/dt = v − σ₀|v|z / g(v)`, friction
//! `σ₀z + σ₂v`, where `g` falls from static to kinetic friction with speed.

use libm::exp;
use serde::Serialize;

use super::patch::{Law, Moved, frictions, size};
use super::{SLIDING_MM_S, STEP_S, Springs};
use crate::draw::{Draw, Rng};
use crate::objects::Object;

#[derive(Serialize)]
pub(super) struct Bristle {
    mu_static: f64,
    mu_kinetic: f64,
    /// Kinetic friction over the stretch at which it is reached under 1 N.
    stiffness_n_per_mm: f64,
    /// Speed over which friction falls.
    stribeck_mm_s: f64,
    /// Viscous part of the friction at 1 N, N s/mm.
    viscous: f64,
    #[serde(skip)]
    stretch_mm: [f64; 3],
    #[serde(skip)]
    speed_mm_s: f64,
}

impl Bristle {
    pub fn draw(rng: &mut Rng, object: &Object) -> Self {
        let (mu_static, mu_kinetic) = frictions(rng, object);
        Self {
            mu_static,
            mu_kinetic,
            stiffness_n_per_mm: mu_kinetic / rng.log_between(0.01, 0.15),
            stribeck_mm_s: rng.log_between(0.3, 8.0),
            viscous: rng.log_between(2e-3, 2e-2),
            stretch_mm: [0.0; 3],
            speed_mm_s: 0.0,
        }
    }
}

impl Law for Bristle {
    fn step(&mut self, springs: &Springs, load_n: f64) -> Moved {
        let (k, viscous) = (self.stiffness_n_per_mm, self.viscous * load_n);
        let mut v = [0.0; 3];
        let (mut speed, mut most_n, mut relax) = (self.speed_mm_s, 0.0, 1.0);
        // The bristle's relaxation depends on the speed that is looked for.
        for _ in 0..4 {
            let over = speed / self.stribeck_mm_s;
            let mu = self.mu_kinetic + (self.mu_static - self.mu_kinetic) * exp(-over * over);
            most_n = mu * load_n;
            relax = 1.0 / (1.0 + STEP_S * k * speed / most_n);
            v = std::array::from_fn(|axis| match springs.stiffness[axis] {
                0.0 => 0.0,
                pull => {
                    let pulled = pull * springs.stretch[axis] - k * relax * self.stretch_mm[axis];
                    pulled / (pull * STEP_S + k * relax * STEP_S + viscous)
                }
            });
            speed = 0.5 * (speed + size(v));
        }
        self.speed_mm_s = size(v);
        self.stretch_mm = std::array::from_fn(|axis| relax * (self.stretch_mm[axis] + v[axis] * STEP_S));
        let held_n = k * size(self.stretch_mm);
        let share = (held_n / most_n).min(1.0);
        Moved {
            by_mm: v.map(|v| v * STEP_S),
            force_n: std::array::from_fn(|axis| k * self.stretch_mm[axis] + viscous * v[axis]),
            sliding: if self.speed_mm_s > SLIDING_MM_S { share } else { 0.0 },
        }
    }

    fn rest(&mut self) {
        (self.stretch_mm, self.speed_mm_s) = ([0.0; 3], 0.0);
    }
}
