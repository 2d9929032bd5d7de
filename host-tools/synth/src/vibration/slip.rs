//! The vibration of rubbing: asperity noise, texture lines and stick-slip pulses at the finger's root, before its modes.

use libm::{exp, log, pow};
use serde::Serialize;
use slipsense::params::{MAX_SENSORS, XL_RATE_HZ};

use super::scene::{Motion, SlipSeries};
use super::signal::{Harmonics, Noise, add_scaled, blend, blend_rms};
use crate::draw::{Draw, Rng, unit_vector};
use crate::friction::STEP_HZ;
use crate::objects::Object;
use crate::timeline::Pulse;

/// Vector rms of the excitation at 10 mm/s, 2 N and Ra 1 µm, g: through the modes of a parallel jaw's
/// finger it gives about 30 mg, the middle of the 20–60 mg that slip of that speed shows.
pub(super) const LEVEL_G: f64 = 0.0186;
/// Speed, force and roughness that the level is stated at.
pub(super) const REFERENCE_MM_S: f64 = 10.0;
pub(super) const REFERENCE_N: f64 = 2.0;
/// Texture lines per wavelength.
const LINES: usize = 6;
/// Lines fade out between these frequencies, Hz: the part's own filter stops them.
const LINE_FADE_HZ: (f64, f64) = (3_200.0, 3_800.0);
/// Slower than this nothing vibrates; faster than the other nothing changes, mm/s.
pub(super) const SILENT_MM_S: f64 = 0.05;
const FASTEST_MM_S: f64 = 60.0;
/// Share of the load that must slide for slip to count as gross.
const GROSS: f64 = 0.5;

/// Rms of the pulses of an object of stick-slip 1, as a share of the asperity noise at the reference.
const STICK_LEVEL: f64 = 0.5;
/// Highest pulse rate, Hz.
const STICK_MAX_HZ: f64 = 2_200.0;
const STICK_WIDTH_S: (f64, f64) = (0.2e-3, 2e-3);
/// Micro-slip while slip spreads: pulses as the whole patch lets go once, amplitude over gross, and the
/// growth of the sliding share in one step at which that amplitude is reached.
const INCIPIENT_PULSES: f64 = 40.0;
const INCIPIENT_AMPLITUDE: (f64, f64) = (0.05, 0.3);
const INCIPIENT_GROWTH: f64 = 0.02;

/// How strongly noise and lines move along the slip, across it and normal to the pad; unit vectors.
const NOISE_AXES: [f64; 3] = [0.788, 0.394, 0.473];
const LINE_AXES: [f64; 3] = [0.693, 0.198, 0.693];

#[derive(Clone, Debug, Serialize)]
struct Line {
    wavelength_mm: f64,
    /// Rms share of the sum over all wavelengths.
    rms: f64,
    shape: Harmonics,
}

#[derive(Clone, Debug, Serialize)]
pub(super) struct Stick {
    /// Mean peak of gross slip's pulses at the reference, g.
    peak_g: f64,
    /// Of the amplitude; the rate is proportional to speed besides.
    speed_exponent: f64,
    /// Slid length between two pulses per newton of grip, mm/N.
    pub(super) spacing_mm_per_n: f64,
    /// Relative jitter of a quasi-periodic train; `None`: the pulses come at random.
    jitter: Option<f64>,
}

#[derive(Clone, Debug, Serialize)]
pub(crate) struct Surface {
    /// Vector rms of the excitation at the reference, g.
    pub level_g: f64,
    /// p_v of the asperity amplitude. Friction-noise experiments find 0.6 to 1.0, about 3/4, for levels; this is the
    /// lower part of the range, because the rms here rises faster than the amplitude: the roll-off moves up with speed,
    /// lets more noise through and moves it towards the modes.
    pub speed_exponent: f64,
    pub force_exponent: f64,
    /// Wavelength λ_c of the asperity roll-off `f_c = v/λ_c`.
    pub asperity_mm: f64,
    /// Share of the power at the reference that is texture lines.
    line_share: f64,
    lines: Vec<Line>,
    pub(super) stick: Stick,
}

impl SlipSeries {
    /// The same with the speed of what slides, not of the whole patch.
    pub(super) fn rubbing(&self) -> Self {
        let speed = |(v, share): (&f64, &f64)| (v / share.max(0.05)).min(FASTEST_MM_S);
        Self { speed_mm_s: self.speed_mm_s.iter().zip(&self.fraction).map(speed).collect(), ..self.clone() }
    }

    /// From finger axes "along, across, normal" to x, y, z at a step.
    pub(super) fn turned(&self, step: usize, v: [f64; 3]) -> [f64; 3] {
        let [x, y] = self.direction[step];
        [x * v[0] - y * v[1], y * v[0] + x * v[1], v[2]]
    }

