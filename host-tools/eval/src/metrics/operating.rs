//! What the threshold trades: false alarms against latency and misses.
//!
//! At a threshold, a frame is slip where its score is above the threshold, else it is what the detector
//! says it is if it is not slip. Thresholds of the curve are quantiles of the scores of the frames that do
//! not slip, evenly spaced in the logarithm of the false-positive rate.
//!
//! The operating point is fixed on validation data and applied unchanged: the lowest threshold whose FPR
//! (of the frames that do not slip) does not exceed the target there. Scores equal to each other fall on
//! the same side, so the rate can lie well below the target.

use serde::Serialize;
use slipsense_recording::score::SLIP;

use super::record::{Figures, Record};
use crate::detectors::Verdict;
use crate::truth::Truth;

/// FPR that the operating point aims at, of the frames that do not slip: about the paper's.
pub const TARGET_FPR: f64 = 0.015;
/// Thresholds of a curve, at most.
pub const POINTS: usize = 40;
/// Highest and lowest false-positive rate of a curve.
const FPR_RANGE: [f64; 2] = [0.5, 1e-5];

/// One point of the curve.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct CurvePoint {
    /// Threshold, in the detector's unit.
    pub threshold_score: f64,
    /// False slip frames of the frames that do not slip.
    pub fpr_of_non_slip_share: Option<f64>,
    /// False alarms per hour of exposure.
    pub alarms_per_hour: Option<f64>,
    /// Median latency against the encoder truth; null where infinite.
    pub latency_median_frames: Option<f64>,
    /// Hits within 5 frames, of hits and misses.
    pub within_5_frames_share: Option<f64>,
    /// Missed events of all.
    pub miss_share: Option<f64>,
    /// Early events of all.
    pub early_share: Option<f64>,
    /// The detector's own threshold.
    pub is_detectors_own: bool,
    /// The operating point that was fixed on validation data.
    pub is_operating_point: bool,
}

/// Classes of the frames at another threshold.
pub fn at_threshold(verdict: &Verdict, threshold: f32) -> Vec<u8> {
    let class = |(&score, &fallback)| if score > threshold { SLIP } else { fallback };
    verdict.score.iter().zip(&verdict.fallback).map(class).collect()
}

/// Scores of all frames that do not slip, highest first.
pub fn non_slip_scores(episodes: &[(&Truth, &Verdict)]) -> Vec<f32> {
    let of_episode = |(truth, verdict): &(&Truth, &Verdict)| -> Vec<f32> {
        let frames = truth.label.iter().zip(&verdict.score);
        frames.filter(|(label, _)| **label != SLIP).map(|(_, score)| *score).collect()
    };
    let mut scores: Vec<f32> = episodes.iter().flat_map(of_episode).collect();
    scores.sort_unstable_by(|a, b| b.total_cmp(a));
    scores
}

/// The lowest threshold at which at most `target` of these scores (highest first) are slip. `None` where
/// there are none.
pub fn threshold_for(descending: &[f32], target: f64) -> Option<f32> {
    let allowed = (target * descending.len() as f64) as usize;
    // The first score that must not be slip; those equal to it are not slip either.
    descending.get(allowed.min(descending.len().checked_sub(1)?)).copied()
}

/// The curve over these episodes. `own` is the detector's threshold, `fixed` the operating point's.
pub fn curve(episodes: &[(&Truth, &Verdict)], own: f32, fixed: Option<f32>) -> Vec<CurvePoint> {
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

/// Figures of these episodes at a threshold.
pub fn figures_at(episodes: &[(&Truth, &Verdict)], threshold: f32) -> Figures {
    let record =
        |(truth, verdict): &(&Truth, &Verdict)| Record::new(truth, &at_threshold(verdict, threshold));
    let records: Vec<Record> = episodes.iter().map(record).collect();
    Figures::new(&records)
}
