//! Labels: by the crosshead's encoder as on the paper's rig, or, where no crosshead pulls, by what the interface does.
//! Encoder and contact rule are those of [`slipsense_recording::label`], by which recordings are labelled too.

use std::ops::Range;

use serde::Serialize;
use slipsense::params::FRAME_RATE_HZ;
pub use slipsense_recording::label::{
    ENCODER_STEP_MM, NO_CONTACT, NO_SLIP, ONSET_MM, SLIP, label, slip_interval, slip_without_contact,
};
use slipsense_recording::score::{Interval, runs};

use crate::draw::{Draw, Rng};

/// Interface speed above which, with [`SLIPPING_SHARE`], the interface slips as a whole.
pub const SLIPPING_MM_S: f64 = 0.1;
/// Share of the load on sliding cells above which the interface slips as a whole.
pub const SLIPPING_SHARE: f64 = 0.95;
/// Interruptions of interface slip of up to this many frames (50 ms) belong to it: a stick phase.
pub const GAP_FRAMES: usize = 12;

/// What decides whether a frame is slip; in the metadata as `label_rule`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Rule {
    /// The crosshead's position, as on the paper's rig: [`slip_interval`].
    Encoder,
    /// Speed and share of the slipping interface, mean over the sensors: [`interface_intervals`].
    Interface,
}

/// Where a position is read from time to time, in steps of [`ENCODER_STEP_MM`].
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct Encoder {
    /// Readings per second.
    pub rate_hz: f64,
    /// By how much its clock is behind the frames', in frames.
    pub lag_frames: f64,
    /// Time of the first reading as a share of the time between two.
    pub phase: f64,
}

impl Encoder {
    /// Stream of 50–240 Hz, its clock up to one frame early or late.
    pub(crate) fn draw(rng: &mut Rng) -> Self {
        Self {
            rate_hz: rng.log_between(50.0, 240.0),
            lag_frames: rng.between(-1.0, 1.0),
            phase: rng.between(0.0, 1.0),
        }
    }

    /// Position at each frame's tick, mm: interpolated between readings and in whole steps again.
    pub(crate) fn read(&self, true_mm: impl Fn(f64) -> f64, frames: usize) -> Vec<f32> {
        // Whole steps. A position on a step must not fall below it by a rounding error.
        let steps = |mm: f64| (mm / ENCODER_STEP_MM + 1e-6).floor();
        let reading = |n: f64| steps(true_mm(((n + self.phase) / self.rate_hz).max(0.0)));
        (0..frames)
            .map(|f| {
                let t = (f as f64 + 1.0 + self.lag_frames) / FRAME_RATE_HZ as f64;
                let x = t * self.rate_hz - self.phase;
                let (before, after) = (reading(x.floor()), reading(x.floor() + 1.0));
                let between = before + (after - before) * (x - x.floor());
                ((between + 1e-6).floor() * ENCODER_STEP_MM) as f32
            })
            .collect()
    }
}

/// Runs of frames within `within` in which the interface slips as a whole, interruptions of up to `gap` frames closed.
pub fn interface_intervals(
    speed_mm_s: &[f32],
    fraction: &[f32],
    within: Range<usize>,
    gap: usize,
) -> Vec<Range<usize>> {
    let mut found: Vec<Range<usize>> = Vec::new();
    for f in within {
        if f64::from(speed_mm_s[f]) > SLIPPING_MM_S && f64::from(fraction[f]) > SLIPPING_SHARE {
            match found.last_mut() {
                Some(last) if f - last.end <= gap => last.end = f + 1,
                _ => found.push(f..f + 1),
            }
        }
    }
    found
}

/// Where the interface slips as a whole: for 50 ms or longer with shorter stick phases closed, and shorter jerks.
pub fn sustained_sliding(speed_mm_s: &[f32], fraction: &[f32]) -> (Vec<Interval>, Vec<Interval>) {
    let found = interface_intervals(speed_mm_s, fraction, 0..speed_mm_s.len(), GAP_FRAMES - 1);
    found.iter().map(|slip| (slip.start, slip.end)).partition(|(start, end)| end - start >= GAP_FRAMES)
}

/// Where cells that bear most of the load slide, however short: slip of the whole, its start and end, turns about a
/// centre that sticks.
pub fn mostly_sliding(speed_mm_s: &[f32], fraction: &[f32]) -> Vec<Interval> {
    runs(speed_mm_s.len(), |f| f64::from(speed_mm_s[f]) > SLIPPING_MM_S && fraction[f] > 0.5)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_interface_slips_where_fast_and_whole_with_short_stick_phases() {
        let mut speed = vec![5.0; 60];
        let fraction: Vec<f32> = (0..60).map(|f| if f < 10 { 0.9 } else { 1.0 }).collect();
        speed[20..20 + GAP_FRAMES].fill(0.0);
        speed[40..41 + GAP_FRAMES].fill(0.0);
        let found = |within| interface_intervals(&speed, &fraction, within, GAP_FRAMES);
        assert_eq!(found(0..60), [10..40, 53..60]);
        assert_eq!(found(12..15), std::slice::from_ref(&(12..15)));
    }

    #[test]
    fn the_encoder_reads_whole_steps_near_the_true_position() {
        let mut rng = crate::draw::stream(1, crate::draw::Stream::Encoder, 0);
        for _ in 0..20 {
            let encoder = Encoder::draw(&mut rng);
            let read = encoder.read(|t| 2.0 * t, 240);
            // Two roundings down, one frame of lag, and the first reading is held.
            let most = 2.0 * ENCODER_STEP_MM + 2.0 / 240.0 + 2.0 / encoder.rate_hz;
            for (f, mm) in read.into_iter().map(f64::from).enumerate() {
                assert!((mm - 2.0 * (f as f64 + 1.0) / 240.0).abs() < most, "{encoder:?}");
                let steps = mm / ENCODER_STEP_MM;
                assert!((steps - steps.round()).abs() < 1e-4);
            }
        }
    }
}
