//! Loss of the detector: over events, not over frames.
//!
//! Every frame counts a little. What decides an alarm counts most: of each slip the surest of its first frames, of each
//! 200 ms without slip the frame that comes nearest to an alarm. So the network learns from the hardest it meets, as
//! always-on detectors do (maximum pooling: Sun et al., arXiv 1705.02411).

use burn::tensor::Tensor;
use burn::tensor::activation::relu;

use crate::device::{numbers, tensor};
use crate::target::Target;

/// Frames without slip of which the worst counts more: alarms closer than this are one.
const STRETCH_FRAMES: usize = 48;
/// Frames from the onset on within which slip is to be found, and what one of them counts.
const ONSET_FRAMES: usize = 10;
const ONSET_WEIGHT: f32 = 4.0;
/// What a frame counts in which slip may be found already.
const BEGINS_WEIGHT: f32 = 0.3;

/// Binary cross entropy of log-odds `[batch, frame, 1]` against the targets, nat: the mean over all weighted frames. The
/// surest of an onset and the worst of a stretch count `extreme_weight` in addition; without it all frames count alike.
pub(crate) fn loss(log_odds: Tensor<3>, targets: &[Target], extreme_weight: Option<f32>) -> Tensor<1> {
    let [batch, frames, _] = log_odds.dims();
    let values = numbers(log_odds.clone());
    let sequences = targets.chunks_exact(frames).zip(values.chunks_exact(frames));
    let weights: Vec<f32> =
        sequences.flat_map(|(targets, values)| weights(targets, values, extreme_weight)).collect();
    let truth: Vec<f32> =
        targets.iter().map(|t| f32::from(matches!(t, Target::Slides | Target::Begins) as u8)).collect();
    let tensor = |values| tensor::<3>(values, [batch, frames, 1], &log_odds.device());
    let scale = 1.0 / (batch * frames) as f32;
    let weights = tensor(weights.into_iter().map(|w| w * scale).collect());
    let truth = tensor(truth);
    // ln(1 + e^z) - z y, written so that no exponential overflows.
    let softplus = relu(log_odds.clone()) + log_odds.clone().abs().neg().exp().log1p();
    ((softplus - log_odds * truth) * weights).sum()
}

/// What the frames of one sequence count, by their targets and what the network says of them.
fn weights(targets: &[Target], log_odds: &[f32], extreme_weight: Option<f32>) -> Vec<f32> {
    let mut weights: Vec<f32> = targets
        .iter()
        .map(|target| match target {
            Target::Still | Target::Slides => 1.0,
            Target::Begins => BEGINS_WEIGHT,
            Target::Either => 0.0,
        })
        .collect();
    let Some(extreme_weight) = extreme_weight else { return weights };
    let mut start = 0;
    for run in targets.chunk_by(|a, b| a == b) {
        let end = start + run.len();
        match run[0] {
            Target::Slides => {
                // A run at the start of a sequence may be the rest of one.
                let onset = start..if start > 0 { end.min(start + ONSET_FRAMES) } else { start };
                weights[onset.clone()].fill(ONSET_WEIGHT);
                if let Some(surest) = largest(log_odds, onset) {
                    weights[surest] += extreme_weight;
                }
            }
            Target::Still => {
                for from in (start..end).step_by(STRETCH_FRAMES) {
                    let to = end.min(from + STRETCH_FRAMES);
                    if let Some(worst) = largest(log_odds, from..to) {
                        weights[worst] += extreme_weight * (to - from) as f32 / STRETCH_FRAMES as f32;
                    }
                }
            }
            Target::Begins | Target::Either => {}
        }
        start = end;
    }
    weights
}

/// The frame of a range with the largest value; none in an empty range.
fn largest(values: &[f32], range: std::ops::Range<usize>) -> Option<usize> {
    range.max_by(|&a, &b| values[a].total_cmp(&values[b]))
}

#[cfg(test)]
mod tests {
    use burn::tensor::Device;

    use super::*;

    #[test]
    fn the_surest_onset_frame_and_the_worst_of_each_stretch_count_most() {
        let mut targets = vec![Target::Still; 120];
        targets[100..115].fill(Target::Slides);
        targets[115..].fill(Target::Either);
        let mut log_odds = vec![-5.0; 120];
        (log_odds[7], log_odds[60], log_odds[104], log_odds[114]) = (-1.0, 2.0, 1.0, 9.0);
        let of_frames = weights(&targets, &log_odds, None);
        assert!(of_frames[..115].iter().all(|&weight| weight == 1.0) && of_frames[115..] == [0.0; 5]);
        let weights = weights(&targets, &log_odds, Some(12.0));
        assert_eq!((weights[7], weights[60]), (13.0, 13.0));
        assert_eq!((weights[104], weights[103], weights[114]), (16.0, 4.0, 1.0));
        // The last stretch has 4 of 48 frames.
        assert_eq!(weights[96..100].iter().sum::<f32>(), 4.0 + 1.0);
        assert_eq!(weights[117], 0.0);
    }

    #[test]
    fn the_loss_by_hand() {
        let targets = [Target::Still, Target::Slides, Target::Either, Target::Begins];
        let log_odds = tensor(vec![200.0, -200.0, 7.0, 0.0], [1, 4, 1], &Device::flex());
        let loss = f64::from(loss(log_odds, &targets, Some(12.0)).into_scalar::<f32>());
        // A stretch of one frame; the sliding does not begin at the start of the sequence.
        let expected = (200.0 * (1.0 + 12.0 / 48.0) + 200.0 * 16.0 + 0.3 * 2f64.ln()) / 4.0;
        assert!((loss - expected).abs() < 1e-3, "{loss} {expected}");
    }
}
