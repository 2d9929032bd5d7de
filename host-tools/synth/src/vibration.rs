//! Vibration of one finger: what excites it, and the modes through which the accelerometer feels it.
//!
//! Excitations are accelerations of the finger's root in its own axes: x across the slip, y along it,
//! z normal to the pad. All sources write into one buffer at the accelerometer's own sample times.

use crate::draw::{Draw, Rng};
use crate::friction::STEP_HZ;
use crate::objects::Object;
use crate::scenario::Plan;
use crate::timeline::Pulse;
use crate::unit::Mode;
use libm::{cos, exp, log, pow, sin, tan};

/// What the interface of one finger does, [`STEP_HZ`] values per second.
#[derive(Default)]
pub(crate) struct Slide {
    pub speed_mm_s: Vec<f64>,
    pub fraction: Vec<f64>,
    pub travel_mm: Vec<f64>,
    pub grip_n: Vec<f64>,
}

/// Excitation of slip at 10 mm/s, 2 N and Ra 1 µm, before the modes, g: with them it gives the 20–60 mg
/// rms that the field expects there.
const SLIP_G: f64 = 0.019;

/// How the gripped surface sounds; the same for all fingers of an episode.
pub(crate) struct Sound {
    object: &'static Object,
    level_g: f64,
    speed_exponent: f64,
    force_exponent: f64,
    /// Wavelength at which asperity noise rolls off, mm.
    asperity_mm: f64,
    /// Slid length between stick-slip pulses at 1 N, mm.
    stick_spacing_mm: f64,
    creak_g: f64,
    creak_hz: f64,
    rail_g: f64,
    rail_hz: f64,
    drag_g: f64,
    drag_hz: f64,
    /// Crosshead drive: cycles per mm, through the object and through the table, g.
    comb_per_mm: f64,
    comb_object_g: f64,
    comb_table_g: f64,
    comb_phases: [f64; 5],
    /// Machines nearby: frequency, amplitude in g, phase.
    ambient: Vec<(f64, f64, f64)>,
}

impl Sound {
    pub(crate) fn draw(rng: &mut Rng, object: &'static Object) -> Self {
        let ambient = if rng.chance(0.5) { rng.count(1, 3) } else { 0 };
        Self {
            object,
            level_g: SLIP_G * pow(object.roughness_um, rng.between(0.4, 0.6)) * exp(0.2 * rng.normal()),
            speed_exponent: rng.between(0.7, 1.0),
            force_exponent: rng.between(0.2, 0.5),
            asperity_mm: rng.log_between(0.004, 0.025),
            stick_spacing_mm: rng.log_between(0.005, 0.08),
            creak_g: rng.log_between(0.003, 0.03),
            creak_hz: rng.log_between(150.0, 800.0),
            rail_g: rng.log_between(0.01, 0.05),
            rail_hz: rng.log_between(100.0, 600.0),
            drag_g: rng.log_between(0.015, 0.06),
            drag_hz: rng.log_between(100.0, 800.0),
            comb_per_mm: rng.log_between(2.0, 40.0),
            comb_object_g: rng.log_between(0.2e-3, 3e-3),
            comb_table_g: rng.log_between(0.05e-3, 0.5e-3),
            comb_phases: std::array::from_fn(|_| rng.phase()),
            ambient: (0..ambient)
                .map(|_| (rng.log_between(25.0, 1500.0), rng.log_between(0.2e-3, 2e-3), rng.phase()))
                .collect(),
        }
    }
}

/// Times of the samples of one accelerometer.
#[derive(Clone, Copy)]
pub(crate) struct Clock {
    pub rate_hz: f64,
    /// Time of the first sample, seconds.
    pub start_s: f64,
    pub samples: usize,
}

