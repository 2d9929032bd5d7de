//! A second model of slip vibration, coded without the first one's parts, so that a detector can be
//! tested on a vibration that its training never had: autoregressive noise per speed and force, after the
//! HaTT recipe (Culbertson, Unwin, Kuchenbecker 2014), without finger modes, lines or pulses.
//!
//! `a[n] = −Σ c_k a[n−k] + e[n]` runs as a lattice whose reflection coefficients are interpolated between
//! nodes of speed and force. All nodes have coefficients inside ±1, hence so has every mixture, which is
//! what makes an all-pole lattice stable.

use libm::{cos, exp, log, pow};
use serde::Serialize;
use std::f64::consts::{PI, TAU};

use super::scene::{Motion, SlipSeries};
use super::slip::SILENT_MM_S;
use crate::draw::{Draw, Rng, unit_vector};
use crate::friction::STEP_HZ;
use crate::objects::Object;
use slipsense::params::XL_RATE_HZ;

/// Poles of the model: three resonances and two real poles.
const ORDER: usize = 8;
const SPEEDS_MM_S: [f64; 7] = [1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 40.0];
const FORCES_N: [f64; 3] = [0.5, 2.0, 8.0];
/// Speed in mm/s and median level in mg rms of the vector, at 2 N and Ra 1 µm.
const LEVEL_MG: [(f64, f64); 5] = [(2.0, 4.0), (5.0, 13.0), (10.0, 30.0), (15.0, 49.0), (18.0, 60.0)];
/// Frequencies that the resonance that moves with speed stays within, Hz.
const MOVING_HZ: (f64, f64) = (60.0, 3_200.0);
/// The two that stay where they are, Hz, but for the force that stiffens them.
const FIXED_HZ: [(f64, f64); 2] = [(250.0, 900.0), (1_200.0, 3_000.0)];

type Reflection = [f64; ORDER];

#[derive(Clone, Debug, Serialize)]
pub(crate) struct AutoregressiveNoise {
    level: f64,
    force_exponent: f64,
    axes: [f64; 3],
    nodes: [[Reflection; FORCES_N.len()]; SPEEDS_MM_S.len()],
}

impl AutoregressiveNoise {
    pub(crate) fn draw(rng: &mut Rng, object: &Object) -> Self {
        // Wavelength of the resonance that moves.
        let moving_mm = rng.log_between(0.008, 0.04);
        // Bandwidths: of the moving one over its frequency, of the fixed ones in Hz.
        let moving_width = rng.between(0.4, 1.0);
        let fixed = FIXED_HZ.map(|span| rng.log_uniform(span));
        let widths = FIXED_HZ.map(|_| rng.log_between(150.0, 700.0));
        let stiffens = rng.between(0.05, 0.2);
        // One tilts the spectrum down, one lifts its upper end.
        let real = [rng.between(0.1, 0.6), rng.between(-0.5, -0.1)];
        let nodes = SPEEDS_MM_S.map(|v| {
            FORCES_N.map(|f| {
                let moving = (v / moving_mm).clamp(MOVING_HZ.0, MOVING_HZ.1);
                let shift = pow(f / 2.0, stiffens);
                reflection(
                    [
                        (moving, moving_width * moving),
                        (fixed[0] * shift, widths[0]),
                        ((fixed[1] * shift).min(3_600.0), widths[1]),
                    ],
                    real,
                )
            })
        });
        let axes = unit_vector(std::array::from_fn(|_| rng.between(0.3, 1.0)));
        let roughness_exponent = rng.between(0.6, 0.8);
        Self {
            level: pow(object.roughness_um, roughness_exponent) * exp(0.25 * rng.normal()),
            force_exponent: rng.between(0.2, 0.5),
            axes,
            nodes,
        }
    }

    /// Coefficients between the nodes, bilinear in the logarithms of speed and force.
    pub(super) fn at(&self, speed_mm_s: f64, force_n: f64) -> Reflection {
        let (i, x) = between(&SPEEDS_MM_S, speed_mm_s);
        let (j, y) = between(&FORCES_N, force_n);
        let mix = |a: f64, b: f64, w: f64| a + (b - a) * w;
        std::array::from_fn(|k| {
            let low = mix(self.nodes[i][j][k], self.nodes[i + 1][j][k], x);
            let high = mix(self.nodes[i][j + 1][k], self.nodes[i + 1][j + 1][k], x);
            mix(low, high, y)
        })
    }

