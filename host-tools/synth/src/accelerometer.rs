//! From acceleration to samples: mounting, gain, bandwidth, noise, clock, clipping, resolution.
//!
//! The generator works at the part's own rate, so what a real part has above half of it is modelled by
//! what is left of it below: the rise towards the package resonance (5–10 kHz) by a symmetric three-tap
//! filter with the resonance's gain at 3 kHz, and the residual that folds back from above by a small
//! mirrored copy of the upper spectrum (each second sample's sign changed, which maps f to 4 kHz − f).

use serde::Serialize;
use slipsense::params::XL_RATE_HZ;
use slipsense::sensor::XlSample;
use slipsense_recording::XL_RATE_TOLERANCE;
use std::f64::consts::TAU;

use crate::draw::{Draw, Rng, dot, unit_vector};
use crate::families::SensorFamily;
use crate::vibration::{Biquad, Clock, Noise, add_scaled, blend, blend_rms, sin_turns};

/// Frequency at which the rise towards the package resonance is matched.
const RESONANCE_MATCH_HZ: f64 = 3_000.0;

#[derive(Clone, Debug, Serialize)]
pub(crate) struct XlUnit {
    /// From finger axes to sensor axes: mounting rotation, gain errors and cross-axis terms together.
    pub matrix: [[f64; 3]; 3],
    pub offset_g: [f64; 3],
    /// Density, g/√Hz: a low-noise part's, in a range set so that the paper's baselines land where they do in it.
    pub noise_g: f64,
    /// Corner of the part's low-pass.
    pub bandwidth_hz: f64,
    pub poles: usize,
    pub resonance_hz: f64,
    /// Share of the upper spectrum that folds back.
    pub alias: f64,
    /// Of the part's own rate; with the session's it stays within the 3 % of data sheets.
    pub rate_error: f64,
}

impl XlUnit {
    pub(crate) fn draw(rng: &mut Rng) -> Self {
        let rotation = rotation(rng);
        // Gain errors on the diagonal, cross-axis terms beside it, after the rotation.
        let errors: [[f64; 3]; 3] = std::array::from_fn(|axis| {
            std::array::from_fn(|from| {
                let range = if axis == from { (0.01, 0.03) } else { (0.01, 0.02) };
                rng.either_sign(range) + if axis == from { 1.0 } else { 0.0 }
            })
        });
        let matrix = errors
            .map(|row| std::array::from_fn(|from| (0..3).map(|via| row[via] * rotation[via][from]).sum()));
        Self {
            matrix,
            offset_g: std::array::from_fn(|_| rng.between(-0.05, 0.05)),
            noise_g: rng.log_between(22e-6, 45e-6),
            bandwidth_hz: rng.between(2_000.0, 4_000.0),
            poles: if rng.chance(0.5) { 2 } else { 1 },
            resonance_hz: rng.between(5_000.0, 10_000.0),
            alias: rng.log_between(0.003, 0.03),
            rate_error: rng.either_sign((0.01, 0.027)),
        }
    }
}

/// What another family than the laboratory's part does besides.
#[derive(Clone, Debug, Serialize)]
pub(crate) enum Quirk {
    /// Noise of as much power in every decade below these corners.
    Flicker { g: f64, corners_hz: [f64; 4] },
    /// A resonance inside the band, and the end of the range.
    Resonant { hz: f64, damping: f64, gain: f64, range_g: f64 },
    /// Gain at the end over that at the start, ticks a second and their size, and the step of the output.
    Worn { end_gain: f64, ticks_per_s: f64, tick_g: f64, step_g: f64 },
}

impl Quirk {
    /// `None` for the laboratory's part; of a part with strong cross-axis terms it changes the matrix too.
    pub(crate) fn draw(family: SensorFamily, rng: &mut Rng, unit: &mut XlUnit) -> Option<Self> {
        Some(match family {
            SensorFamily::Part => return None,
            SensorFamily::Flicker => {
                unit.matrix.iter_mut().flatten().for_each(|m| *m += 0.15 * rng.normal());
                unit.bandwidth_hz = rng.log_between(400.0, 2_500.0);
                let top_hz = rng.log_between(300.0, 2_500.0);
                Self::Flicker {
                    g: rng.log_between(0.3e-3, 4e-3),
                    corners_hz: [1.0, 0.3, 0.1, 0.03].map(|share| share * top_hz),
                }
            }
            SensorFamily::Resonant => Self::Resonant {
                hz: rng.log_between(1_200.0, 3_800.0),
                damping: rng.log_between(0.02, 0.2),
                gain: rng.log_between(1.0, 8.0),
                range_g: rng.log_between(2.0, 4.0),
            },
            SensorFamily::Worn => Self::Worn {
                end_gain: rng.between(0.6, 1.2),
                ticks_per_s: rng.log_between(0.05, 1.0),
                tick_g: rng.log_between(0.02, 0.5),
                step_g: rng.log_between(1e-3, 6e-3),
            },
        })
    }

