//! The series and impacts a scenario is written into: grip force, crosshead, jaws, impacts.
//!
//! Times may lie before the start or after the end of the recording: what lies outside is left out.

use std::f64::consts::TAU;
use std::ops::Range;

use libm::sin;
use serde::Serialize;
use slipsense::params::MAX_SENSORS;

use crate::draw::{Draw, Rng, Span};
use crate::friction::STEP_HZ;
use crate::scenario::levels::*;
use crate::scenario::script::Trapezoid;

/// Something that happens, for the manifest in the episode's metadata.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Event {
    /// `close`, `open`, `grip_change`, `move` (crosshead), `pull` (by hand), `tap`, `drag`, `lift`,
    /// `set_down`, `jaw` (trigger or actuation), `motion` (of the hand), `rolling`, `ambient` or
    /// `electrical` (faults of an array).
    pub name: &'static str,
    /// Start, seconds from the start of the episode.
    pub start_s: f64,
    pub end_s: f64,
}

impl Event {
    /// Milliseconds are enough to find it, and short decimals survive JSON to the bit.
    pub(crate) fn rounded(self) -> Self {
        let [start_s, end_s] = [self.start_s, self.end_s].map(|t| (t * 1e3).round() / 1e3);
        Self { start_s, end_s, ..self }
    }
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

impl Pulse {
    pub(crate) fn draw(rng: &mut Rng, at_s: f64, width: Span, peak: Span) -> Self {
        Self {
            at_s,
            width_s: rng.log_uniform(width),
            peak_g: rng.log_uniform(peak),
            direction: rng.direction(),
            share: std::array::from_fn(|_| rng.between(0.4, 1.0)),
        }
    }
}

/// Series at [`STEP_HZ`] and a list of impacts.
#[derive(Clone)]
pub(crate) struct Timeline {
    seconds: f64,
    pub grip_n: Vec<f64>,
    pub crosshead_mm: Vec<f64>,
    /// Rail friction of the jaws in motion, 0 at rest to 1.
    pub jaw: Vec<f64>,
    /// Motors of the hand, 0 at rest to 1 at full speed. Always 0 for a hand-driven jaw.
    pub motor: Vec<f64>,
    /// Dragging of the object over something else, 0–1.
    pub drag: Vec<f64>,
    /// How vigorously the hand or arm that carries the gripper swings, 0–1.
    pub motion: Vec<f64>,
    /// Tools running nearby, 0–1.
    pub ambient: Vec<f64>,
    /// Slopes by which the object has rolled in the grip, across and along its axis, rad.
    pub roll_rad: Vec<[f64; 2]>,
    pub pulses: Vec<Pulse>,
    pub events: Vec<Event>,
}

/// 0 before `from`, 1 after `to`, smooth between.
pub(crate) fn ramp(t: f64, from: f64, to: f64) -> f64 {
    let x = ((t - from) / (to - from).max(1e-6)).clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}

/// Sum of sines of these frequencies, Hz, phases, rad, and peaks at a time.
pub(crate) fn swing(sines: &[(f64, f64, f64)], t: f64) -> f64 {
    sines.iter().map(|(hz, phase, peak)| peak * sin(TAU * hz * t + phase)).sum()
}

/// 1 between two times with smooth edges inside, 0 outside.
pub(crate) fn plateau(t: f64, (from, to): (f64, f64), edge: f64) -> f64 {
    let edge = edge.min((to - from) / 2.0);
    ramp(t, from, from + edge) * (1.0 - ramp(t, to - edge, to))
}

impl Timeline {
    pub(crate) fn new(seconds: f64) -> Self {
        // One step more than the last tick needs.
        let steps = (seconds * STEP_HZ).ceil() as usize + 1;
        Self {
            seconds,
            grip_n: vec![0.0; steps],
            crosshead_mm: vec![0.0; steps],
            jaw: vec![0.0; steps],
            motor: vec![0.0; steps],
            drag: vec![0.0; steps],
            motion: vec![0.0; steps],
            ambient: vec![0.0; steps],
            roll_rad: vec![[0.0; 2]; steps],
            pulses: Vec::new(),
            events: Vec::new(),
        }
    }

    pub(crate) fn steps(&self) -> usize {
        self.grip_n.len()
    }

    pub(crate) fn span(&self, from: f64, to: f64) -> Range<usize> {
        let step = |t: f64| ((t * STEP_HZ).max(0.0).ceil() as usize).min(self.steps());
        step(from)..step(to).max(step(from))
    }

    pub(crate) fn times(&self, from: f64, to: f64) -> impl Iterator<Item = (usize, f64)> + use<> {
        self.span(from, to).map(|i| (i, i as f64 / STEP_HZ))
    }

    pub(crate) fn event(&mut self, name: &'static str, start_s: f64, end_s: f64) {
        if end_s <= 0.0 || start_s >= self.seconds {
            return;
        }
        let [start_s, end_s] = [start_s, end_s].map(|t| t.clamp(0.0, self.seconds));
        self.events.push(Event { name, start_s, end_s }.rounded());
    }

    pub(crate) fn pulse(&mut self, rng: &mut Rng, at_s: f64, width: Span, peak: Span) {
        let pulse = Pulse::draw(rng, at_s, width, peak);
        if (0.0..self.seconds).contains(&at_s) {
            self.pulses.push(pulse);
        }
    }

