//! Disturbances beside the scenario's handling, as at the accelerometer: knocks, machines, what rubs where no pad is.

use libm::{exp, pow};
use serde::Serialize;
use slipsense::params::MAX_SENSORS;

use super::scene::Motion;
use super::signal::{Noise, add_scaled, blend, blend_rms, sin_turns};
use crate::draw::{Draw, Rng, Span};
use crate::families::DisturbanceFamily;

/// Cuts off the longest gaps: see [`Draw::exponential`].
const LEAST: f64 = 1e-9;
/// Decay in seconds, peak in g and frequency in Hz. A shake is slow and lasts, a knock rings.
const SHAKE: (Span, Span, Span) = ((0.1, 0.8), (0.05, 0.8), (2.0, 18.0));
const KNOCK: (Span, Span, Span) = ((2e-3, 60e-3), (0.02, 3.0), (20.0, 2_500.0));
/// A machine runs so long, and pauses so long.
const RUNS_S: (f64, f64) = (0.3, 20.0);

/// Something that lasts from one time to another, with so much of it at each sensor.
#[derive(Serialize)]
struct Stretch {
    from_s: f64,
    to_s: f64,
    share: [f64; MAX_SENSORS],
}

impl Stretch {
    fn draw(rng: &mut Rng, from_s: f64, length_s: f64) -> Self {
        Self { from_s, to_s: from_s + length_s, share: std::array::from_fn(|_| rng.between(0.2, 1.0)) }
    }
}

#[derive(Serialize)]
struct Knock {
    at: Stretch,
    peak_g: f64,
    hz: f64,
    /// Until the ring has fallen by e.
    decay_s: f64,
    direction: [f64; 3],
}

#[derive(Serialize)]
struct Machine {
    at: Vec<Stretch>,
    hz: f64,
    /// Peak of each harmonic, g, with its phase in turns.
    harmonics: Vec<(f64, f64)>,
    /// How far its frequency wanders, and how fast.
    wander: f64,
    wander_hz: f64,
    noise_g: f64,
    direction: [f64; 3],
}

#[derive(Serialize)]
struct Stroke {
    at: Stretch,
    /// Level, corner and bursts of its noise.
    rms_g: f64,
    hz: f64,
    burst_hz: f64,
    phase: f64,
    direction: [f64; 3],
}

#[derive(Default, Serialize)]
pub(super) struct Elsewhere {
    knocks: Vec<Knock>,
    machine: Option<Machine>,
    strokes: Vec<Stroke>,
}

