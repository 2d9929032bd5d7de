//! What the sources of vibration are given: what happens, what slips, and the clock to write at.

use slipsense::params::FRAME_RATE_HZ;

use super::signal::{add_scaled, cos_turns};
use crate::families::{Families, SourceFamily};
use crate::friction::STEP_HZ;
use crate::objects::Object;
use crate::recipe::{Platform, VibrationContent};
use crate::timeline::{Pulse, Timeline};

pub(super) const TOUCHED_N: f64 = 0.05;

/// What one finger's interface does, as [`SlipState`](crate::friction::SlipState) says, at [`STEP_HZ`].
#[derive(Clone, Default)]
pub(crate) struct SlipSeries {
    pub speed_mm_s: Vec<f64>,
    pub fraction: Vec<f64>,
    pub path_mm: Vec<f64>,
    pub direction: Vec<[f64; 2]>,
    pub grip_n: Vec<f64>,
}

/// What the vibration needs of a recording's [`Recipe`](crate::Recipe) and [`Plan`](crate::scenario::Plan).
pub(crate) struct Scene<'a> {
    pub platform: Platform,
    pub source: SourceFamily,
    pub families: Families,
    pub content: VibrationContent,
    pub rig_leak: bool,
    pub hand_held: bool,
    pub linked: bool,
    pub shared_table: bool,
    pub object: &'static Object,
    /// Its pulses lack closing impacts, aftershocks and clicks of the jaws, which are made from its series.
    pub timeline: &'a Timeline,
}

/// Times of the samples of one accelerometer, whose clock is off and drifts.
#[derive(Clone, Copy)]
pub(crate) struct Clock {
    pub rate_hz: f64,
    /// Relative change of the rate, per second.
    pub drift_per_s: f64,
    /// Share of a sample period before the first sample, 0–1.
    pub start: f64,
    pub samples: usize,
}

impl Clock {
    pub(crate) fn time(&self, n: usize) -> f64 {
        let x = (n as f64 + self.start) / self.rate_hz;
        // The inverse of `periods`, in the form that holds without drift too.
        2.0 * x / (1.0 + (1.0 + 2.0 * self.drift_per_s * x).sqrt())
    }

    pub(super) fn periods(&self, t: f64) -> f64 {
        t * (1.0 + self.drift_per_s * t / 2.0) * self.rate_hz - self.start
    }

    /// First sample at or after a time.
    pub(super) fn sample_at(&self, t: f64) -> usize {
        self.periods(t).ceil().max(0.0) as usize
    }

    /// Samples available at the end of each frame.
    pub(crate) fn ends(&self, frames: usize) -> Vec<u32> {
        let end = |frame: usize| self.periods(frame as f64 / FRAME_RATE_HZ as f64).floor() + 1.0;
        (1..=frames).map(|frame| end(frame).max(0.0) as u32).collect()
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

/// Acceleration of one finger at its accelerometer's sample times, finger axes, g.
pub(crate) struct Motion {
    pub sensor: usize,
    pub clock: Clock,
    pub g: Vec<[f64; 3]>,
}

impl Motion {
    pub(super) fn still(sensor: usize, clock: Clock) -> Self {
        Self { sensor, clock, g: vec![[0.0; 3]; clock.samples] }
    }

    pub(super) fn samples(&mut self) -> impl Iterator<Item = (f64, &mut [f64; 3])> {
        let clock = self.clock;
        self.g.iter_mut().enumerate().map(move |(n, g)| (clock.time(n), g))
    }

    /// Half-sines, averaged over the sample periods they cover: one shorter than a period has its area too.
    pub(super) fn add_pulses(&mut self, pulses: &[Pulse], gain: f64) {
        let clock = self.clock;
        let half = 0.5 / clock.rate_hz;
        for p in pulses {
            let from = clock.sample_at(p.at_s - half);
            let to = clock.sample_at(p.at_s + p.width_s + half).min(self.g.len());
            // Primitive of the half-sine, over the period.
            let scale =
                gain * p.peak_g * p.share[self.sensor] * p.width_s / std::f64::consts::PI * clock.rate_hz;
            let primitive = |t: f64| -cos_turns(0.5 * ((t - p.at_s) / p.width_s).clamp(0.0, 1.0));
            for (n, out) in self.g.iter_mut().enumerate().take(to).skip(from) {
                let t = clock.time(n);
                add_scaled(out, scale * (primitive(t + half) - primitive(t - half)), p.direction);
            }
        }
    }
}
