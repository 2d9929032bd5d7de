//! A mass that the spring pulls, with static and kinetic friction: stick, slip and stick-slip come from its motion.

use serde::Serialize;

use super::patch::{Law, Moved, frictions, size};
use super::{SLIDING_MM_S, STEP_S, Springs};
use crate::draw::{Draw, Rng};
use crate::objects::Object;

/// Steps of the motion within one of the physics: the stiffest pull's period has more than thirty.
const SUBSTEPS: usize = 8;
/// At rest below this speed, mm/s.
const STILL_MM_S: f64 = 1e-3;

#[derive(Serialize)]
pub(super) struct Mass {
    mu_static: f64,
    mu_kinetic: f64,
    /// What moves with the object, and the object's own.
    kg: f64,
    /// Of the pull, N s/mm.
    damping: f64,
    #[serde(skip)]
    v_mm_s: [f64; 3],
}

impl Mass {
    pub fn draw(rng: &mut Rng, object: &Object) -> Self {
        let (mu_static, mu_kinetic) = frictions(rng, object);
        let kg = rng.log_between(0.02, 0.3) + 1e-3 * object.mass_g;
        Self { mu_static, mu_kinetic, kg, damping: rng.log_between(1e-4, 5e-3), v_mm_s: [0.0; 3] }
    }
}

impl Law for Mass {
    fn step(&mut self, springs: &Springs, load_n: f64) -> Moved {
        let dt = STEP_S / SUBSTEPS as f64;
        // mm/s per newton.
        let impulse = 1e3 * dt / self.kg;
        let mut moved = Moved::default();
        let mut slid = 0;
        for _ in 0..SUBSTEPS {
            let pull_n: [f64; 3] = std::array::from_fn(|axis| {
                springs.stiffness[axis] * (springs.stretch[axis] - moved.by_mm[axis])
            });
            let free: [f64; 3] = std::array::from_fn(|axis| match springs.stiffness[axis] {
                0.0 => 0.0,
                _ => (self.v_mm_s[axis] + impulse * pull_n[axis]) / (1.0 + impulse * self.damping),
            });
            let (speed, moves) = (size(free), size(self.v_mm_s) > STILL_MM_S);
            let mu = if moves { self.mu_kinetic } else { self.mu_static };
            let kept = (1.0 - mu * load_n * impulse / speed.max(1e-12)).max(0.0);
            let before = self.v_mm_s;
            self.v_mm_s = free.map(|v| kept * v);
            for axis in 0..3 {
                moved.by_mm[axis] += self.v_mm_s[axis] * dt;
                let accelerates_n = (self.v_mm_s[axis] - before[axis]) / impulse;
                moved.force_n[axis] += (pull_n[axis] - accelerates_n) / SUBSTEPS as f64;
            }
            slid += usize::from(size(self.v_mm_s) > SLIDING_MM_S);
        }
        moved.sliding = slid as f64 / SUBSTEPS as f64;
        moved
    }

    fn rest(&mut self) {
        self.v_mm_s = [0.0; 3];
    }
}
