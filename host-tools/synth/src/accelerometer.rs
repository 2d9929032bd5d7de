//! From acceleration to samples: mounting, gain, bandwidth, noise, clock, clipping, resolution.
//!
//! The generator works at the part's own rate, so what a real part has above half of it is modelled by
//! what is left of it below: the rise towards the package resonance (5–10 kHz) by a symmetric three-tap
//! filter with the resonance's gain at 3 kHz, and the residual that folds back from above by a small
//! mirrored copy of the upper spectrum (each second sample's sign changed, which maps f to 4 kHz − f).

use libm::exp;
use serde::Serialize;
use slipsense::params::XL_RATE_HZ;
use slipsense::sensor::XlSample;
use slipsense_recording::XL_RATE_TOLERANCE;
use std::f64::consts::TAU;

use crate::draw::{Draw, Rng};
use crate::vibration::{Clock, sin_turns};

/// Noise density, g/√Hz: the modelling range of a low-noise part, set so that the paper's baselines land
/// where they do in the paper.
const NOISE_G: (f64, f64) = (22e-6, 45e-6);
/// Size of an axis's gain error and of each cross-axis term.
const GAIN_ERROR: (f64, f64) = (0.01, 0.03);
const CROSS_AXIS: (f64, f64) = (0.01, 0.02);
/// Offset, g.
const OFFSET_G: f64 = 0.05;
/// Corner of the part's low-pass, Hz, and the chance that it has two poles.
const BANDWIDTH_HZ: (f64, f64) = (2_000.0, 4_000.0);
const TWO_POLES: f64 = 0.5;
/// Package resonance, Hz, and the frequency at which its rise is matched.
const RESONANCE_HZ: (f64, f64) = (5_000.0, 10_000.0);
const RESONANCE_MATCH_HZ: f64 = 3_000.0;
/// Share of the upper spectrum that comes back mirrored.
const ALIAS: (f64, f64) = (0.003, 0.03);
/// Error of the part's own rate; with the session's it stays within the 3 % of data sheets.
const RATE_ERROR: (f64, f64) = (0.01, 0.027);
/// Change of the rate from session to session, and its drift within one, per second.
const SESSION_RATE: f64 = 0.002;
const RATE_DRIFT_PER_S: f64 = 5e-6;
/// Offset's change from session to session and its slow wander: g, and Hz.
const SESSION_OFFSET_G: f64 = 0.005;
const WANDER_G: (f64, f64) = (0.1e-3, 2e-3);
const WANDER_HZ: (f64, f64) = (0.005, 0.05);

/// One part as built and mounted.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct XlUnit {
    /// From finger axes to sensor axes: mounting rotation, gain errors and cross-axis terms together.
    pub matrix: [[f64; 3]; 3],
    /// Offset, g.
    pub offset_g: [f64; 3],
    /// Noise density, g/√Hz.
    pub noise_g: f64,
    /// Corner of the part's own low-pass, Hz.
    pub bandwidth_hz: f64,
    /// Order of the low-pass, 1 or 2.
    pub poles: usize,
    /// Package resonance, Hz.
    pub resonance_hz: f64,
    /// Share of the upper spectrum that folds back.
    pub alias: f64,
    /// Relative error of the rate.
    pub rate_error: f64,
}

impl XlUnit {
    pub(crate) fn draw(rng: &mut Rng) -> Self {
        let rotation = rotation(rng);
        // Gain errors on the diagonal, cross-axis terms beside it, after the rotation.
        let errors: [[f64; 3]; 3] = std::array::from_fn(|axis| {
            std::array::from_fn(|from| {
                let range = if axis == from { GAIN_ERROR } else { CROSS_AXIS };
                either_sign(rng, range) + if axis == from { 1.0 } else { 0.0 }
            })
        });
        let matrix = errors
            .map(|row| std::array::from_fn(|from| (0..3).map(|via| row[via] * rotation[via][from]).sum()));
        Self {
            matrix,
            offset_g: std::array::from_fn(|_| rng.between(-OFFSET_G, OFFSET_G)),
            noise_g: rng.log_between(NOISE_G.0, NOISE_G.1),
            bandwidth_hz: rng.between(BANDWIDTH_HZ.0, BANDWIDTH_HZ.1),
            poles: if rng.chance(TWO_POLES) { 2 } else { 1 },
            resonance_hz: rng.between(RESONANCE_HZ.0, RESONANCE_HZ.1),
            alias: rng.log_between(ALIAS.0, ALIAS.1),
            rate_error: either_sign(rng, RATE_ERROR),
        }
    }
}