    /// Vector rms in g at full slip.
    fn level_g(&self, speed_mm_s: f64, force_n: f64) -> f64 {
        let i = LEVEL_MG.iter().filter(|l| l.0 < speed_mm_s).count().clamp(1, LEVEL_MG.len() - 1);
        let [(v0, l0), (v1, l1)] = [LEVEL_MG[i - 1], LEVEL_MG[i]];
        let slope = log(l1 / l0) / log(v1 / v0);
        1e-3 * l0
            * pow(speed_mm_s / v0, slope)
            * self.level
            * pow((force_n / 2.0).max(1e-6), self.force_exponent)
    }

    pub(crate) fn add(&self, slip: &SlipSeries, rng: &mut Rng, motion: &mut Motion) {
        let mut delays = [[0.0; ORDER]; 3];
        let (mut step, mut gain, mut coefficients) = (usize::MAX, 0.0, [0.0; ORDER]);
        for (t, out) in motion.samples() {
            let now = (t * STEP_HZ) as usize;
            if now >= slip.speed_mm_s.len() {
                break;
            }
            if now != step {
                step = now;
                let share = slip.fraction[now];
                let speed = slip.speed_mm_s[now] / share.max(0.05);
                gain = 0.0;
                if share > 1e-3 && speed > SILENT_MM_S {
                    let force = slip.grip_n[now];
                    coefficients = self.at(speed, force);
                    // The lattice's output has a variance of σ² / Π(1 − k²).
                    let power: f64 = coefficients.iter().map(|k| 1.0 - k * k).product();
                    gain = share * self.level_g(speed, force) * power.sqrt();
                }
            }
            if gain > 0.0 {
                for ((o, delay), axis) in out.iter_mut().zip(&mut delays).zip(self.axes) {
                    *o += axis * lattice(&coefficients, delay, gain * rng.normal());
                }
            } else {
                delays = [[0.0; ORDER]; 3];
            }
        }
    }
}

fn lattice(k: &Reflection, delay: &mut Reflection, input: f64) -> f64 {
    let mut forward = input;
    for m in (0..ORDER).rev() {
        forward -= k[m] * delay[m];
        if m + 1 < ORDER {
            delay[m + 1] = delay[m] + k[m] * forward;
        }
    }
    delay[0] = forward;
    forward
}

/// Where a value lies on a rising scale: index of the node below and logarithmic share of the way to the next.
fn between(scale: &[f64], value: f64) -> (usize, f64) {
    let i = scale.iter().filter(|&&s| s <= value).count().clamp(1, scale.len() - 1) - 1;
    let share = log((value / scale[i]).max(1e-6)) / log(scale[i + 1] / scale[i]);
    (i, share.clamp(0.0, 1.0))
}

/// Poles to reflection coefficients, by the step-down recursion.
fn reflection(resonances: [(f64, f64); 3], real: [f64; 2]) -> Reflection {
    let rate = XL_RATE_HZ as f64;
    let mut a = [0.0; ORDER + 1];
    a[0] = 1.0;
    let mut multiply = |factor: [f64; 3]| {
        let before = a;
        for (n, out) in a.iter_mut().enumerate() {
            *out = (0..3).filter(|&k| k <= n).map(|k| factor[k] * before[n - k]).sum();
        }
    };
    for (hz, width) in resonances {
        let radius = exp(-PI * width / rate);
        multiply([1.0, -2.0 * radius * cos(TAU * hz / rate), radius * radius]);
    }
    multiply([1.0, -(real[0] + real[1]), real[0] * real[1]]);
    let mut k = [0.0; ORDER];
    for m in (1..=ORDER).rev() {
        let last = a[m];
        k[m - 1] = last;
        let before = a;
        for (i, out) in a.iter_mut().enumerate().take(m).skip(1) {
            *out = (before[i] - last * before[m - i]) / (1.0 - last * last);
        }
    }
    k
}
