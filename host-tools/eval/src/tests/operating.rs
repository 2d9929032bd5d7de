//! Thresholds and the curve, by hand.

use super::*;
use crate::detector::NEVER;
use crate::metrics::operating::{curve, figures_at, non_slip_scores, threshold_for};

/// Scores 0 to 999 without slip, then 100 frames of slip with scores 900 and up.
fn predicted() -> (Truth, Prediction) {
    let truth = truth(&episode(1100, std::slice::from_ref(&(1000..1100))));
    let score: Vec<f32> = (0..1000).chain(900..1000).map(|s| s as f32).collect();
    (truth, Prediction::new(score, 500.0, vec![1; 1100]))
}

#[test]
fn the_threshold_meets_the_rate_from_below() {
    let (truth, prediction) = predicted();
    let scores = non_slip_scores(&[(&truth, &prediction)]);
    assert_eq!((scores.len(), scores[0]), (1000, 999.0));
    assert_eq!(threshold_for(&scores, 0.015), Some(984.0));
    let fpr = |threshold| figures_at(&[(&truth, &prediction)], threshold).frame.fpr_of_non_slip_share;
    assert_eq!(fpr(984.0), Some(0.015));
    assert_eq!(fpr(984.0_f32.next_down()), Some(0.016));
    // Equal scores stand or fall together.
    assert_eq!(threshold_for(&[7.0, 5.0, 5.0, 5.0, 1.0], 0.5), Some(5.0));
    assert_eq!(threshold_for(&[7.0, 5.0], 1.0), Some(5.0));
    assert_eq!(threshold_for(&[], 0.1), None);
}

#[test]
fn the_curve_by_hand() {
    let (truth, prediction) = predicted();
    let curve = curve(&[(&truth, &prediction)], 500.0, Some(984.0));
    assert!(curve.len() > 20 && curve.is_sorted_by(|a, b| a.threshold_score < b.threshold_score));
    assert!(curve.is_sorted_by(|a, b| a.fpr_of_non_slip_share >= b.fpr_of_non_slip_share));
    let own = curve.iter().find(|point| point.is_detectors_own).unwrap();
    assert_eq!((own.threshold_score, own.fpr_of_non_slip_share), (500.0, Some(0.499)));
    // The alarm runs into the event: the frames before the onset are early.
    assert_eq!((own.early_share, own.latency_median_frames), (Some(1.0), None));
    let fixed = curve.iter().find(|point| point.is_operating_point).unwrap();
    assert_eq!((fixed.threshold_score, fixed.is_detectors_own), (984.0, false));
    // Above all scores without slip nothing is left but a miss.
    let last = curve.last().unwrap();
    assert_eq!((last.threshold_score, last.miss_share, last.alarms_per_hour), (999.0, Some(1.0), Some(0.0)));
}

#[test]
fn a_gate_stays_shut_at_any_threshold() {
    let (truth, prediction) = predicted();
    let shut = Prediction::new(vec![NEVER; 1100], 0.0, vec![0; 1100]);
    for point in curve(&[(&truth, &shut)], 0.0, None) {
        assert_eq!((point.fpr_of_non_slip_share, point.miss_share), (Some(0.0), Some(1.0)));
    }
    assert_eq!(prediction.class[501], 2);
}
