//! Vibration of one finger: what excites it, and the modes through which the accelerometer feels it.
//!
//! Excitations are accelerations of the finger's root in its own axes: x across the finger, y along it,
//! z normal to the pad. All sources write at the accelerometer's own sample times, in two buffers: what
//! passes the finger's modes, and what is stated at the accelerometer or moves the finger as a whole.

mod autoregressive;
mod hand_motion;
mod handling;
mod streams;
mod machine;
mod modes;
mod rig;
mod signal;
mod slip;
#[cfg(test)]
mod tests;

pub(crate) use handling::{TAP_PEAK_G, TAP_WIDTH_S};
pub(crate) use modes::Modes;
pub(crate) use signal::sin_turns;
pub(crate) use streams::NoiseStreams;

use serde::Serialize;

use crate::draw::Rng;
use crate::friction::STEP_HZ;
use crate::objects::Object;
use crate::recipe::{Platform, VibrationContent, VibrationModel};
use crate::timeline::Pulse;
use autoregressive::AutoregressiveNoise;
use hand_motion::HandMotion;
use handling::HandlingNoise;
use modes::ObjectMode;
use rig::Rig;
use signal::cos_turns;
use slip::{Rubbing, Surface};
use streams::NoiseSource;

/// From this grip on an object counts as touched, N.
const TOUCHED_N: f64 = 0.05;

/// What the interface of one finger does, [`STEP_HZ`] values per second.
#[derive(Default)]
pub(crate) struct SlipSeries {
    /// Load-weighted mean of the interface speed.
    pub speed_mm_s: Vec<f64>,
    /// Share of the load that slides.
    pub fraction: Vec<f64>,
    /// Load-weighted slid length; never falls.
    pub path_mm: Vec<f64>,
    /// Unit vector of the mean slip in pad x, y.
    pub direction: Vec<[f64; 2]>,
    /// Grip of this finger.
    pub grip_n: Vec<f64>,
}

/// What the vibration needs to know of the course of events. Series have [`STEP_HZ`] values per second
/// and equal lengths, at least one value more than the recording's last tick needs.
pub(crate) struct Scene<'a> {
    pub platform: Platform,
    pub model: VibrationModel,
    pub content: VibrationContent,
    /// The crosshead's drive is heard.
    pub rig_leak: bool,
    /// A hand holds the gripper: it sways, and there is no rig.
    pub hand_held: bool,
    /// The crosshead is linked to the object, so its drive comes through it while it is gripped.
    pub linked: bool,
    /// The gripper stands on the rig's own table: the drive is as loud without the object as through it.
    pub shared_table: bool,
    pub object: &'static Object,
    /// Grip force of one finger.
    pub grip_n: &'a [f64],
    pub crosshead_mm: &'a [f64],
    /// Jaw motion of a hand-driven gripper, 0 at rest to 1.
    pub jaw: &'a [f64],
    /// Activity of the motors of a motorised hand, 0–1; a hand-driven gripper has none.
    pub motor: &'a [f64],
    /// Dragging of the gripped object over something else, 0–1, and the speed of it.
    pub drag: &'a [f64],
    pub drag_mm_s: &'a [f64],
    /// How vigorously the hand that carries the gripper swings, 0–1.
    pub motion: &'a [f64],
    /// How much a tool nearby works, 0–1.
    pub ambient: &'a [f64],
    /// Impacts at the fingers' roots. Closing impacts, aftershocks of a release and clicks of the jaws are
    /// made here, from the series.
    pub pulses: &'a [Pulse],
}

/// All that is drawn once per recording and is the same for all its fingers.
#[derive(Serialize)]
pub(crate) struct Vibration {
    surface: Surface,
    texture: AutoregressiveNoise,
    ring: Option<ObjectMode>,
    #[serde(rename = "disturbances")]
    handling: HandlingNoise,
    rig: Rig,
    #[serde(rename = "carriage")]
    hand_motion: HandMotion,
}

impl Vibration {
    pub(crate) fn draw(rng: &mut Rng, scene: &Scene<'_>) -> Self {
        Self {
            surface: Surface::draw(rng, scene.object),
            texture: AutoregressiveNoise::draw(rng, scene.object),
            ring: ObjectMode::draw(rng, scene.object.ring_hz),
            rig: Rig::draw(rng),
            hand_motion: HandMotion::draw(rng, scene),
            handling: HandlingNoise::draw(rng, scene),
        }
    }