impl Elsewhere {
    /// `None` where nothing but the scenario's own handling disturbs.
    pub fn draw(family: DisturbanceFamily, rng: &mut Rng, seconds: f64) -> Option<Self> {
        let mut all = Self::default();
        match family {
            DisturbanceFamily::Handling => return None,
            DisturbanceFamily::Knocks => {
                let per_s = rng.log_between(0.1, 2.0);
                for at_s in rng.moments((0.0, seconds), per_s, LEAST) {
                    let (decay_s, peak_g, hz) = if rng.chance(0.25) { SHAKE } else { KNOCK };
                    let (decay_s, peak_g) = (rng.log_uniform(decay_s), rng.log_uniform(peak_g));
                    let hz = rng.log_uniform(hz);
                    let at = Stretch::draw(rng, at_s, 6.0 * decay_s);
                    all.knocks.push(Knock { at, peak_g, hz, decay_s, direction: rng.direction() });
                }
            }
            DisturbanceFamily::Tools => {
                let rms_g = rng.log_between(1e-3, 60e-3);
                let noise_share = rng.between(0.0, 0.8);
                let slope = rng.between(-1.0, 1.5);
                let count = rng.count(3, 16);
                let peaks: Vec<f64> =
                    (1..=count).map(|k| pow(k as f64, -slope) * exp(0.8 * rng.normal())).collect();
                let norm = (peaks.iter().map(|p| p * p).sum::<f64>() / 2.0).sqrt();
                let tones_g = rms_g * (1.0 - noise_share).sqrt() / norm;
                let harmonics = peaks.iter().map(|p| (tones_g * p, rng.between(0.0, 1.0))).collect();
                let mut at = Vec::new();
                let mut t = -rng.log_uniform(RUNS_S) * rng.between(0.0, 1.0);
                while t < seconds {
                    let (runs_s, pauses_s) = (rng.log_uniform(RUNS_S), rng.log_uniform(RUNS_S));
                    at.push(Stretch::draw(rng, t, runs_s));
                    t += runs_s + pauses_s;
                }
                all.machine = Some(Machine {
                    at,
                    hz: rng.log_between(15.0, 400.0),
                    harmonics,
                    wander: rng.between(0.0, 0.15),
                    wander_hz: rng.log_between(0.05, 3.0),
                    noise_g: rms_g * noise_share.sqrt(),
                    direction: rng.direction(),
                });
            }
            DisturbanceFamily::Rubbing => {
                let per_s = rng.log_between(0.1, 0.8);
                for at_s in rng.moments((0.0, seconds), per_s, LEAST) {
                    let length_s = rng.log_between(0.05, 2.0);
                    all.strokes.push(Stroke {
                        at: Stretch::draw(rng, at_s, length_s),
                        rms_g: rng.log_between(2e-3, 60e-3),
                        hz: rng.log_between(40.0, 2_500.0),
                        burst_hz: rng.log_between(3.0, 60.0),
                        phase: rng.between(0.0, 1.0),
                        direction: rng.direction(),
                    });
                }
            }
        }
        Some(all)
    }

    pub fn add(&self, rng: &mut Rng, motion: &mut Motion) {
        let (sensor, clock) = (motion.sensor, motion.clock);
        let span = |at: &Stretch, len: usize| {
            let to = clock.sample_at(at.to_s).min(len);
            (clock.sample_at(at.from_s).min(to)..to, at.share[sensor])
        };
        let len = motion.g.len();
        for knock in &self.knocks {
            let (samples, share) = span(&knock.at, len);
            for n in samples {
                let since = clock.time(n) - knock.at.from_s;
                let ring = exp(-since / knock.decay_s) * sin_turns(knock.hz * since);
                add_scaled(&mut motion.g[n], share * knock.peak_g * ring, knock.direction);
            }
        }
        if let Some(machine) = &self.machine {
            let mut noise = Noise::default();
            let mut turns = 0.0;
            for at in &machine.at {
                let (samples, share) = span(at, len);
                for n in samples {
                    let t = clock.time(n);
                    let wander = machine.wander * sin_turns(machine.wander_hz * t);
                    turns += machine.hz * (1.0 + wander) / clock.rate_hz;
                    let tones: f64 = (1u32..)
                        .zip(&machine.harmonics)
                        .filter(|(k, _)| f64::from(*k) * machine.hz < 0.45 * clock.rate_hz)
                        .map(|(k, (peak_g, phase))| peak_g * sin_turns(f64::from(k) * turns + phase))
                        .sum();
                    let noise = noise.next(rng, 1.0).map(|x| machine.noise_g * x);
                    add_scaled(&mut motion.g[n], share * tones, machine.direction);
                    add_scaled(&mut motion.g[n], share * std::f64::consts::FRAC_1_SQRT_2, noise);
                }
            }
        }
        for stroke in &self.strokes {
            let (samples, share) = span(&stroke.at, len);
            let weight = blend(stroke.hz, clock.rate_hz);
            let gain = share * stroke.rms_g / blend_rms(weight);
            let mut noise = Noise::default();
            for n in samples {
                let t = clock.time(n);
                let rise = ((t - stroke.at.from_s) / 0.02).min((stroke.at.to_s - t) / 0.02).clamp(0.0, 1.0);
                let burst = 0.6 + 0.4 * sin_turns(stroke.burst_hz * t + stroke.phase);
                let along = noise.next(rng, weight)[0];
                add_scaled(&mut motion.g[n], gain * rise * burst * along, stroke.direction);
            }
        }
    }
}
