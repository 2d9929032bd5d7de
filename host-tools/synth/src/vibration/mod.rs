//! Vibration of one finger: what excites it, and the modes through which it reaches the accelerometer.
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
mod scene;
mod signal;
mod slip;
#[cfg(test)]
mod tests;

pub(crate) use modes::Modes;
pub(crate) use scene::{Clock, Motion, Scene, SlipSeries, at};
pub(crate) use signal::sin_turns;
pub(crate) use streams::NoiseStreams;

use serde::Serialize;

use crate::draw::Rng;
use crate::recipe::{Platform, VibrationContent, VibrationModel};
use autoregressive::AutoregressiveNoise;
use hand_motion::HandMotion;
use handling::HandlingNoise;
use modes::ObjectMode;
use rig::Rig;
use slip::{Rubbing, Surface};
use streams::NoiseSource;

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

    pub(crate) fn motion(
        &self,
        scene: &Scene<'_>,
        slip: &SlipSeries,
        modes: &Modes,
        (sensor, clock): (usize, Clock),
        streams: &mut NoiseStreams,
    ) -> Motion {
        let mut motion = Motion::still(sensor, clock);
        if scene.content == VibrationContent::All {
            if scene.model == VibrationModel::Modal {
                self.slip(slip, streams, &mut motion);
            }
            self.handling.excite(scene, streams, &mut motion);
            modes.respond(scene, self.ring.as_ref(), &mut motion);
            if scene.model == VibrationModel::Autoregressive {
                self.texture.add(slip, streams.of(NoiseSource::Autoregressive), &mut motion);
            }
            self.handling.shake(scene, modes, streams, &mut motion);
            self.hand_motion.add(scene, &mut motion);
        }
        if scene.rig_leak {
            self.rig.add(scene, &mut motion);
        }
        self.hand_motion.add_gravity(&mut motion);
        motion
    }

    /// A motion of jaws or joints that starts at `from_s` has impacts, as every start of theirs has.
    pub(crate) fn moves_again(&mut self, rng: &mut Rng, platform: Platform, from_s: f64) {
        self.handling.moves_again(rng, platform, from_s);
    }

    fn slip(&self, slip: &SlipSeries, streams: &mut NoiseStreams, force: &mut Motion) {
        let rubbing = Rubbing::from_slip(slip);
        self.surface.add_rubbing(&rubbing, 1.0, streams.of(NoiseSource::Rubbing), force);
        let pulses = self.surface.pulses(&rubbing, 1.0, streams.of(NoiseSource::StickSlip));
        force.add_pulses(&pulses, 1.0);
    }
}
