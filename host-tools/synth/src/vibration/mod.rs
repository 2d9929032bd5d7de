//! Vibration of one finger: what excites it, and the modes through which it reaches the accelerometer.
//!
//! Excitations are accelerations of the finger's root in its own axes: x across the finger, y along it,
//! z normal to the pad. All sources write at the accelerometer's own sample times, in two buffers: what
//! passes the finger's modes, and what is stated at the accelerometer or moves the finger as a whole.

mod autoregressive;
mod echoes;
mod elsewhere;
mod grains;
mod hand_motion;
mod handling;
mod streams;
mod machine;
mod modes;
mod profile;
mod rig;
mod scene;
mod sections;
mod signal;
mod slip;
#[cfg(test)]
mod tests;

pub(crate) use modes::Modes;
pub(crate) use scene::{Clock, Motion, Scene, SlipSeries, at};
pub(crate) use signal::{Biquad, Noise, add_scaled, blend, blend_rms, sin_turns};
pub(crate) use streams::NoiseStreams;

use serde::Serialize;

use crate::draw::Rng;
use crate::families::{PathFamily, SourceFamily};
use crate::friction::STEP_HZ;
use crate::recipe::VibrationContent;
use autoregressive::AutoregressiveNoise;
use echoes::Echoes;
use elsewhere::Elsewhere;
use grains::Grains;
use hand_motion::HandMotion;
use handling::HandlingNoise;
use modes::ObjectMode;
use profile::Profile;
use rig::Rig;
use sections::Sections;
use slip::Surface;
use streams::NoiseSource;

/// All that is drawn once per recording and is the same for all its fingers.
#[derive(Serialize)]
pub(crate) struct Vibration {
    surface: Surface,
    texture: AutoregressiveNoise,
    ring: Option<ObjectMode>,
    #[serde(rename = "disturbances")]
    pub handling: HandlingNoise,
    rig: Rig,
    #[serde(rename = "carriage")]
    hand_motion: HandMotion,
    #[serde(flatten)]
    other: Other,
}

/// What other families than the laboratory's draw.
#[derive(Default, Serialize)]
struct Other {
    #[serde(skip_serializing_if = "Option::is_none")]
    profile: Option<Profile>,
    #[serde(skip_serializing_if = "Option::is_none")]
    grains: Option<Grains>,
    #[serde(skip_serializing_if = "Option::is_none")]
    sections: Option<Sections>,
    #[serde(skip_serializing_if = "Option::is_none")]
    echoes: Option<Echoes>,
    #[serde(skip_serializing_if = "Option::is_none")]
    elsewhere: Option<Elsewhere>,
}

impl Other {
    fn draw(rng: &mut Rng, scene: &Scene<'_>) -> Self {
        let (source, path) = (scene.source, scene.families.path);
        let seconds = scene.timeline.steps() as f64 / STEP_HZ;
        Self {
            elsewhere: Elsewhere::draw(scene.families.disturbance, rng, seconds),
            profile: (source == SourceFamily::Profile).then(|| Profile::draw(rng, scene.object)),
            grains: (source == SourceFamily::Grains).then(|| Grains::draw(rng, scene.object)),
            sections: (path == PathFamily::Sections).then(|| Sections::draw(rng)),
            echoes: (path == PathFamily::Echoes).then(|| Echoes::draw(rng)),
        }
    }
}

impl Vibration {
    /// The laboratory's sources from `rng`, the others from `own`.
    pub(crate) fn draw(rng: &mut Rng, own: &mut Rng, scene: &Scene<'_>) -> Self {
        Self {
            surface: Surface::draw(rng, scene.object),
            texture: AutoregressiveNoise::draw(rng, scene.object),
            ring: ObjectMode::draw(rng, scene.object.ring_hz),
            rig: Rig::draw(rng),
            hand_motion: HandMotion::draw(rng, scene),
            handling: HandlingNoise::draw(rng, scene),
            other: Other::draw(own, scene),
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
            self.slip(scene, slip, streams, &mut motion);
            self.handling.excite(scene, streams, &mut motion);
            match (&self.other.sections, &self.other.echoes) {
                (Some(sections), _) => sections.respond(&mut motion),
                (_, Some(echoes)) => echoes.respond(&mut motion),
                _ => modes.respond(scene, self.ring.as_ref(), &mut motion),
            }
            if scene.source == SourceFamily::Autoregressive {
                self.texture.add(slip, streams.of(NoiseSource::Autoregressive), &mut motion);
            }
            self.handling.shake(scene, modes, streams, &mut motion);
            if let Some(elsewhere) = &self.other.elsewhere {
                elsewhere.add(streams.of(NoiseSource::Elsewhere), &mut motion);
            }
            self.hand_motion.add(scene, &mut motion);
        }
        if scene.rig_leak && scene.content != VibrationContent::IdleNoise {
            self.rig.add(scene, &mut motion);
        }
        self.hand_motion.add_gravity(&mut motion);
        motion
    }

    fn slip(&self, scene: &Scene<'_>, slip: &SlipSeries, streams: &mut NoiseStreams, force: &mut Motion) {
        let rubbing = slip.rubbing();
        let pulses = match (scene.source, &self.other.profile, &self.other.grains) {
            (SourceFamily::Autoregressive, ..) => return,
            (_, Some(profile), _) => return profile.add(&rubbing, force),
            (_, _, Some(grains)) => grains.pulses(&rubbing, streams.of(NoiseSource::Grains)),
            _ => {
                self.surface.add_rubbing(&rubbing, 1.0, streams.of(NoiseSource::Rubbing), force);
                self.surface.pulses(&rubbing, 1.0, streams.of(NoiseSource::StickSlip))
            }
        };
        force.add_pulses(&pulses, 1.0);
    }
}
