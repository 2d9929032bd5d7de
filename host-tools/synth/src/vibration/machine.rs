//! Machines: a jointed hand's motors and what runs nearby, as at the accelerometer: they do not pass the modes.

use serde::Serialize;
use std::f64::consts::PI;

use super::scene::{Motion, Scene, at};
use super::signal::{Biquad, Harmonics, add_scaled, sin_turns};
use crate::draw::{Draw, Rng};

/// Harmonics of the motor comb.
const MOTOR_ORDERS: usize = 4;
/// Machines nearby: lines in Hz, harmonics of the mains and of fans and pumps; g rms.
const AMBIENT_HZ: [f64; 4] = [25.0, 50.0, 100.0, 120.0];
const AMBIENT_G: (f64, f64) = (0.5e-3, 10e-3);
/// Tone of a jointed hand's motors at rest, g rms.
const SERVO_G: (f64, f64) = (0.25e-3, 1.5e-3);

#[derive(Clone, Debug, Serialize)]
struct Tone {
    hz: f64,
    rms_g: f64,
    /// Turns.
    phase: f64,
    direction: [f64; 3],
}

/// Narrow-band noise of a tool while it works: centre, half-width over centre, level, and pace of its swell.
#[derive(Clone, Debug, Serialize)]
struct Tool {
    hz: f64,
    width: f64,
    rms_g: f64,
    swell_hz: f64,
    phase: f64,
    direction: [f64; 3],
}

#[derive(Clone, Debug, Serialize)]
pub(crate) struct Actuation {
    /// At full activity.
    motor_hz: f64,
    comb: Harmonics,
    /// Gear mesh, and how far it moves with the motor's speed.
    gear_hz: f64,
    gear_shift: f64,
    gear_share: f64,
    /// What comb and gears share, rms.
    running_g: f64,
    servo: Tone,
    direction: [f64; 3],
}

#[derive(Clone, Debug, Default, Serialize)]
pub(crate) struct Nearby {
    lines: Vec<Tone>,
    tool: Option<Tool>,
}

impl Nearby {
    pub(crate) fn draw(rng: &mut Rng) -> Self {
        let lines = if rng.chance(0.5) { rng.count(1, 3) } else { 0 };
        Self {
            lines: (0..lines)
                .map(|_| {
                    let hz = AMBIENT_HZ[rng.count(0, AMBIENT_HZ.len() - 1)] * rng.between(0.995, 1.005);
                    Tone::draw(rng, hz, AMBIENT_G)
                })
                .collect(),
            tool: Some(Tool {
                hz: rng.log_between(200.0, 2000.0),
                width: rng.log_between(0.02, 0.15),
                rms_g: rng.log_uniform(AMBIENT_G),
                swell_hz: rng.log_between(0.2, 2.0),
                phase: rng.between(0.0, 1.0),
                direction: rng.direction(),
            }),
        }
    }

    pub(crate) fn add(&self, scene: &Scene<'_>, rng: &mut Rng, motion: &mut Motion) {
        for tone in &self.lines {
            tone.add(motion);
        }
        if let Some(tool) = &self.tool {
            let rate_hz = motion.clock.rate_hz;
            let mut band = Biquad::bandpass(tool.hz, tool.width, rate_hz);
            // Equivalent noise bandwidth of the resonance: πζf. The swell of a working tool has an rms of 1.
            let gain = tool.rms_g / (2.0 * PI * tool.width * tool.hz / rate_hz).sqrt();
            for (t, out) in motion.samples() {
                let swell =
                    at(&scene.timeline.ambient, t) * (0.9 + 0.6 * sin_turns(tool.swell_hz * t + tool.phase));
                add_scaled(out, gain * swell * band.next(rng.normal()), tool.direction);
            }
        }
    }
}

impl Tone {
    fn draw(rng: &mut Rng, hz: f64, rms_g: (f64, f64)) -> Self {
        Self { hz, rms_g: rng.log_uniform(rms_g), phase: rng.between(0.0, 1.0), direction: rng.direction() }
    }

    fn add(&self, motion: &mut Motion) {
        let peak = self.rms_g * std::f64::consts::SQRT_2;
        for (t, out) in motion.samples() {
            add_scaled(out, peak * sin_turns(self.hz * t + self.phase), self.direction);
        }
    }
}

impl Actuation {
    pub(crate) fn draw(rng: &mut Rng) -> Self {
        let servo_hz = rng.log_between(800.0, 1300.0);
        Self {
            motor_hz: rng.log_between(15.0, 80.0),
            comb: Harmonics::draw(rng, (1..=MOTOR_ORDERS).map(|k| 1.0 / k as f64)),
            gear_hz: rng.log_between(200.0, 1200.0),
            gear_shift: rng.between(0.05, 0.1),
            gear_share: rng.between(0.3, 0.8),
            running_g: rng.log_between(0.002, 0.02),
            servo: Tone::draw(rng, servo_hz, SERVO_G),
            direction: rng.direction(),
        }
    }

    /// Comb and gear mesh while the motors run, the servo's tone always.
    pub(crate) fn add(&self, scene: &Scene<'_>, motion: &mut Motion) {
        self.servo.add(motion);
        let comb_gain = self.running_g * (1.0 - self.gear_share).sqrt();
        let gear_gain = self.running_g * (2.0 * self.gear_share).sqrt();
        let rate_hz = motion.clock.rate_hz;
        let (mut motor, mut gear) = (0.0, 0.0);
        for (t, out) in motion.samples() {
            let activity = at(&scene.timeline.motor, t);
            if activity <= 0.0 {
                continue;
            }
            motor += self.motor_hz * (0.5 + 0.5 * activity) / rate_hz;
            gear += self.gear_hz * (1.0 + self.gear_shift * (2.0 * activity - 1.0)) / rate_hz;
            let value = gear_gain * sin_turns(gear) + comb_gain * self.comb.at(motor, &[1.0; MOTOR_ORDERS]);
            for (o, d) in out.iter_mut().zip(self.direction) {
                *o += d * activity.sqrt() * value;
            }
        }
    }
}