/// One recording with a part: what changes with temperature and time.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct XlSession {
    /// Factor on the part's noise.
    pub noise: f64,
    /// Offset besides the part's own, g.
    pub offset_g: [f64; 3],
    /// Relative change of the rate against the part's own, and its drift per second.
    pub rate_change: f64,
    pub rate_drift_per_s: f64,
    /// Share of a sample period by which the first sample comes after the recording starts, 0–1.
    pub start: f64,
    /// Slow wander of the offset: g peak, Hz, turns for each axis.
    wander: (f64, f64, [f64; 3]),
}

impl XlSession {
    /// `noise` is the recipe's factor on electrical noise.
    pub(crate) fn draw(rng: &mut Rng, noise: f64) -> Self {
        Self {
            noise,
            offset_g: std::array::from_fn(|_| rng.between(-SESSION_OFFSET_G, SESSION_OFFSET_G)),
            rate_change: rng.between(-SESSION_RATE, SESSION_RATE),
            rate_drift_per_s: rng.between(-RATE_DRIFT_PER_S, RATE_DRIFT_PER_S),
            start: rng.between(0.0, 1.0),
            wander: (
                rng.log_between(WANDER_G.0, WANDER_G.1),
                rng.log_between(WANDER_HZ.0, WANDER_HZ.1),
                std::array::from_fn(|_| rng.between(0.0, 1.0)),
            ),
        }
    }

    /// The part's clock in this recording of `seconds`. Every part delivers as many samples as the fastest
    /// one that the data sheets allow needs.
    pub(crate) fn clock(&self, unit: &XlUnit, seconds: f64) -> Clock {
        let nominal_hz = XL_RATE_HZ as f64;
        Clock {
            rate_hz: nominal_hz * (1.0 + unit.rate_error) * (1.0 + self.rate_change),
            drift_per_s: self.rate_drift_per_s,
            start: self.start,
            samples: (seconds * nominal_hz * (1.0 + XL_RATE_TOLERANCE)).ceil() as usize + 2,
        }
    }
}

/// Samples of one part of full scale ±32768 `lsb_g`: `motion_g` holds the acceleration in finger axes at
/// the part's own sample times.
pub(crate) fn sample(
    unit: &XlUnit,
    session: &XlSession,
    clock: Clock,
    lsb_g: f64,
    motion_g: &[[f64; 3]],
    rng: &mut Rng,
) -> Vec<XlSample> {
    let blend = 1.0 - exp(-TAU * unit.bandwidth_hz / clock.rate_hz);
    let noise = unit.noise_g * session.noise * (clock.rate_hz / 2.0).sqrt();
    // An undamped resonance at f₀ lifts f by 1/(1 − (f/f₀)²); the taps −a, 1 + 2a, −a lift it by
    // 1 + 2a (1 − cos ωT), here with 3 kHz at 8 kHz.
    let ratio = RESONANCE_MATCH_HZ / unit.resonance_hz;
    let lift =
        (1.0 / (1.0 - ratio * ratio) - 1.0) / (2.0 * (1.0 - libm::cos(TAU * RESONANCE_MATCH_HZ / 8e3)));
    let (wander_g, wander_hz, wander_phase) = session.wander;
    let Some(&first) = motion_g.first() else { return Vec::new() };
    let turn = |g: &[f64; 3]| unit.matrix.map(|row| row[0] * g[0] + row[1] * g[1] + row[2] * g[2]);
    let first = turn(&first);
    let (mut state, mut seen, mut last) = ([first; 2], first, first);
    let mut wander = [0.0; 3];
    (0..motion_g.len())
        .map(|n| {
            let next = turn(&motion_g[(n + 1).min(motion_g.len() - 1)]);
            if n % 256 == 0 {
                let turns = wander_hz * clock.time(n);
                wander = wander_phase.map(|phase| wander_g * sin_turns(turns + phase));
            }
            let mirror = if n % 2 == 0 { unit.alias / 2.0 } else { -unit.alias / 2.0 };
            let sample = std::array::from_fn(|axis| {
                let (before, now, after) = (last[axis], seen[axis], next[axis]);
                let lifted = now + lift * (2.0 * now - before - after);
                state[0][axis] += blend * (lifted - state[0][axis]);
                state[1][axis] += blend * (state[0][axis] - state[1][axis]);
                let value = state[unit.poles - 1][axis]
                    + mirror * (now - before)
                    + unit.offset_g[axis]
                    + session.offset_g[axis]
                    + wander[axis]
                    + noise * rng.normal();
                (value / lsb_g).round().clamp(-32768.0, 32767.0) as i16
            });
            (last, seen) = (seen, next);
            sample
        })
        .collect()
}

