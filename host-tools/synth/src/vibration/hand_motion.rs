//! What carries the finger: gravity in a drawn orientation, and the slow motion of a hand that holds the
//! gripper. It moves the finger as a whole, so it does not pass the modes.

use serde::Serialize;
use slipsense::params::MAX_SENSORS;

use super::scene::{Motion, Scene, at};
use super::signal::{add_scaled, sin_turns};
use crate::draw::{Draw, Rng, Span};
use crate::friction::STEP_HZ;
use crate::timeline::Pulse;

/// Sway of a hand: components, which share its peak.
const SWAYS: usize = 3;

#[derive(Clone, Debug, Serialize)]
struct Sway {
    hz: f64,
    peak_g: f64,
    /// Turns.
    phase: f64,
    direction: [f64; 3],
}

#[derive(Clone, Debug, Serialize)]
pub(crate) struct HandMotion {
    /// At rest the part feels this, g.
    gravity: [f64; 3],
    sways: Vec<Sway>,
    /// First and last footfall in seconds, cadence in Hz.
    walk: Option<(f64, f64, f64)>,
    #[serde(skip)]
    footfalls: Vec<Pulse>,
}

impl HandMotion {
    pub(crate) fn draw(rng: &mut Rng, scene: &Scene<'_>) -> Self {
        let mut motion =
            Self { gravity: rng.direction(), sways: Vec::new(), walk: None, footfalls: Vec::new() };
        if !scene.hand_held {
            return motion;
        }
        let sway_g = rng.log_between(0.03, 0.5) / SWAYS as f64;
        let sway = |rng: &mut Rng, hz: Span, peak_g: f64| Sway {
            hz: rng.log_uniform(hz),
            peak_g,
            phase: rng.between(0.0, 1.0),
            direction: rng.direction(),
        };
        motion.sways.extend((0..SWAYS).map(|_| sway(rng, (0.2, 3.0), sway_g)));
        let tremor_g = rng.log_between(0.005, 0.03);
        motion.sways.push(sway(rng, (8.0, 12.0), tremor_g));
        // The person walks for a part of the recording.
        if rng.chance(0.3) {
            let seconds = scene.timeline.grip_n.len() as f64 / STEP_HZ;
            let from = rng.between(0.0, 0.7 * seconds);
            let to = rng.between(from, seconds);
            let cadence_hz = rng.between(1.5, 2.1);
            motion.walk = Some((from, to, cadence_hz));
            let peak_g = rng.log_between(0.03, 0.3);
            let mut at_s = from;
            while at_s < to {
                let off = rng.direction();
                motion.footfalls.push(Pulse {
                    at_s,
                    width_s: rng.log_between(0.015, 0.04),
                    peak_g: peak_g * rng.between(0.6, 1.4),
                    direction: std::array::from_fn(|a| motion.gravity[a] + 0.3 * off[a]),
                    share: [1.0; MAX_SENSORS],
                });
                at_s += rng.between(0.93, 1.07) / cadence_hz;
            }
        }
        motion
    }

    pub(crate) fn add_gravity(&self, motion: &mut Motion) {
        motion.g.iter_mut().for_each(|g| add_scaled(g, 1.0, self.gravity));
    }

    pub(crate) fn add(&self, scene: &Scene<'_>, motion: &mut Motion) {
        motion.add_pulses(&self.footfalls, 1.0);
        if self.sways.is_empty() {
            return;
        }
        for (t, g) in motion.samples() {
            let vigour = at(&scene.timeline.motion, t);
            for sway in &self.sways {
                add_scaled(g, vigour * sway.peak_g * sin_turns(sway.hz * t + sway.phase), sway.direction);
            }
        }
    }
}