    /// Go through the samples at which something vibrates. `level` is how much at a step; `each` gets the step, whether
    /// it is another than before, level and slid length in between, and the sample.
    pub(super) fn each_sample(
        &self,
        level: impl Fn(usize) -> f64,
        force: &mut Motion,
        mut each: impl FnMut(usize, bool, f64, f64, &mut [f64; 3]),
    ) {
        let (mut step, mut from, mut to) = (usize::MAX, 0.0, 0.0);
        for (t, out) in force.samples() {
            let x = t * STEP_HZ;
            let now = x as usize;
            if now + 1 >= self.speed_mm_s.len() {
                break;
            }
            let new = now != step;
            if new {
                from = if now == step.wrapping_add(1) { to } else { level(now) };
                (to, step) = (level(now + 1), now);
            }
            if from <= 0.0 && to <= 0.0 {
                continue;
            }
            let within = x - now as f64;
            let path_mm = self.path_mm[now] + (self.path_mm[now + 1] - self.path_mm[now]) * within;
            each(now, new, from + (to - from) * within, path_mm, out);
        }
    }
}

/// A level at the reference, at another speed, mm/s, and force, N: proportional to powers of both.
pub(super) fn from_reference(level: f64, (speed_mm_s, force_n): (f64, f64), exponents: (f64, f64)) -> f64 {
    level
        * pow(speed_mm_s / REFERENCE_MM_S, exponents.0)
        * pow((force_n / REFERENCE_N).max(1e-6), exponents.1)
}

impl Surface {
    /// The surface of an object of the catalogue against a finger.
    pub(crate) fn draw(rng: &mut Rng, object: &Object) -> Self {
        let stick = (object.stick_slip, (object.mu_static - object.mu_kinetic).max(0.02));
        Self::new(rng, object.roughness_um, &object.texture_mm, object.texture_share, stick)
    }

    /// A table, a floor, a box: what a gripped object is dragged over.
    pub(crate) fn table(rng: &mut Rng) -> Self {
        let (roughness_um, wavelength_mm) = (rng.log_between(0.5, 10.0), rng.log_between(0.05, 2.0));
        let (share, stick) = (rng.between(0.0, 0.6), rng.between(0.0, 0.8));
        Self::new(rng, roughness_um, &[wavelength_mm], share, (stick, 0.1))
    }

    fn new(
        rng: &mut Rng,
        roughness_um: f64,
        texture_mm: &[f64],
        line_share: f64,
        (stick_slip, slack): (f64, f64),
    ) -> Self {
        let roughness = pow(roughness_um, rng.between(0.6, 0.8));
        // Surfaces of the same roughness differ.
        let level_g = LEVEL_G * roughness * exp(0.2 * rng.normal());
        // The k-th line has an amplitude ∝ k^−β.
        let exponent = rng.between(1.0, 2.0);
        let rms = 1.0 / (texture_mm.len() as f64).sqrt();
        let peaks = (1..=LINES).map(|k| pow(k as f64, -exponent));
        let lines: Vec<Line> = texture_mm
            .iter()
            .map(|&wavelength_mm| Line { wavelength_mm, rms, shape: Harmonics::draw(rng, peaks.clone()) })
            .collect();
        // Stiffness K in the period `T ≈ 2Δμ N / (K v)`, N/mm.
        let spacing_mm_per_n = 2.0 * slack / rng.log_between(2.0, 50.0);
        // Half-sines of mean peak m, exponentially spread, have a mean square of rate · m² · width: that fixes m.
        let rate = (REFERENCE_MM_S / (spacing_mm_per_n * REFERENCE_N)).min(STICK_MAX_HZ);
        let width = (STICK_WIDTH_S.1 - STICK_WIDTH_S.0) / log(STICK_WIDTH_S.1 / STICK_WIDTH_S.0);
        let jitter = rng.between(0.2, 0.4);
        Self {
            level_g,
            speed_exponent: rng.between(0.6, 0.75),
            force_exponent: rng.between(0.2, 0.5),
            asperity_mm: rng.log_between(0.005, 0.05),
            line_share: if lines.is_empty() { 0.0 } else { line_share },
            lines,
            stick: Stick {
                peak_g: STICK_LEVEL * stick_slip * level_g / (rate * width).sqrt(),
                speed_exponent: rng.between(0.5, 0.9),
                spacing_mm_per_n,
                jitter: (!rng.chance(0.3)).then_some(jitter),
            },
        }
    }

    /// `A = A₀ (v/10 mm/s)^p_v (F/2 N)^p_F`, g: the rms that noise and lines would have if the roll-off
    /// stayed where it is at the reference.
    pub(super) fn amplitude_g(&self, speed_mm_s: f64, force_n: f64) -> f64 {
        from_reference(self.level_g, (speed_mm_s, force_n), (self.speed_exponent, self.force_exponent))
    }