    /// Acceleration of one finger at the accelerometer's sample times, finger axes, g.
    pub(crate) fn motion_g(
        &self,
        scene: &Scene<'_>,
        slip: &SlipSeries,
        modes: &Modes,
        sensor: usize,
        clock: Clock,
        streams: &mut NoiseStreams,
    ) -> Vec<[f64; 3]> {
        let mut motion = vec![[0.0; 3]; clock.samples];
        if scene.content == VibrationContent::All {
            if scene.model == VibrationModel::Modal {
                self.slip(slip, sensor, clock, streams, &mut motion);
            }
            self.handling.excite(scene, sensor, clock, streams, &mut motion);
            modes.respond(scene, self.ring.as_ref(), clock, &mut motion);
            if scene.model == VibrationModel::Autoregressive {
                self.texture.add(slip, clock, streams.of(NoiseSource::AutoregressiveNoise), &mut motion);
            }
            self.handling.shake(scene, modes, sensor, clock, streams, &mut motion);
            self.hand_motion.hand(scene, sensor, clock, &mut motion);
        }
        if scene.rig_leak {
            self.rig.add(scene, clock, &mut motion);
        }
        self.hand_motion.gravity(&mut motion);
        motion
    }

    /// What moves the jaws or joints anew from `from_s` on knocks, as every start of theirs does.
    pub(crate) fn moves_again(&mut self, rng: &mut Rng, platform: Platform, from_s: f64) {
        self.handling.moves_again(rng, platform, from_s);
    }

    fn slip(
        &self,
        slip: &SlipSeries,
        sensor: usize,
        clock: Clock,
        streams: &mut NoiseStreams,
        force: &mut [[f64; 3]],
    ) {
        let rubbing = Rubbing::from_slip(slip);
        self.surface.add_rubbing(&rubbing, 1.0, clock, streams.of(NoiseSource::Rubbing), force);
        let pulses = self.surface.pulses(&rubbing, 1.0, streams.of(NoiseSource::StickSlip));
        add_pulses(&pulses, sensor, 1.0, clock, force);
    }
}

/// Times of the samples of one accelerometer, whose clock is off and drifts.
#[derive(Clone, Copy)]
pub(crate) struct Clock {
    /// Rate at the start of the recording.
    pub rate_hz: f64,
    /// Relative change of the rate, per second.
    pub drift_per_s: f64,
    /// Share of a sample period before the first sample, 0–1.
    pub start: f64,
    pub samples: usize,
}

impl Clock {
    /// Time of a sample, seconds.
    pub(crate) fn time(&self, n: usize) -> f64 {
        let x = (n as f64 + self.start) / self.rate_hz;
        // The inverse of `periods`, in the form that holds without drift too.
        2.0 * x / (1.0 + (1.0 + 2.0 * self.drift_per_s * x).sqrt())
    }

    /// Sample periods up to a time.
    fn periods(&self, t: f64) -> f64 {
        t * (1.0 + self.drift_per_s * t / 2.0) * self.rate_hz - self.start
    }

    /// First sample at or after a time.
    fn sample_at(&self, t: f64) -> usize {
        self.periods(t).ceil().max(0.0) as usize
    }

    /// Samples available at the end of each frame.
    pub(crate) fn ends(&self, frames: usize, frame_rate_hz: f64) -> Vec<u32> {
        (1..=frames).map(|f| (self.periods(f as f64 / frame_rate_hz).floor() + 1.0).max(0.0) as u32).collect()
    }
}

/// Value of a step series at a time, linear between steps.
pub(crate) fn at(series: &[f64], t: f64) -> f64 {
    let x = (t * STEP_HZ).max(0.0);
    let last = series.len() - 1;
    let i = (x as usize).min(last);
    let next = series[(i + 1).min(last)];
    series[i] + (next - series[i]) * (x - i as f64).clamp(0.0, 1.0)
}

/// Half-sines, each averaged over the sample periods it covers, so that one shorter than a period has
/// its area too.
fn add_pulses(pulses: &[Pulse], sensor: usize, gain: f64, clock: Clock, buffer: &mut [[f64; 3]]) {
    let half = 0.5 / clock.rate_hz;
    for p in pulses {
        let from = clock.sample_at(p.at_s - half);
        let to = clock.sample_at(p.at_s + p.width_s + half).min(buffer.len());
        // Primitive of the half-sine, over the period.
        let scale = gain * p.peak_g * p.share[sensor] * p.width_s / std::f64::consts::PI * clock.rate_hz;
        let primitive = |t: f64| -cos_turns(0.5 * ((t - p.at_s) / p.width_s).clamp(0.0, 1.0));
        for (n, out) in buffer.iter_mut().enumerate().take(to).skip(from) {
            let t = clock.time(n);
            let value = scale * (primitive(t + half) - primitive(t - half));
            for (b, d) in out.iter_mut().zip(p.direction) {
                *b += d * value;
            }
        }
    }
}
