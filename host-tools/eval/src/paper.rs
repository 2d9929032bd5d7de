//! Figures of the paper, "SlipSense" (CoRL 2026), to stand beside ours: theirs are of real grippers,
//! ours of whatever was evaluated.

use serde::Serialize;
use slipsense_synth::paper::{PaperRow, row};

use crate::metrics::figures::Figures;

/// Name of the input that the operating points are chosen on.
pub(crate) const VALIDATION: &str = "val";

/// Shares of the frames of the paper's data set, percent: no contact, no slip, slip.
pub(crate) const CLASS_PERCENT: [f64; 3] = [57.6, 18.8, 23.7];

/// How far a figure may be from the paper's, percentage points, for the data to count as about as hard.
pub(crate) const HARDNESS_POINTS: f64 = 6.0;

/// The paper's network by speed, 167 UMI test events: speed in mm/s, events, median, mean and longest
/// latency in frames.
pub(crate) const LATENCY_BY_SPEED: [(f64, u32, f64, f64, f64); 5] = [
    (2.0, 36, 3.0, 14.9, 106.0),
    (5.0, 31, 3.0, 6.8, 39.0),
    (10.0, 37, 1.0, 3.4, 27.0),
    (15.0, 32, 2.5, 5.8, 35.0),
    (18.0, 31, 1.0, 2.9, 20.0),
];

/// The paper's latency distribution: percent of the events at the onset frame and within 5 frames.
pub(crate) const WITHIN_PERCENT: [f64; 2] = [43.0, 76.0];

/// Ours beside the paper's; differences are ours minus theirs, percentage points.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Comparison {
    pub(crate) paper: PaperRow,
    /// Ours: median frames from the onset to the first flagged frame, flags before it ignored, misses
    /// infinite; null where infinite.
    pub(crate) latency_frames: Option<f64>,
    pub(crate) fpr_of_non_slip_percent: Option<f64>,
    pub(crate) fpr_of_all_percent: Option<f64>,
    pub(crate) accuracy_percent: Option<f64>,
    pub(crate) macro_f1_percent: Option<f64>,
    pub(crate) fpr_difference_points: Option<f64>,
    pub(crate) accuracy_difference_points: Option<f64>,
    pub(crate) macro_f1_difference_points: Option<f64>,
    /// Whether accuracy, macro F1 and FPR all lie within 6 points of the paper's.
    pub(crate) within_6_points: bool,
}

impl Comparison {
    pub(crate) fn find(detector: &str, input: &str, figures: &Figures) -> Option<Self> {
        let paper = *row(detector, input)?;
        let percent = |share: Option<f64>| share.map(|share| 100.0 * share);
        let frame = &figures.frame;
        let fpr = percent(frame.fpr_of_non_slip_share);
        let (accuracy, f1) = (percent(frame.accuracy_share), percent(frame.macro_f1));
        let difference = |ours: Option<f64>, theirs: f64| ours.map(|ours| ours - theirs);
        let differences @ [fpr_difference_points, accuracy_difference_points, macro_f1_difference_points] = [
            difference(fpr, paper.fpr_percent),
            difference(accuracy, paper.accuracy_percent),
            difference(f1, paper.macro_f1_percent),
        ];
        let within = |points: Option<f64>| points.is_some_and(|points| points.abs() <= HARDNESS_POINTS);
        Some(Self {
            paper,
            latency_frames: figures.encoder_events.from_onset_median_frames,
            fpr_of_non_slip_percent: fpr,
            fpr_of_all_percent: percent(frame.fpr_of_all_share),
            accuracy_percent: accuracy,
            macro_f1_percent: f1,
            fpr_difference_points,
            accuracy_difference_points,
            macro_f1_difference_points,
            within_6_points: differences.into_iter().all(within),
        })
    }
}