    /// Asperity noise and texture lines, by the share of the load that slides, into `force` times `gain`.
    pub(crate) fn add_rubbing(&self, rubbing: &SlipSeries, gain: f64, rng: &mut Rng, force: &mut Motion) {
        let rate_hz = force.clock.rate_hz;
        let audible = |i: usize| rubbing.fraction[i] > 1e-3 && rubbing.speed_mm_s[i] > SILENT_MM_S;
        let level = |i: usize| match audible(i) {
            true => gain * rubbing.fraction[i] * self.amplitude_g(rubbing.speed_mm_s[i], rubbing.grip_n[i]),
            false => 0.0,
        };
        let reference = blend_rms(blend(REFERENCE_MM_S / self.asperity_mm, XL_RATE_HZ as f64));
        let (noise_gain, line_gain) =
            ((1.0 - self.line_share).max(0.0).sqrt() / reference, self.line_share.max(0.0).sqrt());
        let (mut noise, mut weight) = (Noise::default(), 0.0);
        let mut fades = vec![[0.0; LINES]; self.lines.len()];
        rubbing.each_sample(level, force, |now, new, level, path_mm, out| {
            if new {
                let speed = rubbing.speed_mm_s[now].max(rubbing.speed_mm_s[now + 1]);
                weight = blend(speed / self.asperity_mm, rate_hz);
                for (fades, line) in fades.iter_mut().zip(&self.lines) {
                    for (k, fade) in fades.iter_mut().enumerate() {
                        let hz = (k + 1) as f64 * speed / line.wavelength_mm;
                        let below = (LINE_FADE_HZ.1 - hz) / (LINE_FADE_HZ.1 - LINE_FADE_HZ.0);
                        *fade = below.clamp(0.0, 1.0);
                    }
                }
            }
            let white = noise.next(rng, weight);
            let mut tone = 0.0;
            for (line, fade) in self.lines.iter().zip(&fades) {
                tone += line.rms * line.shape.at(path_mm / line.wavelength_mm, fade);
            }
            let v: [f64; 3] = std::array::from_fn(|a| {
                noise_gain * NOISE_AXES[a] * white[a] + line_gain * LINE_AXES[a] * tone
            });
            add_scaled(out, level, rubbing.turned(now, v));
        });
    }

    /// Stick-slip pulses at slid distances, and weak ones where slip spreads over the patch.
    pub(crate) fn pulses(&self, rubbing: &SlipSeries, gain: f64, rng: &mut Rng) -> Vec<Pulse> {
        let mut pulses = Vec::new();
        let stick = &self.stick;
        if stick.peak_g <= 0.0 {
            return pulses;
        }
        let (mut slid, mut next, mut before) = (0.0, 0.0, 0.0);
        for (i, (&speed, &share)) in rubbing.speed_mm_s.iter().zip(&rubbing.fraction).enumerate() {
            let force = rubbing.grip_n[i];
            let growth = (share - before).max(0.0);
            before = share;
            let exponents = (stick.speed_exponent, self.force_exponent + 0.5);
            let mean_g = |share: f64| from_reference(gain * share * stick.peak_g, (speed, force), exponents);
            let mut emit = |rng: &mut Rng, mean_g: f64, within: f64| {
                let scatter = rng.direction();
                pulses.push(Pulse {
                    at_s: (i as f64 + within) / STEP_HZ,
                    width_s: rng.log_uniform(STICK_WIDTH_S),
                    peak_g: mean_g * rng.exponential(1e-4),
                    direction: rubbing
                        .turned(i, unit_vector([1.0 + 0.5 * scatter[0], 0.5 * scatter[1], scatter[2]])),
                    share: [1.0; MAX_SENSORS],
                });
            };
            if share > GROSS && speed > SILENT_MM_S {
                let moved = speed / STEP_HZ;
                let spacing = (stick.spacing_mm_per_n * force).max(speed / STICK_MAX_HZ);
                let gap = |rng: &mut Rng| match stick.jitter {
                    Some(jitter) => spacing * (1.0 + jitter * rng.normal()).max(0.1),
                    None => spacing * rng.exponential(1e-4),
                };
                if next <= slid {
                    next = slid + gap(rng);
                }
                while next <= slid + moved {
                    emit(rng, mean_g(share), (next - slid) / moved);
                    next += gap(rng);
                }
                slid += moved;
            } else if growth > 0.0 && rng.chance((INCIPIENT_PULSES * growth).min(1.0)) {
                let area = (growth / INCIPIENT_GROWTH).min(1.0);
                let (weak, strong) = INCIPIENT_AMPLITUDE;
                let within = rng.between(0.0, 1.0);
                emit(rng, mean_g(weak + (strong - weak) * area), within);
            }
        }
        pulses
    }
}