    /// What it makes of a part's output, g; `rng` is this quirk's own.
    pub(crate) fn apply(&self, output_g: &mut [[f64; 3]], rate_hz: f64, rng: &mut Rng) {
        match *self {
            Self::Flicker { g, corners_hz } => {
                let blends = corners_hz.map(|hz| blend(hz, rate_hz));
                let mut noises: [Noise; 4] = Default::default();
                for out in output_g {
                    for (noise, weight) in noises.iter_mut().zip(blends) {
                        add_scaled(out, g / blend_rms(weight), noise.next(rng, weight));
                    }
                }
            }
            Self::Resonant { hz, damping, gain, range_g } => {
                let mut rings = [Biquad::bandpass(hz, damping, rate_hz); 3];
                for out in output_g {
                    for (value, ring) in out.iter_mut().zip(&mut rings) {
                        *value = (*value + gain * ring.next(*value)).clamp(-range_g, range_g);
                    }
                }
            }
            Self::Worn { end_gain, ticks_per_s, tick_g, step_g } => {
                let last = output_g.len().max(1) as f64;
                for (n, out) in output_g.iter_mut().enumerate() {
                    let gain = 1.0 + (end_gain - 1.0) * n as f64 / last;
                    let tick = rng.chance(ticks_per_s / rate_hz);
                    for value in out {
                        let ticked = if tick { tick_g * rng.normal() } else { 0.0 };
                        *value = ((gain * *value + ticked) / step_g).round() * step_g;
                    }
                }
            }
        }
    }
}

/// One recording with a part: what changes with temperature and time.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct XlSession {
    pub noise: f64,
    /// Its change against the part's own.
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
            offset_g: std::array::from_fn(|_| rng.between(-0.005, 0.005)),
            rate_change: rng.between(-0.002, 0.002),
            rate_drift_per_s: rng.between(-5e-6, 5e-6),
            start: rng.between(0.0, 1.0),
            wander: (
                rng.log_between(0.1e-3, 2e-3),
                rng.log_between(0.005, 0.05),
                std::array::from_fn(|_| rng.between(0.0, 1.0)),
            ),
        }
    }

    /// The part's clock in this recording of `seconds`, with samples enough for the fastest that data sheets allow.
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

/// Samples of one part of full scale ±32768 `lsb_g`; `motion_g` is in finger axes, at the part's sample times.
pub(crate) fn sample(
    unit: &XlUnit,
    session: &XlSession,
    clock: Clock,
    lsb_g: f64,
    motion_g: &[[f64; 3]],
    rng: &mut Rng,
    quirk: Option<(&Quirk, &mut Rng)>,
) -> Vec<XlSample> {
    let weight = blend(unit.bandwidth_hz, clock.rate_hz);
    let noise = unit.noise_g * session.noise * (clock.rate_hz / 2.0).sqrt();
    // An undamped resonance at f₀ lifts f by 1/(1 − (f/f₀)²); the taps −a, 1 + 2a, −a lift it by
    // 1 + 2a (1 − cos ωT), here with 3 kHz at 8 kHz.
    let ratio = RESONANCE_MATCH_HZ / unit.resonance_hz;
    let lift =
        (1.0 / (1.0 - ratio * ratio) - 1.0) / (2.0 * (1.0 - libm::cos(TAU * RESONANCE_MATCH_HZ / 8e3)));
    let (wander_g, wander_hz, wander_phase) = session.wander;
    let Some(&first) = motion_g.first() else { return Vec::new() };
    let turn = |g: [f64; 3]| unit.matrix.map(|row| dot(row, g));
    let first = turn(first);
    let (mut state, mut seen, mut last) = ([first; 2], first, first);
    let mut wander = [0.0; 3];
    let mut output_g: Vec<[f64; 3]> = (0..motion_g.len())
        .map(|n| {
            let next = turn(motion_g[(n + 1).min(motion_g.len() - 1)]);
            if n % 256 == 0 {
                let turns = wander_hz * clock.time(n);
                wander = wander_phase.map(|phase| wander_g * sin_turns(turns + phase));
            }
            let mirror = if n % 2 == 0 { unit.alias / 2.0 } else { -unit.alias / 2.0 };
            let sample = std::array::from_fn(|axis| {
                let (before, now, after) = (last[axis], seen[axis], next[axis]);
                let lifted = now + lift * (2.0 * now - before - after);
                state[0][axis] += weight * (lifted - state[0][axis]);
                state[1][axis] += weight * (state[0][axis] - state[1][axis]);
                state[unit.poles - 1][axis]
                    + mirror * (now - before)
                    + unit.offset_g[axis]
                    + session.offset_g[axis]
                    + wander[axis]
                    + noise * rng.normal()
            });
            (last, seen) = (seen, next);
            sample
        })
        .collect();
    if let Some((quirk, rng)) = quirk {
        quirk.apply(&mut output_g, clock.rate_hz, rng);
    }
    let to_lsb = |g: f64| (g / lsb_g).round().clamp(-32768.0, 32767.0) as i16;
    output_g.into_iter().map(|g| g.map(to_lsb)).collect()
}

