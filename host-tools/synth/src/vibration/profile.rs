//! Vibration of two tracks that run over one height profile: the slope under them, read at the slid length.

use libm::{cos, exp, log, pow, sin};
use serde::Serialize;
use std::f64::consts::TAU;

use super::scene::{Motion, SlipSeries};
use super::signal::add_scaled;
use super::slip::{LEVEL_G, REFERENCE_MM_S, REFERENCE_N, SILENT_MM_S};
use crate::draw::{Draw, Rng};
use crate::objects::Object;

/// Points of the profile, which repeats after them, and their distance.
const POINTS: usize = 1 << 15;
const PITCH_MM: f64 = 1e-3;
/// Waves that make it up; the shortest has four points.
const WAVES: usize = 96;

#[derive(Serialize)]
pub(super) struct Profile {
    level_g: f64,
    /// Of the waves' slope over their number.
    exponent: f64,
    speed_exponent: f64,
    force_exponent: f64,
    /// Distance of the second track.
    track_mm: f64,
    /// Along the slip, across it and normal to the pad; of each track.
    axes: [[f64; 3]; 2],
    /// Unit rms.
    #[serde(skip)]
    slope: Vec<f32>,
}

impl Profile {
    pub fn draw(rng: &mut Rng, object: &Object) -> Self {
        let exponent = rng.between(-0.6, 0.6);
        let mut slope = vec![0.0; POINTS];
        let drawn: Vec<(f64, f64)> = (0..WAVES)
            .map(|_| {
                let turns = rng.log_between(1.0, POINTS as f64 / 4.0).round();
                (turns, pow(turns, exponent))
            })
            .collect();
        let lines = object.texture_mm.iter().map(|mm| {
            let share = object.texture_share / object.texture_mm.len() as f64;
            ((POINTS as f64 * PITCH_MM / mm).round(), (share * WAVES as f64).sqrt())
        });
        for (turns, peak) in drawn.iter().copied().chain(lines) {
            let phase = rng.phase();
            let (mut re, mut im) = (peak * cos(phase), peak * sin(phase));
            let (c, s) = (cos(TAU * turns / POINTS as f64), sin(TAU * turns / POINTS as f64));
            for value in &mut slope {
                *value += re;
                (re, im) = (re * c - im * s, re * s + im * c);
            }
        }
        let rms = (slope.iter().map(|x| x * x).sum::<f64>() / POINTS as f64).sqrt().max(1e-12);
        let level = pow(object.roughness_um, 0.5) * exp(0.6 * rng.normal());
        Self {
            level_g: LEVEL_G * level,
            exponent,
            speed_exponent: rng.between(0.4, 1.2),
            force_exponent: rng.between(0.0, 0.6),
            track_mm: rng.log_between(0.3, 6.0),
            axes: std::array::from_fn(|_| rng.direction()),
            slope: slope.iter().map(|x| (x / rms) as f32).collect(),
        }
    }

    fn at(&self, mm: f64) -> f64 {
        let x = mm / PITCH_MM;
        let whole = x as usize;
        let (near, far) = (self.slope[whole % POINTS], self.slope[(whole + 1) % POINTS]);
        f64::from(near) + f64::from(far - near) * (x - whole as f64)
    }

    pub fn add(&self, rubbing: &SlipSeries, force: &mut Motion) {
        let level = |i: usize| {
            let (speed, share) = (rubbing.speed_mm_s[i], rubbing.fraction[i]);
            if share < 1e-3 || speed < SILENT_MM_S {
                return 0.0;
            }
            let load = (rubbing.grip_n[i] / REFERENCE_N).max(1e-6);
            let gain = self.speed_exponent * log(speed / REFERENCE_MM_S) + self.force_exponent * log(load);
            share * self.level_g * exp(gain)
        };
        rubbing.each_sample(level, force, |now, _, level, path_mm, out| {
            for (track, axes) in self.axes.iter().enumerate() {
                let slope = self.at(path_mm + track as f64 * self.track_mm);
                add_scaled(out, level * slope * std::f64::consts::FRAC_1_SQRT_2, rubbing.turned(now, *axes));
            }
        });
    }
}