impl Clock {
    fn time(&self, n: usize) -> f64 {
        self.start_s + n as f64 / self.rate_hz
    }
    fn sample_at(&self, t: f64) -> usize {
        ((t - self.start_s) * self.rate_hz).ceil().max(0.0) as usize
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

/// White noise through one pole, unit rms times the root of its bandwidth share.
struct Noise([f64; 3]);

impl Noise {
    fn next(&mut self, rng: &mut Rng, blend: f64) -> [f64; 3] {
        for s in &mut self.0 {
            *s += blend * (rng.normal() - *s);
        }
        self.0
    }
}

fn blend(corner_hz: f64, rate_hz: f64) -> f64 {
    let x = std::f64::consts::TAU * corner_hz / rate_hz;
    x / (1.0 + x)
}

/// The excitation of one finger.
pub(crate) struct Excitation<'a> {
    pub plan: &'a Plan,
    pub sound: &'a Sound,
    pub slide: &'a Slide,
    pub clock: Clock,
    pub buffer: Vec<[f64; 3]>,
}

impl<'a> Excitation<'a> {
    pub(crate) fn new(plan: &'a Plan, sound: &'a Sound, slide: &'a Slide, clock: Clock) -> Self {
        Self { plan, sound, slide, clock, buffer: vec![[0.0; 3]; clock.samples] }
    }

    fn add(&mut self, n: usize, gain: f64, v: [f64; 3]) {
        for (b, v) in self.buffer[n].iter_mut().zip(v) {
            *b += gain * v;
        }
    }

    /// Asperity noise and texture lines, weighted by the share of the load that slides.
    pub(crate) fn slip(&mut self, rng: &mut Rng) {
        let (s, object) = (self.sound, self.sound.object);
        let mut noise = Noise([0.0; 3]);
        let lines: Vec<_> = object
            .texture_mm
            .iter()
            .flat_map(|&mm| (1..=4).map(move |k| (mm / k as f64, pow(k as f64, -1.3))))
            .map(|(mm, weight)| (mm, weight, rng.phase()))
            .collect();
        for n in 0..self.clock.samples {
            let t = self.clock.time(n);
            let fraction = at(&self.slide.fraction, t);
            if fraction <= 1e-3 {
                continue;
            }
            let speed = (at(&self.slide.speed_mm_s, t) / fraction.max(0.05)).clamp(0.0, 60.0);
            let level = s.level_g
                * fraction
                * pow(speed / 10.0, s.speed_exponent)
                * pow((at(&self.slide.grip_n, t) / 2.0).max(0.0), s.force_exponent);
            let corner = speed / s.asperity_mm;
            let white = noise.next(rng, blend(corner, self.clock.rate_hz));
            self.add(
                n,
                1.8 * level * (1.0 - object.texture_share),
                [0.5 * white[0], white[1], 0.6 * white[2]],
            );
            let travel = at(&self.slide.travel_mm, t);
            let mut tone = 0.0;
            for &(mm, weight, phase) in &lines {
                // Lines near Nyquist would alias; a real part's own filter stops them.
                if speed / mm < 3_600.0 {
                    tone += weight * cos(std::f64::consts::TAU * travel / mm + phase);
                }
            }
            self.add(n, level * object.texture_share, [0.2 * tone, 0.7 * tone, 0.7 * tone]);
        }
    }

    /// Stick-slip pulses at slid distances, and weak ones where slip spreads over the patch.
    pub(crate) fn stick_slip(&mut self, rng: &mut Rng, pulses: &mut Vec<Pulse>) {
        let s = self.sound;
        let (mut slid, mut next, mut before) = (0.0, 0.0, 0.0);
        for i in 0..self.slide.speed_mm_s.len() {
            let (speed, fraction) = (self.slide.speed_mm_s[i], self.slide.fraction[i]);
            let grip = self.slide.grip_n[i];
            slid += speed / STEP_HZ;
            let growth = (fraction - before).max(0.0);
            before = fraction;
            let gross = slid >= next && fraction > 0.5;
            if gross {
                next = slid + s.stick_spacing_mm * grip.max(0.2) * rng.between(0.7, 1.3);
            }
            let incipient = rng.chance((12.0 * growth).min(1.0));
            let peak = if gross {
                0.03 * s.object.stick_slip * pow(speed / 10.0, 0.6)
            } else if incipient {
                0.03 * rng.between(0.05, 0.3)
            } else {
                continue;
            };
            let x = rng.direction();
            pulses.push(Pulse {
                at_s: (i as f64 + rng.between(0.0, 1.0)) / STEP_HZ,
                width_s: rng.log_between(0.2e-3, 1.5e-3),
                peak_g: peak * (grip / 2.0).sqrt() * -log(rng.between(1e-3, 1.0)),
                direction: [0.4 * x[0], x[1].abs(), 0.6 * x[2]],
                share: [1.0; slipsense::params::MAX_SENSORS],
            });
        }
    }

