//! Labels: by the encoder rule of the paper's rig from the crosshead's position, or, where no crosshead
//! pulls, from what the interface itself does; and by the contact rule from the produced frames.

use std::ops::Range;

use serde::Serialize;
use slipsense::params::CONTACT_SUM_MIN;
use slipsense::sensor::PiezoFrame;

use crate::draw::{Draw, Rng};

/// Resolution of the crosshead encoder (paper).
pub const ENCODER_STEP_MM: f64 = 0.02;
/// Cumulative displacement that starts a slip (paper), and that must remain for it to go on.
pub const ONSET_MM: f64 = 0.07;
/// Interface speed above which, with [`SLIPPING_SHARE`], the interface slips as a whole.
pub const SLIPPING_MM_S: f64 = 0.1;
/// Share of the load on sliding cells above which the interface slips as a whole.
pub const SLIPPING_SHARE: f64 = 0.95;
/// Interruptions of interface slip of up to this many frames (50 ms) belong to it: a stick phase.
pub const GAP_FRAMES: usize = 12;

/// No sensor is touched.
pub const NO_CONTACT: u8 = 0;
/// Contact outside the slip interval.
pub const NO_SLIP: u8 = 1;
/// Contact inside the slip interval.
pub const SLIP: u8 = 2;

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
    pub(crate) fn read(&self, true_mm: impl Fn(f64) -> f64, frames: usize, frame_rate_hz: f64) -> Vec<f32> {
        let reading = |n: f64| steps(true_mm(((n + self.phase) / self.rate_hz).max(0.0)));
        (0..frames)
            .map(|f| {
                let t = (f as f64 + 1.0 + self.lag_frames) / frame_rate_hz;
                let x = t * self.rate_hz - self.phase;
                let (before, after) = (reading(x.floor()), reading(x.floor() + 1.0));
                let between = before + (after - before) * (x - x.floor());
                ((between + 1e-6).floor() * ENCODER_STEP_MM) as f32
            })
            .collect()
    }
}

/// Whole encoder steps in a position. A position on a step must not fall below it by a rounding error.
fn steps(mm: f64) -> f64 {
    (mm / ENCODER_STEP_MM + 1e-6).floor()
}

/// Runs of frames within `within` in which the interface slips as a whole, short interruptions closed.
pub fn interface_intervals(speed_mm_s: &[f32], fraction: &[f32], within: Range<usize>) -> Vec<Range<usize>> {
    let mut found: Vec<Range<usize>> = Vec::new();
    for f in within {
        if f64::from(speed_mm_s[f]) > SLIPPING_MM_S && f64::from(fraction[f]) > SLIPPING_SHARE {
            match found.last_mut() {
                Some(last) if f - last.end <= GAP_FRAMES => last.end = f + 1,
                _ => found.push(f..f + 1),
            }
        }
    }
    found
}

/// Frames of the slip interval: from the first frame more than [`ONSET_MM`] away from the start, to
/// before the first frame from which less than [`ONSET_MM`] of travel remains. Empty if it never moves.
pub fn slip_interval(displacement_mm: &[f32]) -> Range<usize> {
    // Encoder steps are exact in units of a step, not in millimetres.
    let step = |mm: f32| (f64::from(mm) / ENCODER_STEP_MM).round() * ENCODER_STEP_MM;
    let (Some(&first), Some(&last)) = (displacement_mm.first(), displacement_mm.last()) else {
        return 0..0;
    };
    let moved = |mm: f32| (step(mm) - step(first)).abs();
    let remains = |mm: f32| (step(last) - step(mm)).abs();
    let Some(onset) = displacement_mm.iter().position(|&mm| moved(mm) > ONSET_MM) else {
        return 0..0;
    };
    let end = displacement_mm.iter().rposition(|&mm| remains(mm) >= ONSET_MM).map_or(0, |f| f + 1);
    onset..end.max(onset)
}

/// Labels of all frames. A frame has contact when at least one of its `sensors` scans sums to
/// [`CONTACT_SUM_MIN`]; without contact it is [`NO_CONTACT`] even inside a slip interval.
pub fn label(piezo: &[PiezoFrame], sensors: usize, slips: &[Range<usize>]) -> Vec<u8> {
    piezo
        .chunks_exact(sensors)
        .enumerate()
        .map(|(frame, scans)| {
            let touched = scans.iter().any(|scan| scan.sum() >= CONTACT_SUM_MIN);
            match (touched, slips.iter().any(|s| s.contains(&frame))) {
                (false, _) => NO_CONTACT,
                (true, false) => NO_SLIP,
                (true, true) => SLIP,
            }
        })
        .collect()
}