/// A value of this size, up or down.
fn either_sign(rng: &mut Rng, (lo, hi): (f64, f64)) -> f64 {
    let size = rng.between(lo, hi);
    if rng.chance(0.5) { size } else { -size }
}

/// A rotation drawn uniformly: two random directions made orthogonal, and their cross product.
fn rotation(rng: &mut Rng) -> [[f64; 3]; 3] {
    let a = rng.direction();
    let b = rng.direction();
    let dot: f64 = a.iter().zip(&b).map(|(x, y)| x * y).sum();
    let mut c = [b[0] - dot * a[0], b[1] - dot * a[1], b[2] - dot * a[2]];
    let norm = c.iter().map(|x| x * x).sum::<f64>().sqrt().max(1e-9);
    c.iter_mut().for_each(|x| *x /= norm);
    let d = [a[1] * c[2] - a[2] * c[1], a[2] * c[0] - a[0] * c[2], a[0] * c[1] - a[1] * c[0]];
    [a, c, d]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::{Stream, stream};
    use libm::{cos, sin};

    const LSB_G: f64 = 0.244e-3;

    fn rng(seed: u64) -> Rng {
        stream(seed, Stream::Accelerometer, 0)
    }

    fn quiet() -> XlSession {
        let mut session = XlSession::draw(&mut rng(0), 0.0);
        session.offset_g = [0.0; 3];
        session.wander.0 = 0.0;
        session
    }

    /// Mean square about the mean, summed over the axes, g².
    fn power(samples: &[XlSample]) -> f64 {
        let n = samples.len() as f64;
        (0..3)
            .map(|a| {
                let mean = samples.iter().map(|s| f64::from(s[a])).sum::<f64>() / n;
                samples.iter().map(|s| (f64::from(s[a]) - mean) * (f64::from(s[a]) - mean)).sum::<f64>() / n
            })
            .sum::<f64>()
            * LSB_G
            * LSB_G
    }

    fn tone(hz: f64, peak_g: f64, clock: Clock) -> Vec<[f64; 3]> {
        (0..clock.samples)
            .map(|n| {
                let phase = TAU * hz * clock.time(n);
                [peak_g * sin(phase), 0.5 * peak_g * cos(phase), 0.3 * peak_g * sin(phase + 1.0)]
            })
            .collect()
    }

    fn heard(unit: &XlUnit, motion_g: &[[f64; 3]], clock: Clock) -> Vec<XlSample> {
        sample(unit, &quiet(), clock, LSB_G, motion_g, &mut rng(1))
    }

    #[test]
    fn summed_power_does_not_depend_on_the_mounting() {
        let unit = XlUnit::draw(&mut rng(2));
        let clock = quiet().clock(&unit, 1.0);
        let motion = tone(200.0, 0.5, clock);
        let powers: Vec<f64> = (0..20)
            .map(|seed| {
                let turned = XlUnit { matrix: rotation(&mut rng(seed)), ..unit.clone() };
                power(&heard(&turned, &motion, clock))
            })
            .collect();
        let (lo, hi) = powers.iter().fold((f64::MAX, 0f64), |(lo, hi), &p| (lo.min(p), hi.max(p)));
        println!("summed power over 20 mountings: highest over lowest {:.5}, expected 1", hi / lo);
        assert!(hi / lo < 1.001);

        let drawn: Vec<f64> = (0..200)
            .map(|seed| {
                let matrix = XlUnit::draw(&mut rng(seed)).matrix;
                power(&heard(&XlUnit { matrix, ..unit.clone() }, &motion, clock)) / powers[0]
            })
            .collect();
        let worst = drawn.iter().fold(0f64, |w, p| w.max((p - 1.0).abs()));
        println!("with gain and cross-axis errors: at most {:.1} % off, expected below 10", 100.0 * worst);
        assert!(worst > 0.01 && worst < 0.1);
    }

    #[test]
    fn noise_has_its_density_and_the_range_clips() {
        let unit = XlUnit { noise_g: 100e-6, ..XlUnit::draw(&mut rng(3)) };
        let session = XlSession { noise: 1.0, ..quiet() };
        let clock = session.clock(&unit, 5.0);
        let still = vec![[0.0; 3]; clock.samples];
        let noise = sample(&unit, &session, clock, LSB_G, &still, &mut rng(4));
        let per_axis = (power(&noise) / 3.0).sqrt();
        let expected = 100e-6 * (clock.rate_hz / 2.0).sqrt();
        println!("noise {:.2} mg rms per axis, expected {:.2}", per_axis * 1e3, expected * 1e3);
        assert!((per_axis / expected - 1.0).abs() < 0.02);

        let loud = heard(&unit, &tone(100.0, 20.0, clock), clock);
        let (lo, hi) = loud.iter().flatten().fold((0, 0), |(lo, hi), &s| (s.min(lo), s.max(hi)));
        println!("20 g on a part of ±8 g: {lo} to {hi}");
        assert_eq!((lo, hi), (i16::MIN, i16::MAX));
    }

    #[test]
    fn the_band_rolls_off_and_a_little_comes_back_mirrored() {
        let unit = XlUnit { bandwidth_hz: 2_500.0, poles: 2, alias: 0.03, ..XlUnit::draw(&mut rng(5)) };
        let session = XlSession { rate_drift_per_s: 0.0, ..quiet() };
        let clock = session.clock(&unit, 1.0);
        let gain = |hz: f64| {
            let motion = tone(hz, 1.0, clock);
            let samples = heard(&unit, &motion, clock);
            (power(&samples[100..]) / 0.67).sqrt()
        };
        let (low, high) = (gain(100.0), gain(3_500.0));
        // Part of a tone at f that folds to half the rate less f, by its Fourier sum.
        let at = |samples: &[XlSample], hz: f64| {
            let sums = (0..3).map(|a| {
                let (re, im) = samples.iter().enumerate().fold((0.0, 0.0), |(re, im), (n, s)| {
                    let phase = TAU * hz * n as f64 / clock.rate_hz;
                    (re + f64::from(s[a]) * cos(phase), im + f64::from(s[a]) * sin(phase))
                });
                re * re + im * im
            });
            sums.sum::<f64>().sqrt()
        };
        let samples = heard(&unit, &tone(3_000.0, 1.0, clock), clock);
        let mirrored = at(&samples, clock.rate_hz / 2.0 - 3_000.0) / at(&samples, 3_000.0);
        println!("gain at 100 Hz {low:.2}, at 3.5 kHz {high:.2}; mirror image of 3 kHz {mirrored:.4}");
        assert!((low - 1.0).abs() < 0.05 && high < 0.95 * low);
        assert!(mirrored > 0.01 && mirrored < 0.06);
    }

    #[test]
    fn clocks_stay_within_the_tolerance_of_the_format() {
        let worst = (0..2000)
            .map(|seed| {
                let mut rng = rng(seed);
                let unit = XlUnit::draw(&mut rng);
                let clock = XlSession::draw(&mut rng, 1.0).clock(&unit, 120.0);
                let ends = clock.ends(28_800, 240.0);
                assert!(ends[28_799] as usize <= clock.samples);
                (f64::from(ends[28_799]) / 120.0 / 8_000.0 - 1.0).abs()
            })
            .fold(0.0, f64::max);
        println!("rates off by up to {:.2} %, tolerance 3 %", 100.0 * worst);
        assert!(worst > 0.025 && worst < XL_RATE_TOLERANCE);
    }
}
