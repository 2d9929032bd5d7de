//! Handling noise, a grasp's vibration that is not slip: impacts, creaking grip changes, jaws, the object dragged.

use libm::{exp, log, pow};
use serde::Serialize;
use slipsense::params::MAX_SENSORS;
use std::f64::consts::PI;

use super::machine::{Actuation, Nearby};
use super::modes::Modes;
use super::scene::{Motion, Scene, SlipSeries, TOUCHED_N, at};
use super::signal::{Noise, add_scaled, blend, blend_rms, sin_turns};
use super::slip::{REFERENCE_N, Surface};
use super::streams::{NoiseSource, NoiseStreams};
use crate::draw::{Draw, Rng};
use crate::friction::STEP_HZ;
use crate::recipe::Platform;
use crate::scenario::levels::DRAG_MM_S;
use crate::timeline::Pulse;

const CLOSING_G: (f64, f64) = (0.1, 3.0);
/// Share of a closing impact that excites the modes besides moving the finger as a whole.
const CLOSING_MODES: f64 = 0.5;

/// Creak while the grip changes: relative force rates up to the first are silent, as a tremor of 3 % at 12 Hz has 2.3
/// per second and moves nothing; its level is stated at the second.
const CREAK_FROM_PER_S: f64 = 2.4;
const CREAK_FULL_PER_S: f64 = 6.0;
/// Micro-slip during grip changes: pulses per unit of relative change.
const MICRO_PULSES: f64 = 12.0;

/// Duration of a Hertz contact of two elastic bodies, seconds: `2.87 (m² / (R E*² v))^(1/5)`.
pub(crate) fn hertz_contact_s(mass_kg: f64, radius_m: f64, modulus_pa: f64, speed_m_s: f64) -> f64 {
    2.87 * pow(mass_kg * mass_kg / (radius_m * modulus_pa * modulus_pa * speed_m_s), 0.2)
}

#[derive(Clone, Debug, Serialize)]
pub(crate) struct HandlingNoise {
    creak_g: f64,
    creak_hz: f64,
    /// Rail friction of a hand-driven jaw: level, corner, pace of its bursts.
    rail_g: f64,
    rail_hz: f64,
    rail_burst_hz: f64,
    /// Aftershock of a release: peak at 2 N of grip, time until a tenth is left.
    aftershock_g: f64,
    aftershock_s: f64,
    actuation: Option<Actuation>,
    nearby: Nearby,
    dragged: Surface,
    /// Share of the rubbing at the object's far side that arrives at the finger.
    drag_arrives: f64,
    /// Impacts that excite the modes.
    #[serde(skip)]
    impacts: Vec<Pulse>,
    /// Impacts that stop a whole finger.
    #[serde(skip)]
    closings: Vec<Pulse>,
}

impl HandlingNoise {
    pub(crate) fn draw(rng: &mut Rng, scene: &Scene<'_>) -> Self {
        let mut drawn = Self {
            creak_g: rng.log_between(0.003, 0.03),
            creak_hz: rng.log_between(150.0, 800.0),
            rail_g: rng.log_between(0.01, 0.05),
            rail_hz: rng.log_between(100.0, 600.0),
            rail_burst_hz: rng.log_between(5.0, 40.0),
            aftershock_g: rng.log_between(0.03, 0.4),
            aftershock_s: rng.log_between(0.05, 0.3),
            actuation: (scene.platform == Platform::Tesollo).then(|| Actuation::draw(rng)),
            nearby: Nearby::draw(rng),
            dragged: Surface::table(rng),
            drag_arrives: rng.log_between(0.1, 0.5),
            impacts: scene.timeline.pulses.clone(),
            closings: Vec::new(),
        };
        for &at_s in &crossings(&scene.timeline.grip_n, TOUCHED_N).0 {
            drawn.closings.extend(closing(rng, scene, at_s));
        }
        drawn.clicks(rng, scene);
        drawn
    }

    #[cfg(test)]
    pub(super) fn quiet(&mut self) {
        self.impacts.clear();
        self.closings.clear();
        self.nearby = Nearby::default();
    }

    /// Backlash of a jaw, steps of a joint: where motion starts and stops or meets a load.
    fn clicks(&mut self, rng: &mut Rng, scene: &Scene<'_>) {
        let series = match scene.platform {
            Platform::Umi => &scene.timeline.jaw,
            Platform::Tesollo => &scene.timeline.motor,
        };
        let (starts, mut stops) = crossings(series, 0.05);
        if scene.platform == Platform::Tesollo {
            // A joint gives a little as it takes up the load.
            stops.extend(crossings(&scene.timeline.grip_n, TOUCHED_N).0);
        }
        for &from in starts.iter().chain(&stops) {
            self.moves_again(rng, scene.platform, from);
        }
    }