    /// Grip changes, jaw motion, drags, the rig and machines nearby: everything that is not slip.
    pub(crate) fn disturbances(&mut self, rng: &mut Rng) {
        let (s, rate) = (self.sound, self.clock.rate_hz);
        let mut noises = [Noise([0.0; 3]), Noise([0.0; 3]), Noise([0.0; 3])];
        let blends = [s.creak_hz, s.rail_hz, s.drag_hz].map(|hz| blend(hz, rate));
        let line = &self.plan.timeline;
        for n in 0..self.clock.samples {
            let t = self.clock.time(n);
            let force_rate =
                (at(&line.grip_n, t) - at(&line.grip_n, t - 2.0 / STEP_HZ)).abs() * STEP_HZ / 2.0;
            let levels = [
                // The 2 N/s of tremor and slow variation are silent.
                s.creak_g * ((force_rate - 2.0).max(0.0) / 8.0).sqrt(),
                s.rail_g * at(&line.jaw, t),
                s.drag_g * at(&line.drag, t),
            ];
            for ((noise, level), blend) in noises.iter_mut().zip(levels).zip(blends) {
                if level > 0.0 {
                    let white = noise.next(rng, blend);
                    self.add(n, 1.8 * level, white);
                }
            }
            let x = at(&line.crosshead_mm, t);
            let speed = (x - at(&line.crosshead_mm, t - 1.0 / STEP_HZ)).abs() * STEP_HZ;
            if speed > 0.01 {
                let touched = at(&line.grip_n, t) > 0.05 && self.plan.linked;
                let gain = if touched { s.comb_object_g } else { s.comb_table_g };
                let mut comb = 0.0;
                for (k, phase) in s.comb_phases.iter().enumerate() {
                    let order = (k + 1) as f64;
                    if order * s.comb_per_mm * speed < 3_600.0 {
                        comb += cos(std::f64::consts::TAU * order * s.comb_per_mm * x + phase) / order;
                    }
                }
                self.add(n, gain, [0.2 * comb, comb, 0.3 * comb]);
            }
            let hum: f64 =
                s.ambient.iter().map(|(hz, g, phase)| g * sin(std::f64::consts::TAU * hz * t + phase)).sum();
            self.add(n, 1.0, [0.6 * hum, 0.6 * hum, hum]);
        }
    }

    /// Impacts as half-sines.
    pub(crate) fn impacts(&mut self, pulses: &[Pulse], sensor: usize) {
        for p in pulses {
            let (from, to) = (self.clock.sample_at(p.at_s), self.clock.sample_at(p.at_s + p.width_s));
            for n in from..to.min(self.clock.samples) {
                let phase = (self.clock.time(n) - p.at_s) / p.width_s * std::f64::consts::PI;
                self.add(n, p.peak_g * p.share[sensor] * sin(phase), p.direction);
            }
        }
    }

