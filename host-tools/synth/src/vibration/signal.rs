//! Building blocks: a sine by polynomial, noise through one pole, second-order sections.

use libm::{cos, exp, sin};
use serde::Serialize;
use std::f64::consts::TAU;

use crate::draw::{Draw, Rng};

/// `sin(2π · turns)` to within 4·10⁻⁶: fast, and additions and multiplications give the same bits everywhere.
pub(crate) fn sin_turns(turns: f64) -> f64 {
    let mut r = turns - turns as i64 as f64;
    if r > 0.5 {
        r -= 1.0;
    } else if r < -0.5 {
        r += 1.0;
    }
    if r > 0.25 {
        r = 0.5 - r;
    } else if r < -0.25 {
        r = -0.5 - r;
    }
    let x = TAU * r;
    let q = x * x;
    x * (1.0
        - q * (1.0 / 6.0) * (1.0 - q * (1.0 / 20.0) * (1.0 - q * (1.0 / 42.0) * (1.0 - q * (1.0 / 72.0)))))
}

pub(crate) fn cos_turns(turns: f64) -> f64 {
    sin_turns(turns + 0.25)
}

/// `out += factor · v`.
pub(crate) fn add_scaled(out: &mut [f64; 3], factor: f64, v: [f64; 3]) {
    out.iter_mut().zip(v).for_each(|(out, v)| *out += factor * v);
}

/// A periodic tone of several harmonics. Only its fundamental is computed; the others follow by rotation.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Harmonics {
    /// Of each harmonic: peak times cosine and times sine of its phase.
    parts: Vec<[f64; 2]>,
}

impl Harmonics {
    /// Harmonics of these peaks, scaled to a sum of unit rms, with phases of their own.
    pub(crate) fn draw(rng: &mut Rng, peaks: impl Iterator<Item = f64> + Clone) -> Self {
        let rms = (peaks.clone().map(|p| p * p).sum::<f64>() / 2.0).sqrt();
        let parts = peaks
            .map(|peak| {
                let phase = rng.phase();
                [peak / rms * cos(phase), peak / rms * sin(phase)]
            })
            .collect();
        Self { parts }
    }

    /// Value where the fundamental is at `turns`; `gains` are factors on the harmonics, silent beyond its end.
    pub(crate) fn at(&self, turns: f64, gains: &[f64]) -> f64 {
        let (c, s) = (cos_turns(turns), sin_turns(turns));
        let (mut ck, mut sk, mut sum) = (c, s, 0.0);
        for ([a, b], gain) in self.parts.iter().zip(gains) {
            sum += gain * (a * ck - b * sk);
            (ck, sk) = (ck * c - sk * s, sk * c + ck * s);
        }
        sum
    }
}

/// Weight of the newest value in a first-order low-pass with this corner.
pub(crate) fn blend(corner_hz: f64, rate_hz: f64) -> f64 {
    1.0 - exp(-TAU * corner_hz / rate_hz)
}

/// Rms of unit white noise after a first-order low-pass of this [`blend`].
pub(crate) fn blend_rms(blend: f64) -> f64 {
    (blend / (2.0 - blend)).sqrt()
}

/// Three axes of unit white noise through one pole.
#[derive(Default)]
pub(crate) struct Noise([f64; 3]);

impl Noise {
    pub(crate) fn next(&mut self, rng: &mut Rng, blend: f64) -> [f64; 3] {
        for s in &mut self.0 {
            *s += blend * (rng.normal() - *s);
        }
        self.0
    }
}

/// Second-order section, transposed direct form II.
#[derive(Clone, Copy)]
pub(crate) struct Biquad {
    b: [f64; 3],
    a: [f64; 2],
    z: [f64; 2],
}

impl Biquad {
    /// `s² / (s² + 2ζωs + ω²)`: the acceleration of a mode under a force on it.
    pub(crate) fn resonant_highpass(hz: f64, damping: f64, rate_hz: f64) -> Self {
        Self::resonator(hz, damping, rate_hz, [1.0, -2.0, 1.0], 0.5 / damping)
    }

    /// Unity at `hz`, ringing with `damping`.
    pub(crate) fn bandpass(hz: f64, damping: f64, rate_hz: f64) -> Self {
        Self::resonator(hz, damping, rate_hz, [1.0, 0.0, -1.0], 1.0)
    }

    /// Poles where the continuous ones go in one sample period, so that ringing has its frequency and its
    /// decay up to half the rate (a bilinear transform would halve the decay at 2.5 kHz); `peak` is the
    /// gain at `hz`.
    fn resonator(hz: f64, damping: f64, rate_hz: f64, zeros: [f64; 3], peak: f64) -> Self {
        let w = TAU * hz / rate_hz;
        let radius = exp(-damping * w);
        let a = [-2.0 * radius * cos(w * (1.0 - damping * damping).sqrt()), radius * radius];
        let (c, s) = (cos(w), sin(w));
        let (c2, s2) = (c * c - s * s, 2.0 * s * c);
        let size = |k: [f64; 3]| {
            let (re, im) = (k[0] + k[1] * c + k[2] * c2, k[1] * s + k[2] * s2);
            (re * re + im * im).sqrt()
        };
        let gain = peak * size([1.0, a[0], a[1]]) / size(zeros);
        Self { b: zeros.map(|b| b * gain), a, z: [0.0; 2] }
    }

    /// Take over another section's coefficients and go on ringing.
    pub(crate) fn retune(&mut self, to: Self) {
        (self.b, self.a) = (to.b, to.a);
    }

    pub(crate) fn next(&mut self, x: f64) -> f64 {
        let y = self.b[0] * x + self.z[0];
        self.z[0] = self.b[1] * x - self.a[0] * y + self.z[1];
        self.z[1] = self.b[2] * x - self.a[1] * y;
        // Nothing that is added to it keeps less; what rings on in silence would become subnormal, which is slow.
        self.z.iter_mut().filter(|z| z.abs() < 1e-250).for_each(|z| *z = 0.0);
        y
    }
}
