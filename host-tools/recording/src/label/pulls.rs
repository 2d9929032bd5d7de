//! The movements of a crosshead, and the slip that each would be.

use std::ops::Range;

use slipsense::params::FRAME_RATE_HZ;

use super::rule::{ENCODER_STEP_MM, ONSET_MM, encoder_steps, slip_interval};
use crate::score::runs;

/// The crosshead stands where it stays within one encoder step for this many frames (200 ms): what is
/// slower than 0.1 mm/s is standing still.
pub const STAND_FRAMES: usize = (FRAME_RATE_HZ as usize * 200) / 1000;

/// One movement of the crosshead in one direction.
#[derive(Clone, Debug, PartialEq)]
pub struct Pull {
    /// Slip by the encoder rule, if the crosshead moved what the gripper held. Not empty.
    pub slip: Range<usize>,
    pub from_mm: f32,
    pub to_mm: f32,
    /// It moves in the first frame already or in the last one still, so that `slip` starts late or ends
    /// early.
    pub cut: bool,
}

/// Movements long enough to be slip, in order of time. `displacement_mm`: one per frame.
///
/// Movements are separated by standstill or a change of direction of more than [`ONSET_MM`].
pub fn pulls(displacement_mm: &[f32]) -> Vec<Pull> {
    let steps: Vec<i64> = displacement_mm.iter().map(|&mm| encoder_steps(mm)).collect();
    let mut found = Vec::new();
    for run in moving(&steps) {
        let cut = run.start == 0 || run.end == steps.len();
        // The standstill around belongs to it: it says from where and to where the crosshead went.
        let with_rest = run.start.saturating_sub(STAND_FRAMES)..(run.end + STAND_FRAMES).min(steps.len());
        for window in one_way(&steps, with_rest) {
            let slip = slip_interval(&displacement_mm[window.clone()]);
            if !slip.is_empty() {
                found.push(Pull {
                    slip: slip.start + window.start..slip.end + window.start,
                    from_mm: displacement_mm[window.start],
                    to_mm: displacement_mm[window.end - 1],
                    cut,
                });
            }
        }
    }
    found
}

/// Runs of frames in which the crosshead does not stand.
fn moving(steps: &[i64]) -> Vec<Range<usize>> {
    let mut stands = vec![false; steps.len()];
    for (start, window) in steps.windows(STAND_FRAMES).enumerate() {
        let (low, high) =
            window.iter().fold((i64::MAX, i64::MIN), |(low, high), &n| (low.min(n), high.max(n)));
        if high - low <= 1 {
            stands[start..start + STAND_FRAMES].fill(true);
        }
    }
    runs(steps.len(), |frame| !stands[frame]).into_iter().map(|(start, end)| start..end).collect()
}

/// A stretch cut at its turning points.
fn one_way(steps: &[i64], stretch: Range<usize>) -> Vec<Range<usize>> {
    let far = (ONSET_MM / ENCODER_STEP_MM).ceil() as i64;
    let mut pieces = Vec::new();
    let (mut start, mut direction, mut turn) = (stretch.start, 0, stretch.start);
    for frame in stretch.clone() {
        let ahead = (steps[frame] - steps[turn]) * direction;
        if direction == 0 {
            let way = steps[frame] - steps[start];
            if way.abs() >= far {
                (direction, turn) = (way.signum(), frame);
            }
        } else if ahead >= 0 {
            turn = frame;
        } else if -ahead >= far {
            pieces.push(start..turn + 1);
            (start, direction, turn) = (turn, -direction, frame);
        }
    }
    pieces.push(start..stretch.end);
    pieces
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Positions from straight lines between (frame, mm).
    fn way(corners: &[(usize, f32)]) -> Vec<f32> {
        let mut mm = Vec::new();
        for pair in corners.windows(2) {
            let ((from, a), (to, b)) = (pair[0], pair[1]);
            mm.extend((from..to).map(|f| a + (b - a) * (f - from) as f32 / (to - from) as f32));
        }
        mm
    }

    #[test]
    fn each_stroke_is_one_pull_by_the_rule_of_the_paper() {
        // 5 mm/s up, a rest, 2 mm/s down.
        let mm = way(&[(0, 1.0), (100, 1.0), (340, 6.0), (600, 6.0), (1200, 1.0), (1400, 1.0)]);
        let found = pulls(&mm);
        assert_eq!(found.len(), 2);
        assert_eq!(found[0].slip, slip_interval(&mm[0..500]));
        let down = slip_interval(&mm[400..1400]);
        assert_eq!(found[1].slip, down.start + 400..down.end + 400);
        assert!((found[0].to_mm - 6.0).abs() < 0.01 && (found[1].to_mm - 1.0).abs() < 0.01);
        assert!(found.iter().all(|pull| !pull.cut));
    }

    #[test]
    fn a_turn_without_a_rest_ends_a_pull() {
        let mm = way(&[(0, 0.0), (100, 0.0), (340, 5.0), (580, 0.0), (700, 0.0)]);
        let found = pulls(&mm);
        assert_eq!(found.len(), 2);
        assert!(found[0].slip.end <= 340 && found[1].slip.start >= 340, "{found:?}");
        assert!(found[1].slip.end > 570);
    }

    #[test]
    fn standing_jitter_and_short_moves_are_no_pulls() {
        let jitter: Vec<f32> = (0..500).map(|f| 0.02 * (f % 2) as f32).collect();
        assert!(pulls(&jitter).is_empty());
        assert!(pulls(&way(&[(0, 0.0), (100, 0.0), (110, 0.06), (300, 0.06)])).is_empty());
        assert!(pulls(&[]).is_empty());
    }

    #[test]
    fn a_pull_that_the_recording_cuts_says_so() {
        let found = pulls(&way(&[(0, 0.0), (240, 5.0), (500, 5.0)]));
        assert_eq!((found.len(), found[0].cut), (1, true));
    }
}