    /// A motion of jaws or joints that starts at `from_s` has impacts, as every start of theirs has.
    pub(crate) fn moves_again(&mut self, rng: &mut Rng, platform: Platform, from_s: f64) {
        let (peak_g, width_s) = match platform {
            // Backlash clicks.
            Platform::Umi => ((0.05, 0.5), (1e-3, 5e-3)),
            // Steps of the joints.
            Platform::Tesollo => ((0.01, 0.15), (1e-3, 6e-3)),
        };
        for _ in 0..rng.count(0, 2) {
            let at_s = from_s + rng.between(0.0, 0.05);
            self.impacts.push(Pulse::draw(rng, at_s, width_s, peak_g));
        }
    }

    pub(crate) fn excite(&self, scene: &Scene<'_>, streams: &mut NoiseStreams, force: &mut Motion) {
        force.add_pulses(&self.impacts, 1.0);
        force.add_pulses(&self.closings, CLOSING_MODES);
        self.creak(scene, streams, force);
        if scene.platform == Platform::Umi {
            self.rail(scene, streams, force);
        }
        self.drag(scene, streams, force);
    }

    pub(crate) fn shake(
        &self,
        scene: &Scene<'_>,
        modes: &Modes,
        streams: &mut NoiseStreams,
        motion: &mut Motion,
    ) {
        motion.add_pulses(&self.closings, 1.0);
        self.aftershocks(scene, modes, streams.of(NoiseSource::Aftershocks), motion);
        if let Some(actuation) = &self.actuation {
            actuation.add(scene, motion);
        }
        self.nearby.add(scene, streams.of(NoiseSource::Nearby), motion);
    }

    fn creak(&self, scene: &Scene<'_>, streams: &mut NoiseStreams, force: &mut Motion) {
        // Change over two steps: shorter ones see rounding, longer ones smear a squeeze.
        let rate = |i: usize| {
            let (now, before) = (scene.timeline.grip_n[i], scene.timeline.grip_n[i.saturating_sub(2)]);
            (now - before).abs() * STEP_HZ / 2.0 / now.max(before).max(0.5)
        };
        let full = CREAK_FULL_PER_S - CREAK_FROM_PER_S;
        let levels: Vec<f64> = (0..scene.timeline.grip_n.len())
            .map(|i| self.creak_g * ((rate(i) - CREAK_FROM_PER_S).max(0.0) / full).min(4.0).sqrt())
            .collect();
        noise(&levels, self.creak_hz, streams.of(NoiseSource::Creak), force);
        let rng = streams.of(NoiseSource::MicroSlip);
        let mut micro = Vec::new();
        for (i, level) in levels.iter().enumerate().filter(|(_, level)| **level > 0.0) {
            if rng.chance((MICRO_PULSES * rate(i) / STEP_HZ).min(1.0)) {
                micro.push(Pulse {
                    at_s: i as f64 / STEP_HZ,
                    width_s: rng.log_between(0.2e-3, 1.5e-3),
                    peak_g: (level / self.creak_g).min(1.0)
                        * rng.log_between(0.005, 0.06)
                        * rng.exponential(1e-3),
                    direction: rng.direction(),
                    share: [1.0; MAX_SENSORS],
                });
            }
        }
        force.add_pulses(&micro, 1.0);
    }

    fn rail(&self, scene: &Scene<'_>, streams: &mut NoiseStreams, force: &mut Motion) {
        let rng = streams.of(NoiseSource::RailBursts);
        let pace = blend(self.rail_burst_hz, STEP_HZ);
        let rms = blend_rms(pace);
        let mut burst = 0.0;
        let levels: Vec<f64> = scene
            .timeline
            .jaw
            .iter()
            .map(|&jaw| {
                if jaw <= 0.0 {
                    return 0.0;
                }
                burst += pace * (rng.normal() - burst);
                self.rail_g * jaw * (0.4 + 0.75 * (burst / rms).abs())
            })
            .collect();
        noise(&levels, self.rail_hz, streams.of(NoiseSource::Rail), force);
    }

