//! What the threshold trades: false alarms against latency and misses.
//!
//! Thresholds of the curve are quantiles of the scores of the frames that do not slip, evenly spaced in the logarithm
//! of the false-positive rate.
//!
//! The operating point is fixed on validation data and applied unchanged: the lowest threshold whose FPR
//! (of the frames that do not slip) does not exceed the target there. Scores equal to each other fall on
//! the same side, so the rate can lie well below the target.

use serde::Serialize;
use slipsense_recording::score::SLIP;

use super::figures::{EpisodeRecord, Figures};
use crate::detector::Prediction;
use crate::truth::Truth;

/// FPR that the operating point aims at, of the frames that do not slip: about the paper's.
pub(crate) const TARGET_FPR: f64 = 0.015;
/// Thresholds of a curve, at most.
pub(crate) const POINTS: usize = 40;
/// Highest and lowest false-positive rate of a curve.
const FPR_RANGE: [f64; 2] = [0.5, 1e-5];

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct CurvePoint {
    /// Threshold, in the detector's unit.
    pub(crate) threshold_score: f64,
    pub(crate) fpr_of_non_slip_share: Option<f64>,
    pub(crate) alarms_per_hour: Option<f64>,
    /// Median latency against the encoder truth; null where infinite.
    pub(crate) latency_median_frames: Option<f64>,
    pub(crate) within_5_frames_share: Option<f64>,
    pub(crate) miss_share: Option<f64>,
    pub(crate) early_share: Option<f64>,
    pub(crate) is_detectors_own: bool,
    /// The operating point that was fixed on validation data.
    pub(crate) is_operating_point: bool,
}

/// Scores of all frames that do not slip, highest first.
pub(crate) fn non_slip_scores(episodes: &[(&Truth, &Prediction)]) -> Vec<f32> {
    let of_episode = |(truth, prediction): &(&Truth, &Prediction)| -> Vec<f32> {
        let frames = truth.label.iter().zip(&prediction.score);
        frames.filter(|(label, _)| **label != SLIP).map(|(_, score)| *score).collect()
    };
    let mut scores: Vec<f32> = episodes.iter().flat_map(of_episode).collect();
    scores.sort_unstable_by(|a, b| b.total_cmp(a));
    scores
}

/// The lowest threshold at which at most `target` of these scores (highest first) are slip. `None` where
/// there are none.
pub(crate) fn threshold_for(descending: &[f32], target: f64) -> Option<f32> {
    let allowed = (target * descending.len() as f64) as usize;
    // The first score that must not be slip; those equal to it are not slip either.
    descending.get(allowed.min(descending.len().checked_sub(1)?)).copied()
}

/// The curve over these episodes. `own` is the detector's threshold, `fixed` the operating point's.
pub(crate) fn curve(episodes: &[(&Truth, &Prediction)], own: f32, fixed: Option<f32>) -> Vec<CurvePoint> {
    let scores = non_slip_scores(episodes);
    let [high, low] = FPR_RANGE.map(f64::ln);
    let steps = (POINTS - 2) as f64;
    let rate = |i: usize| (high + (low - high) * i as f64 / (steps - 1.0)).exp();
    let mut thresholds: Vec<f32> = (0..POINTS - 2).filter_map(|i| threshold_for(&scores, rate(i))).collect();
    thresholds.push(own);
    thresholds.extend(fixed);
    thresholds.sort_by(f32::total_cmp);
    thresholds.dedup();
    let point = |threshold: f32| {
        let figures = figures_at(episodes, threshold);
        CurvePoint {
            threshold_score: threshold.into(),
            fpr_of_non_slip_share: figures.frame.fpr_of_non_slip_share,
            alarms_per_hour: figures.alarms.all.alarms_per_hour,
            latency_median_frames: figures.encoder_events.latency_median_frames,
            within_5_frames_share: figures.encoder_events.within_5_frames_share,
            miss_share: figures.encoder_events.miss_share,
            early_share: figures.encoder_events.early_share,
            is_detectors_own: threshold == own,
            is_operating_point: fixed == Some(threshold),
        }
    };
    thresholds.into_iter().map(point).collect()
}

pub(crate) fn figures_at(episodes: &[(&Truth, &Prediction)], threshold: f32) -> Figures {
    let record = |(truth, prediction): &(&Truth, &Prediction)| {
        EpisodeRecord::new(truth, &prediction.classes_at(threshold))
    };
    let records: Vec<EpisodeRecord> = episodes.iter().map(record).collect();
    Figures::new(&records)
}