/// A rotation drawn uniformly: two random directions made orthogonal, and their cross product.
fn rotation(rng: &mut Rng) -> [[f64; 3]; 3] {
    let a = rng.direction();
    let b = rng.direction();
    let along = dot(a, b);
    let c = unit_vector(std::array::from_fn(|axis| b[axis] - along * a[axis]));
    let d = [a[1] * c[2] - a[2] * c[1], a[2] * c[0] - a[0] * c[2], a[0] * c[1] - a[1] * c[0]];
    [a, c, d]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::{largest, near, power_at, variance, within};
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

    fn power(samples: &[XlSample]) -> f64 {
        let axis = |a: usize| variance(&samples.iter().map(|s| f64::from(s[a])).collect::<Vec<_>>());
        (0..3).map(axis).sum::<f64>() * LSB_G * LSB_G
    }

    fn tone(hz: f64, peak_g: f64, clock: Clock) -> Vec<[f64; 3]> {
        (0..clock.samples)
            .map(|n| {
                let phase = TAU * hz * clock.time(n);
                [peak_g * sin(phase), 0.5 * peak_g * cos(phase), 0.3 * peak_g * sin(phase + 1.0)]
            })
            .collect()
    }

    fn sampled(unit: &XlUnit, motion_g: &[[f64; 3]], clock: Clock) -> Vec<XlSample> {
        sample(unit, &quiet(), clock, LSB_G, motion_g, &mut rng(1), None)
    }

    #[test]
    fn summed_power_does_not_depend_on_the_mounting() {
        let unit = XlUnit::draw(&mut rng(2));
        let clock = quiet().clock(&unit, 1.0);
        let motion = tone(200.0, 0.5, clock);
        let measured = |matrix| power(&sampled(&XlUnit { matrix, ..unit.clone() }, &motion, clock));
        let powers: Vec<f64> = (0..20).map(|seed| measured(rotation(&mut rng(seed)))).collect();
        let lowest = -largest(powers.iter().map(|p| -p));
        within("20 mountings: highest over lowest", largest(powers.clone()) / lowest, ..1.001);
        let off = |seed| (measured(XlUnit::draw(&mut rng(seed)).matrix) / powers[0] - 1.0).abs();
        within("off with gain and cross-axis errors", largest((0..200).map(off)), 0.01..0.1);
    }

    #[test]
    fn noise_has_its_density_and_the_range_clips() {
        let unit = XlUnit { noise_g: 100e-6, ..XlUnit::draw(&mut rng(3)) };
        let session = XlSession { noise: 1.0, ..quiet() };
        let clock = session.clock(&unit, 5.0);
        let still = vec![[0.0; 3]; clock.samples];
        let noise = sample(&unit, &session, clock, LSB_G, &still, &mut rng(4), None);
        let expected = 100e-6 * (clock.rate_hz / 2.0).sqrt();
        near("noise per axis, g rms", (power(&noise) / 3.0).sqrt(), expected, 0.02);

        let loud = sampled(&unit, &tone(100.0, 20.0, clock), clock);
        let (lo, hi) = loud.iter().flatten().fold((0, 0), |(lo, hi), &s| (s.min(lo), s.max(hi)));
        assert_eq!((lo, hi), (i16::MIN, i16::MAX), "20 g on a part of ±8 g");
    }

    #[test]
    fn the_band_rolls_off_and_a_little_comes_back_mirrored() {
        let unit = XlUnit { bandwidth_hz: 2_500.0, poles: 2, alias: 0.03, ..XlUnit::draw(&mut rng(5)) };
        let session = XlSession { rate_drift_per_s: 0.0, ..quiet() };
        let clock = session.clock(&unit, 1.0);
        let gain = |hz: f64| (power(&sampled(&unit, &tone(hz, 1.0, clock), clock)[100..]) / 0.67).sqrt();
        let low = gain(100.0);
        within("gain at 100 Hz", low, 0.95..1.05);
        within("at 3.5 kHz", gain(3_500.0), ..0.95 * low);
        let samples = sampled(&unit, &tone(3_000.0, 1.0, clock), clock);
        let samples: Vec<_> = samples.iter().map(|sample| sample.map(f64::from)).collect();
        // Part of a tone at f that folds to half the rate less f.
        let turns = 3_000.0 / clock.rate_hz;
        let mirrored = (power_at(&samples, 0.5 - turns) / power_at(&samples, turns)).sqrt();
        within("mirror image of 3 kHz", mirrored, 0.01..0.06);
    }

    #[test]
    fn clocks_stay_within_the_tolerance_of_the_format() {
        let off = |seed| {
            let mut rng = rng(seed);
            let unit = XlUnit::draw(&mut rng);
            let clock = XlSession::draw(&mut rng, 1.0).clock(&unit, 120.0);
            let last = clock.ends(28_800)[28_799];
            assert!(last as usize <= clock.samples);
            (f64::from(last) / 120.0 / 8_000.0 - 1.0).abs()
        };
        within("rates off by up to", largest((0..2000).map(off)), 0.025..XL_RATE_TOLERANCE);
    }
}
