//! The crosshead's drive at the accelerometers: a comb whose frequency follows the speed, through
//! the clamped object or through the table, and the hum of a stepper that holds its position.

use serde::Serialize;

use super::scene::{Motion, Scene, TOUCHED_N};
use super::signal::{Harmonics, add_scaled, sin_turns};
use crate::draw::{Draw, Rng};
use crate::friction::STEP_HZ;

/// Lines of the comb; the k-th is 1/k as strong.
const ORDERS: usize = 5;
/// Below this speed the comb fades, mm/s.
const FADES_BELOW_MM_S: f64 = 0.5;
/// Grip from which the object transmits as well as it ever does, N.
const CLAMPED_N: f64 = 0.5;
/// Lines above this are beyond the part's bandwidth, Hz.
const HIGHEST_HZ: f64 = 3_600.0;
/// Direction, unit vector: mostly along the pull.
const DIRECTION: [f64; 3] = [0.188, 0.941, 0.282];

#[derive(Clone, Debug, Serialize)]
pub(crate) struct Rig {
    /// Fundamental per mm of travel: 20–400 Hz at 10 mm/s. Screw lead and steps of the paper's rig are not published.
    pub per_mm: f64,
    /// Level at the accelerometer through the clamped object and through the table, g rms of the vector.
    pub object_g: f64,
    pub table_g: f64,
    pub comb: Harmonics,
    /// Hum of the drive at standstill, through the table: level, g rms, 0 of half of them, frequency, Hz, phase, turns.
    pub hum: (f64, f64, f64),
}

impl Rig {
    pub(crate) fn draw(rng: &mut Rng) -> Self {
        Self {
            per_mm: rng.log_between(2.0, 40.0),
            object_g: rng.log_between(0.2e-3, 4e-3),
            table_g: rng.log_between(0.05e-3, 0.5e-3),
            comb: Harmonics::draw(rng, (1..=ORDERS).map(|k| 1.0 / k as f64)),
            hum: (
                if rng.chance(0.5) { 1.0 } else { 0.0 } * rng.log_between(0.02e-3, 0.2e-3),
                rng.log_between(400.0, 2000.0),
                rng.between(0.0, 1.0),
            ),
        }
    }

    /// Add to the acceleration at the part: the comb, at its level there, does not pass the finger's modes.
    pub(crate) fn add(&self, scene: &Scene<'_>, motion: &mut Motion) {
        if scene.hand_held {
            return;
        }
        let last = scene.timeline.crosshead_mm.len() - 1;
        for (t, out) in motion.samples() {
            let x = (t * STEP_HZ).min(last as f64);
            let step = (x as usize).min(last.saturating_sub(1));
            let [from, to] =
                [scene.timeline.crosshead_mm[step], scene.timeline.crosshead_mm[(step + 1).min(last)]];
            let speed = (to - from).abs() * STEP_HZ;
            let mut value = 0.0;
            if speed > 1e-6 {
                let travel = (from + (to - from) * (x - step as f64)) * self.per_mm;
                let clamped = if scene.shared_table {
                    1.0
                } else if scene.linked {
                    ((scene.timeline.grip_n[step] - TOUCHED_N) / CLAMPED_N).clamp(0.0, 1.0)
                } else {
                    0.0
                };
                let gain = self.table_g + (self.object_g - self.table_g) * clamped;
                // A slow crosshead has all lines below the limit, whatever the quotient.
                let audible = (HIGHEST_HZ / (self.per_mm * speed)).min(ORDERS as f64) as usize;
                value = self.comb.at(travel, &[1.0; ORDERS][..audible]);
                value *= gain * (speed / FADES_BELOW_MM_S).min(1.0);
            } else if self.hum.0 > 0.0 {
                value = self.hum.0 * std::f64::consts::SQRT_2 * sin_turns(self.hum.1 * t + self.hum.2);
            }
            add_scaled(out, value, DIRECTION);
        }
    }
}