    fn drag(&self, scene: &Scene<'_>, streams: &mut NoiseStreams, force: &mut Motion) {
        if scene.timeline.drag.iter().all(|&d| d <= 0.0) {
            return;
        }
        let held = |i: usize| if scene.timeline.grip_n[i] > TOUCHED_N { scene.timeline.drag[i] } else { 0.0 };
        let steps = scene.timeline.drag.len();
        let speed_mm_s: Vec<f64> = scene.timeline.drag.iter().map(|level| DRAG_MM_S * level).collect();
        let mut path = 0.0;
        let path_mm = speed_mm_s.iter().map(|v| {
            path += v / STEP_HZ;
            path
        });
        let rubbing = SlipSeries {
            path_mm: path_mm.collect(),
            speed_mm_s,
            fraction: (0..steps).map(held).collect(),
            grip_n: vec![REFERENCE_N; steps],
            direction: vec![[0.0, 1.0]; steps],
        };
        self.dragged.add_rubbing(&rubbing, self.drag_arrives, streams.of(NoiseSource::Drag), force);
        let pulses = self.dragged.pulses(&rubbing, self.drag_arrives, streams.of(NoiseSource::DragPulses));
        force.add_pulses(&pulses, 1.0);
    }

    /// The finger lets go and rings freely in its two lowest modes.
    fn aftershocks(&self, scene: &Scene<'_>, modes: &Modes, rng: &mut Rng, motion: &mut Motion) {
        for at_s in crossings(&scene.timeline.grip_n, TOUCHED_N).1 {
            // The release takes up to 150 ms; the grip before it counts.
            let strength = (at(&scene.timeline.grip_n, at_s - 0.2).max(0.2) / REFERENCE_N).sqrt();
            for mode in &modes.modes[..2] {
                let hz = mode.hz * modes.shift(0.0);
                let peak = self.aftershock_g * strength * rng.between(0.3, 1.0);
                let decay = log(10.0) / (self.aftershock_s * rng.between(0.8, 1.2));
                let keep = exp(-decay / motion.clock.rate_hz);
                let start = motion.clock.sample_at(at_s);
                let mut envelope = peak;
                for (t, out) in motion.samples().skip(start) {
                    add_scaled(out, envelope * sin_turns(hz * (t - at_s)), mode.direction);
                    envelope *= keep;
                    if envelope < 1e-5 {
                        break;
                    }
                }
            }
        }
    }
}

/// The impacts of the fingers that meet the object at a time: half-sines of Hertz's duration whose area
/// is the change of speed, so that the peak is `π v (1 + e) / 2 t_c`.
pub(super) fn closing(rng: &mut Rng, scene: &Scene<'_>, at_s: f64) -> [Pulse; MAX_SENSORS] {
    // A surface layer of the object, about 1 mm thick, in series with the pad.
    let object_pa = scene.object.surface.normal_kpa_per_mm() * 1e3;
    let speed_m_s = rng.log_between(0.01, 0.12);
    std::array::from_fn(|sensor| {
        let (pad_pa, hard_pa) = (rng.log_between(1e6, 4e6), rng.log_between(0.5e9, 3e9));
        // Hard parts may meet first: a shell's edge, a fixture.
        let modulus_pa = if rng.chance(0.12) { hard_pa } else { 1.0 / (1.0 / pad_pa + 1.0 / object_pa) };
        // Of the moving mass in kg and the radius of the contact in metres.
        let width_s =
            hertz_contact_s(rng.log_between(0.03, 0.1), rng.log_between(2e-3, 15e-3), modulus_pa, speed_m_s);
        let bounce = 1.0 + rng.between(0.1, 0.6);
        let scatter = rng.direction();
        // What the others feel of one finger's impact.
        let mut share = [0.15; MAX_SENSORS];
        share[sensor] = 1.0;
        Pulse {
            at_s: at_s + rng.between(-0.01, 0.02),
            width_s,
            peak_g: (PI * speed_m_s * bounce / (2.0 * width_s) / 9.81).clamp(CLOSING_G.0, CLOSING_G.1),
            direction: [0.3 * scatter[0], 0.3 * scatter[1], 0.95],
            share,
        }
    })
}

/// Times at which a series rises above a threshold and falls below it again, seconds.
fn crossings(series: &[f64], threshold: f64) -> (Vec<f64>, Vec<f64>) {
    let (mut up, mut down) = (Vec::new(), Vec::new());
    for (i, pair) in series.windows(2).enumerate() {
        match (pair[0] > threshold, pair[1] > threshold) {
            (false, true) => up.push((i + 1) as f64 / STEP_HZ),
            (true, false) => down.push((i + 1) as f64 / STEP_HZ),
            _ => {}
        }
    }
    (up, down)
}

/// Low-passed noise of these levels, g rms of the vector, one per step.
fn noise(levels: &[f64], corner_hz: f64, rng: &mut Rng, force: &mut Motion) {
    let blend = blend(corner_hz, force.clock.rate_hz);
    let gain = 1.0 / (blend_rms(blend) * 3f64.sqrt());
    let mut state = Noise::default();
    for (t, out) in force.samples() {
        let level = at(levels, t);
        if level > 0.0 {
            add_scaled(out, gain * level, state.next(rng, blend));
        }
    }
}