/// Frames that lie in a slip interval and are labelled [`NO_CONTACT`] all the same.
pub fn slip_without_contact(labels: &[u8], slips: &[Range<usize>]) -> usize {
    slips.iter().flat_map(|s| &labels[s.clone()]).filter(|&&l| l == NO_CONTACT).count()
}

#[cfg(test)]
mod tests {
    use super::*;
    use slipsense::params::TAXELS;

    fn scan(sum: u16) -> PiezoFrame {
        let mut counts = [0; TAXELS];
        counts[500] = sum;
        PiezoFrame::from_scan(counts)
    }

    #[test]
    fn the_interval_starts_above_and_ends_below_0_07_mm() {
        // 0.06 is not more than 0.07, 0.08 is; of 0.40 in total, 0.34 leaves 0.06, 0.32 leaves 0.08.
        let mm = [0.0, 0.0, 0.02, 0.06, 0.08, 0.2, 0.32, 0.34, 0.4, 0.4];
        assert_eq!(slip_interval(&mm), 4..7);
        let down: Vec<f32> = mm.iter().map(|x| 5.0 - x).collect();
        assert_eq!(slip_interval(&down), 4..7);
    }

    #[test]
    fn a_move_below_the_threshold_is_no_slip() {
        assert!(slip_interval(&[0.0, 0.02, 0.04, 0.06]).is_empty());
        assert!(slip_interval(&[]).is_empty());
        // 0.08 in all: when it has moved enough to start, too little remains to go on.
        assert!(slip_interval(&[0.0, 0.04, 0.08]).is_empty());
    }

    #[test]
    fn contact_has_precedence_and_one_touched_sensor_is_enough() {
        let piezo = [scan(941), scan(0), scan(941), scan(942), scan(942), scan(3000), scan(0), scan(0)];
        let slip = 1..4;
        let labels = label(&piezo, 2, std::slice::from_ref(&slip));
        assert_eq!(labels, [NO_CONTACT, SLIP, SLIP, NO_CONTACT]);
        assert_eq!(slip_without_contact(&labels, std::slice::from_ref(&slip)), 1);
        assert_eq!(label(&piezo, 2, &[]), [NO_CONTACT, NO_SLIP, NO_SLIP, NO_CONTACT]);
    }

    #[test]
    fn the_interface_slips_where_fast_and_whole_with_short_stick_phases() {
        let mut speed = vec![5.0; 60];
        let fraction: Vec<f32> = (0..60).map(|f| if f < 10 { 0.9 } else { 1.0 }).collect();
        speed[20..20 + GAP_FRAMES].fill(0.0);
        speed[40..41 + GAP_FRAMES].fill(0.0);
        assert_eq!(interface_intervals(&speed, &fraction, 0..60), [10..40, 53..60]);
        assert_eq!(interface_intervals(&speed, &fraction, 12..15), std::slice::from_ref(&(12..15)));
    }

    #[test]
    fn the_encoder_reads_whole_steps_near_the_true_position() {
        let mut rng = crate::draw::stream(1, crate::draw::Stream::Encoder, 0);
        for _ in 0..20 {
            let encoder = Encoder::draw(&mut rng);
            let read = encoder.read(|t| 2.0 * t, 240, 240.0);
            let worst = read
                .iter()
                .enumerate()
                .map(|(f, &mm)| (f64::from(mm) - 2.0 * (f as f64 + 1.0) / 240.0).abs())
                .fold(0.0, f64::max);
            println!("{:.0} Hz: off by up to {worst:.4} mm at 2 mm/s", encoder.rate_hz);
            // Two roundings down, one frame of lag, and the first reading is held.
            assert!(worst < 2.0 * ENCODER_STEP_MM + 2.0 / 240.0 + 2.0 / encoder.rate_hz);
            assert!(read.iter().all(|&mm| {
                let n = f64::from(mm) / ENCODER_STEP_MM;
                (n - n.round()).abs() < 1e-4
            }));
        }
    }
}
