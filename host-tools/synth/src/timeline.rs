//! The series and impacts a scenario is written into: grip force, crosshead, jaws, knocks.

use libm::sin;
use serde::Serialize;
use slipsense::params::MAX_SENSORS;

use crate::draw::{Draw, Rng};
use crate::friction::STEP_HZ;
use crate::vibration::{TAP_PEAK_G, TAP_WIDTH_S};

/// Something that happens, for the manifest in the episode's metadata.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Event {
    /// `close`, `grip_change`, `move`, `tap`, `drag`, `lift`, `set_down` or `open`.
    pub name: &'static str,
    /// Start, seconds from the start of the episode.
    pub start_s: f64,
    /// End, seconds.
    pub end_s: f64,
}

/// A half-sine of acceleration at the fingers' roots.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pulse {
    pub at_s: f64,
    pub width_s: f64,
    pub peak_g: f64,
    pub direction: [f64; 3],
    /// How much of it reaches each sensor.
    pub share: [f64; MAX_SENSORS],
}

/// Series at [`STEP_HZ`] and a list of impacts.
pub(crate) struct Timeline {
    /// Grip force of one finger, newtons.
    pub grip_n: Vec<f64>,
    /// Crosshead position, mm.
    pub crosshead_mm: Vec<f64>,
    /// Jaw motion, 0 at rest to 1.
    pub jaw: Vec<f64>,
    /// Dragging of the object over something else, 0–1.
    pub drag: Vec<f64>,
    pub pulses: Vec<Pulse>,
    pub events: Vec<Event>,
}

/// Weakest and firmest grip after changes, newtons.
const GRIP_N: (f64, f64) = (0.4, 12.0);

/// 0 before `from`, 1 after `to`, smooth between.
fn ramp(t: f64, from: f64, to: f64) -> f64 {
    let x = ((t - from) / (to - from).max(1e-6)).clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}

impl Timeline {
    pub(crate) fn new(seconds: f64) -> Self {
        // One step more than the last tick needs.
        let steps = (seconds * STEP_HZ).ceil() as usize + 1;
        Self {
            grip_n: vec![0.0; steps],
            crosshead_mm: vec![0.0; steps],
            jaw: vec![0.0; steps],
            drag: vec![0.0; steps],
            pulses: Vec::new(),
            events: Vec::new(),
        }
    }

    pub(crate) fn steps(&self) -> usize {
        self.grip_n.len()
    }

    pub(crate) fn event(&mut self, name: &'static str, start_s: f64, end_s: f64) {
        // Milliseconds are enough to find it, and short decimals survive JSON to the bit.
        let [start_s, end_s] = [start_s, end_s].map(|t| (t * 1e3).round() / 1e3);
        self.events.push(Event { name, start_s, end_s });
    }

    fn times(&self) -> impl Iterator<Item = f64> + use<> {
        (0..self.steps()).map(|i| i as f64 / STEP_HZ)
    }

    fn pulse(&mut self, rng: &mut Rng, at_s: f64, width_s: f64, peak_g: f64) {
        self.pulses.push(Pulse {
            at_s,
            width_s,
            peak_g,
            direction: rng.direction(),
            share: std::array::from_fn(|_| rng.between(0.4, 1.0)),
        });
    }

    /// The jaws move; the vibration makes rail friction and clicks of it.
    fn travel(&mut self, rng: &mut Rng, from: f64, to: f64) {
        let steps = self.steps();
        let (rise, fall) = (from + 0.3 * (to - from), to - 0.1 * (to - from));
        let wobble = (rng.between(3.0, 12.0), rng.phase());
        for (i, t) in self.times().enumerate().take(steps) {
            let shape = ramp(t, from, rise) * (1.0 - ramp(t, fall, to));
            self.jaw[i] += shape * (0.75 + 0.25 * sin(std::f64::consts::TAU * wobble.0 * t + wobble.1));
        }
    }

    /// Jaws travel from `from` to `to`. What they hit then is the vibration's matter.
    pub(crate) fn close(&mut self, rng: &mut Rng, from: f64, to: f64) {
        self.event("close", from, to);
        self.travel(rng, from, to);
    }

    /// Jaws let go at `from` and travel until `to`: release knocks, ring-down, end stop.
    pub(crate) fn open(&mut self, rng: &mut Rng, from: f64, to: f64, object: bool) {
        self.event("open", from, to);
        self.travel(rng, from, to);
        if object {
            for _ in 0..rng.count(2, 5) {
                let (at, width, peak) = (
                    from + rng.between(0.0, 0.12),
                    rng.log_between(0.5e-3, 4e-3),
                    rng.log_between(0.05, 0.6),
                );
                self.pulse(rng, at, width, peak);
            }
        }
        let (width, peak) = (rng.log_between(0.5e-3, 3e-3), rng.log_between(0.05, 0.8));
        self.pulse(rng, to, width, peak);
    }