    /// Through the finger's modes, and the object's own where it is held: acceleration, g.
    pub(crate) fn respond(mut self, modes: &[Mode], coupling: f64) -> Vec<[f64; 3]> {
        let mut filters: Vec<_> = modes
            .iter()
            .map(|m| (m, Biquad::resonant_highpass(m.hz, m.damping, self.clock.rate_hz)))
            .collect();
        let object = self.sound.object;
        let mut ring =
            (object.ring_hz > 0.0).then(|| Biquad::bandpass(object.ring_hz, 0.01, self.clock.rate_hz));
        let grip = &self.plan.timeline.grip_n;
        for n in 0..self.clock.samples {
            let mut input = self.buffer[n];
            if let Some(ring) = &mut ring {
                let struck = if at(grip, self.clock.time(n)) > 0.05 { input[1] + input[2] } else { 0.0 };
                let tone = 3.0 * ring.next(struck);
                input[1] += 0.5 * tone;
                input[2] += tone;
            }
            let mut out = [0.0; 3];
            for (mode, filter) in &mut filters {
                let d = mode.direction;
                let y =
                    mode.weight * coupling * filter.next(d[0] * input[0] + d[1] * input[1] + d[2] * input[2]);
                for (o, d) in out.iter_mut().zip(d) {
                    *o += d * y;
                }
            }
            self.buffer[n] = out;
        }
        self.buffer
    }
}

/// Second-order section, transposed direct form II.
struct Biquad {
    b: [f64; 3],
    a: [f64; 2],
    z: [f64; 2],
}

impl Biquad {
    /// `s² / (s² + 2ζωs + ω²)`: the acceleration of a mode under a force on it.
    fn resonant_highpass(hz: f64, damping: f64, rate_hz: f64) -> Self {
        Self::bilinear(hz, damping, rate_hz, [1.0, -2.0, 1.0], |_| 1.0)
    }

    /// Unity at `hz`, ringing with `damping`.
    fn bandpass(hz: f64, damping: f64, rate_hz: f64) -> Self {
        Self::bilinear(hz, damping, rate_hz, [1.0, 0.0, -1.0], |w| 2.0 * damping * w)
    }

    fn bilinear(hz: f64, damping: f64, rate_hz: f64, b: [f64; 3], gain: impl Fn(f64) -> f64) -> Self {
        let w = tan(std::f64::consts::PI * hz / rate_hz);
        let norm = 1.0 / (1.0 + 2.0 * damping * w + w * w);
        let gain = gain(w) * norm;
        Self {
            b: b.map(|b| b * gain),
            a: [2.0 * (w * w - 1.0) * norm, (1.0 - 2.0 * damping * w + w * w) * norm],
            z: [0.0; 2],
        }
    }

    fn next(&mut self, x: f64) -> f64 {
        let y = self.b[0] * x + self.z[0];
        self.z[0] = self.b[1] * x - self.a[0] * y + self.z[1];
        self.z[1] = self.b[2] * x - self.a[1] * y;
        y
    }
}

/// Gravity and the slow motion of a hand (0.3–3 Hz sway, 8–12 Hz tremor), g; constant on the rig.
pub(crate) struct Carriage {
    gravity: [f64; 3],
    motions: Vec<(f64, f64, f64, [f64; 3])>,
}

impl Carriage {
    pub(crate) fn draw(rng: &mut Rng, hand_held: bool) -> Self {
        let mut motions = Vec::new();
        if hand_held {
            for _ in 0..3 {
                motions.push((
                    rng.log_between(0.3, 3.0),
                    rng.log_between(0.02, 0.2),
                    rng.phase(),
                    rng.direction(),
                ));
            }
            motions.push((
                rng.between(8.0, 12.0),
                rng.log_between(0.005, 0.03),
                rng.phase(),
                rng.direction(),
            ));
        }
        Self { gravity: rng.direction(), motions }
    }

    pub(crate) fn add(&self, clock: Clock, motion_g: &mut [[f64; 3]]) {
        for (n, g) in motion_g.iter_mut().enumerate() {
            let t = clock.time(n);
            for (axis, g) in g.iter_mut().enumerate() {
                *g += self.gravity[axis];
                for (hz, peak, phase, direction) in &self.motions {
                    *g += peak * direction[axis] * sin(std::f64::consts::TAU * hz * t + phase);
                }
            }
        }
    }
}
