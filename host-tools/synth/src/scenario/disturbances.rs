//! Disturbances that come at any time: taps, footfalls, tools nearby, trigger play, motion of the hand,
//! and, while an object is held, grip changes, rolling and dragging.

use crate::draw::{Draw, Rng};
use crate::scenario::levels::*;
use crate::timeline::{Timeline, ramp};

/// Cuts off the longest gaps: see [`Draw::exponential`].
pub(super) const LEAST: f64 = 1e-12;

#[derive(Clone, Copy)]
pub(crate) struct Disturbances {
    pub motors: bool,
    /// A hand or an arm carries the gripper.
    pub carried: bool,
    /// The held object hangs on nothing and may be dragged over something.
    pub loose: bool,
    pub factor: f64,
}

impl Disturbances {
    /// What comes at any time of the recording.
    pub(crate) fn anywhere(&self, rng: &mut Rng, timeline: &mut Timeline, seconds: f64) {
        let whole = (0.0, seconds);
        for at in rng.moments(whole, self.factor * TAPS_PER_S, LEAST) {
            taps(rng, timeline, at);
        }
        // Who carries the gripper has steps of their own.
        let passers = if self.carried { 0.0 } else { FOOTFALLS_PER_S };
        for at in rng.moments(whole, self.factor * passers, LEAST) {
            // A person walks by: a few steps.
            let (steps, every) = (rng.count(2, 6), rng.between(0.45, 0.7));
            for step in 0..steps {
                timeline.pulse(rng, at + every * step as f64, FOOTFALL_S, FOOTFALL_G);
            }
            timeline.event("ambient", at, at + every * steps as f64);
        }
        for at in rng.moments(whole, self.factor * AMBIENT_PER_S, LEAST) {
            let (lasts, level) = (rng.log_between(0.5, 6.0), rng.between(0.2, 1.0));
            timeline.swell("ambient", |timeline| &mut timeline.ambient, (at, at + lasts), level, 0.1);
        }
        for at in rng.moments(whole, self.factor * JAW_PER_S, LEAST) {
            let (lasts, vigour) = (rng.log_between(0.05, 0.5), rng.between(0.2, 0.8));
            timeline.event("jaw", at, at + lasts);
            timeline.travel(rng, (at, at + lasts), vigour, self.motors);
        }
        if self.carried {
            let calm = rng.between(0.02, 0.25);
            timeline.motion.fill(calm);
            for at in rng.moments(whole, self.factor * MOTIONS_PER_S, LEAST) {
                let (lasts, level) = (rng.log_between(0.3, 2.5), rng.between(0.2, 1.0));
                timeline.swell("motion", |timeline| &mut timeline.motion, (at, at + lasts), level, 0.15);
            }
        }
    }

    /// What may come while the object is held and nothing pulls it; it stays as it has rolled until `end`.
    pub(crate) fn while_held(&self, rng: &mut Rng, timeline: &mut Timeline, held: (f64, f64), end: f64) {
        for at in rng.moments(held, self.factor * ROLLING_PER_S, LEAST) {
            let lasts = rng.log_between(0.1, 0.8);
            let slopes: [f64; 2] = std::array::from_fn(|_| rng.log_uniform(ROLL_RAD) * rng.sign());
            if at + lasts < held.1 {
                timeline.event("rolling", at, at + lasts);
                for (i, t) in timeline.times(at, end) {
                    for (roll, slope) in timeline.roll_rad[i].iter_mut().zip(slopes) {
                        *roll += slope * ramp(t, at, at + lasts);
                    }
                }
            }
        }
        if self.loose {
            for at in rng.moments(held, self.factor * DRAGS_PER_S, LEAST) {
                let (lasts, level) = (rng.log_between(0.2, 1.5), rng.between(0.3, 1.0));
                if at + lasts < held.1 {
                    timeline.swell("drag", |timeline| &mut timeline.drag, (at, at + lasts), level, 0.03);
                }
            }
        }
    }
}

/// One tap, or a train of them, on object, finger or table.
fn taps(rng: &mut Rng, timeline: &mut Timeline, mut at: f64) {
    let train = if rng.chance(TAP_TRAIN_CHANCE) { rng.count(2, 7) } else { 1 };
    for _ in 0..train {
        timeline.event("tap", at, at + TAP_S.1);
        timeline.pulse(rng, at, TAP_S, TAP_G);
        at += rng.between(0.06, 0.4);
    }
}