    /// Grip of `base` newtons, rising during `rise` and falling during `fall`, with slow variation by
    /// the operator (0.1–4 Hz) and tremor (8–12 Hz, 1–3 %).
    pub(crate) fn grip(&mut self, rng: &mut Rng, base: f64, rise: (f64, f64), fall: (f64, f64)) {
        let slow: [_; 3] =
            std::array::from_fn(|_| (rng.log_between(0.1, 4.0), rng.phase(), rng.between(0.0, 0.06)));
        let tremor = (rng.between(8.0, 12.0), rng.phase(), rng.between(0.01, 0.03));
        for (i, t) in self.times().enumerate() {
            let envelope = ramp(t, rise.0, rise.1) * (1.0 - ramp(t, fall.0, fall.1));
            let vary: f64 = slow
                .iter()
                .chain([&tremor])
                .map(|(hz, phase, depth)| depth * sin(std::f64::consts::TAU * hz * t + phase))
                .sum();
            self.grip_n[i] += base * envelope * (1.0 + vary);
        }
    }

    /// With probability `p`, one to three deliberate changes of the grip: squeezes that pass within
    /// 100–500 ms, and changes that stay.
    pub(crate) fn grip_changes(&mut self, rng: &mut Rng, (from, to): (f64, f64), p: f64) {
        if !rng.chance(p) || to - from < 0.12 {
            return;
        }
        for _ in 0..rng.count(1, 3) {
            let width = rng.log_between(0.1, 0.5).min(to - from);
            let start = rng.between(from, to - width);
            let depth: f64 = if rng.chance(0.35) { rng.between(-0.5, -0.2) } else { rng.between(0.2, 1.0) };
            // A change on top of others stays within what a hand does.
            let before = self.grip_n[((start + width) * STEP_HZ) as usize];
            let depth = (before * (1.0 + depth)).clamp(GRIP_N.0, GRIP_N.1) / before.max(1e-3) - 1.0;
            let stays = rng.chance(0.4);
            self.event("grip_change", start, start + width);
            for (i, t) in self.times().enumerate() {
                let bump = if stays {
                    ramp(t, start, start + width)
                } else {
                    ramp(t, start, start + 0.4 * width) * (1.0 - ramp(t, start + 0.6 * width, start + width))
                };
                self.grip_n[i] *= 1.0 + depth * bump;
            }
        }
    }

    /// Trapezoid move at `speed` between two times, on top of earlier moves; returns its length, mm.
    pub(crate) fn crosshead(&mut self, from: f64, to: f64, speed: f64, accel: f64) -> f64 {
        let ramp_s = (speed.abs() / accel).min((to - from) / 2.0);
        let mut position = 0.0;
        for (i, t) in self.times().enumerate() {
            let v = ((t - from) / ramp_s).min((to - t) / ramp_s).clamp(0.0, 1.0) * speed;
            position += v / STEP_HZ;
            self.crosshead_mm[i] += position;
        }
        position
    }

    /// One impact with a name.
    pub(crate) fn knock(&mut self, rng: &mut Rng, name: &'static str, at_s: f64, lo_g: f64, hi_g: f64) {
        let (width, peak) = (rng.log_between(TAP_WIDTH_S.0, TAP_WIDTH_S.1), rng.log_between(lo_g, hi_g));
        self.event(name, at_s, at_s + width);
        self.pulse(rng, at_s, width, peak);
    }

    /// With probability `p`, a tap or a train of up to four between two times.
    pub(crate) fn taps(&mut self, rng: &mut Rng, from: f64, to: f64, p: f64) {
        if !rng.chance(p) || to - from < 0.1 {
            return;
        }
        let mut at = rng.between(from, to - 0.05);
        for _ in 0..rng.count(1, 4) {
            if at < to {
                self.knock(rng, "tap", at, TAP_PEAK_G.0, TAP_PEAK_G.1);
            }
            at += rng.between(0.06, 0.3);
        }
    }

    /// The object is dragged over something between two times: vibration like slip, but not at the finger.
    pub(crate) fn drag(&mut self, rng: &mut Rng, from: f64, to: f64) {
        let width = rng.between(0.2, 0.7).min(to - from);
        let start = rng.between(from, to - width);
        self.event("drag", start, start + width);
        let level = rng.between(0.3, 1.0);
        for (i, t) in self.times().enumerate() {
            let edge = 0.03;
            let shape = ramp(t, start, start + edge) * (1.0 - ramp(t, start + width - edge, start + width));
            self.drag[i] += level * shape;
        }
    }
}