    /// An event between two times during which a series of levels from 0 to 1 is higher by `level`, with smooth edges.
    pub(crate) fn swell(
        &mut self,
        name: &'static str,
        series: fn(&mut Self) -> &mut Vec<f64>,
        (from, to): Span,
        level: f64,
        edge: f64,
    ) {
        self.event(name, from, to);
        let times = self.times(from, to);
        let series = series(self);
        for (i, t) in times {
            series[i] = (series[i] + level * plateau(t, (from, to), edge)).min(1.0);
        }
    }

    /// Jaws in motion between two times, and the motors that move them where there are any. Rail friction,
    /// clicks and motor noise are the vibration's matter.
    pub(crate) fn travel(&mut self, rng: &mut Rng, (from, to): (f64, f64), vigour: f64, motors: bool) {
        let (rise, fall) = (from + 0.3 * (to - from), to - 0.1 * (to - from));
        let wobble = (rng.between(3.0, 12.0), rng.phase());
        for (i, t) in self.times(from, to) {
            let shape = vigour * ramp(t, from, rise) * (1.0 - ramp(t, fall, to));
            let pace = 0.75 + 0.25 * sin(TAU * wobble.0 * t + wobble.1);
            self.jaw[i] = (self.jaw[i] + shape * pace).min(1.0);
            if motors {
                self.motor[i] = (self.motor[i] + shape).min(1.0);
            }
        }
    }

    /// Jaws travel between two times. What they hit is the vibration's matter; without an object it is each other.
    pub(crate) fn close(&mut self, rng: &mut Rng, (from, to): (f64, f64), object: bool, motors: bool) {
        self.event("close", from, to);
        self.travel(rng, (from, to), 1.0, motors);
        if !object {
            self.pulse(rng, to, END_STOP_S, END_STOP_G);
        }
    }

    /// Jaws let go and travel between two times to their end stop, and ring on.
    pub(crate) fn open(&mut self, rng: &mut Rng, (from, to): (f64, f64), motors: bool) {
        self.event("open", from, to + AFTERSHOCK_S);
        self.travel(rng, (from, to), 1.0, motors);
        self.pulse(rng, to, END_STOP_S, END_STOP_G);
    }

    /// Grip of `base` newtons, rising and falling between two times each, with the operator's variation and tremor.
    pub(crate) fn grip(&mut self, rng: &mut Rng, base: f64, rise: (f64, f64), fall: (f64, f64)) {
        let depth = rng.log_uniform(VARIATION_DEPTH);
        let parts: [f64; 3] = std::array::from_fn(|_| rng.between(0.2, 1.0));
        let sum: f64 = parts.iter().sum();
        let mut swings: Vec<_> =
            parts.map(|part| (rng.log_uniform(VARIATION_HZ), rng.phase(), depth * part / sum)).to_vec();
        swings.push((rng.uniform(TREMOR_HZ), rng.phase(), rng.uniform(TREMOR_DEPTH)));
        for (i, t) in self.times(rise.0, fall.1) {
            let envelope = ramp(t, rise.0, rise.1) * (1.0 - ramp(t, fall.0, fall.1));
            self.grip_n[i] = envelope * (base * (1.0 + swing(&swings, t))).clamp(GRIP_N.0, GRIP_N.1);
        }
    }

    /// A deliberate change of the grip at `start`: a squeeze that passes, a let-up, or a ramp that stays until `end`.
    pub(crate) fn grip_change(&mut self, rng: &mut Rng, start: f64, (from, to): (f64, f64), end: f64) {
        let (squeeze_s, stays) = (rng.log_uniform(SQUEEZE_S), rng.chance(0.4));
        let (rate, weaker) = (rng.log_uniform(RAMP_PER_S), rng.chance(0.35));
        let depth = if weaker { rng.between(-0.5, -0.2) } else { rng.between(0.2, 1.0) };
        let width = if stays { depth.abs() / rate } else { squeeze_s };
        if start < from || start + width > to {
            return;
        }
        // A change on top of others stays within what a hand does.
        let Some(&before) = self.grip_n.get(((start + width) * STEP_HZ).max(0.0) as usize) else { return };
        let depth = (before * (1.0 + depth)).clamp(GRIP_N.0, GRIP_N.1) / before.max(1e-3) - 1.0;
        self.event("grip_change", start, start + width);
        for (i, t) in self.times(start, if stays { end } else { start + width }) {
            let share = if stays {
                ramp(t, start, start + width)
            } else {
                plateau(t, (start, start + width), 0.4 * width)
            };
            self.grip_n[i] *= 1.0 + depth * share;
        }
    }

    /// The crosshead moves between two times, and stays where it got.
    pub(crate) fn crosshead(&mut self, motion: &Trapezoid, towards: f64, (from, to): (f64, f64)) {
        self.event("move", from, to);
        for (i, t) in self.times(from, f64::INFINITY) {
            self.crosshead_mm[i] += towards * motion.at(t - from, to - from);
        }
    }

    /// Interference that running motors leave in the arrays at a step, counts rms.
    pub(crate) fn pickup_counts(&self, step: usize, motor_counts: f64) -> f64 {
        motor_counts * self.motor[step]
            + JAW_PICKUP_COUNTS * self.jaw[step].min(1.0)
            + TOOL_PICKUP_COUNTS * self.ambient[step]
    }
}
