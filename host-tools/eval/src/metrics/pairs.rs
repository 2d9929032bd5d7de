//! Two detectors that should be the same, such as a network in integers and in floating point.

use serde::Serialize;

use super::record::Figures;
use super::statistics::share;
use crate::detectors::Verdict;

/// How two detectors differ on the same frames; differences are first minus second.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Pair {
    /// Name of the first detector.
    pub first: String,
    /// Name of the second detector.
    pub second: String,
    /// Frames with the same class, of all.
    pub same_class_share: Option<f64>,
    /// Frames with different classes.
    pub different_class_frames: usize,
    /// Difference of the macro F1.
    pub macro_f1_difference: Option<f64>,
    /// Difference of the false-positive rates, of the frames that do not slip.
    pub fpr_of_non_slip_difference_share: Option<f64>,
    /// Difference of the median latencies; null where one is infinite.
    pub latency_median_difference_frames: Option<f64>,
    /// Difference of the false alarms, events.
    pub alarms_difference: i64,
}

impl Pair {
    /// Compare two detectors by their verdicts on the same episodes, in the same order.
    pub fn new<'a>(
        first: (&str, &Figures),
        second: (&str, &Figures),
        verdicts: impl IntoIterator<Item = (&'a Verdict, &'a Verdict)>,
    ) -> Self {
        let (mut same, mut frames) = (0, 0);
        for (a, b) in verdicts {
            same += a.class.iter().zip(&b.class).filter(|(a, b)| a == b).count();
            frames += a.class.len();
        }
        let difference = |of: fn(&Figures) -> Option<f64>| Some(of(first.1)? - of(second.1)?);
        Self {
            first: first.0.to_owned(),
            second: second.0.to_owned(),
            same_class_share: share(same, frames),
            different_class_frames: frames - same,
            macro_f1_difference: difference(|f| f.frame.macro_f1),
            fpr_of_non_slip_difference_share: difference(|f| f.frame.fpr_of_non_slip_share),
            latency_median_difference_frames: difference(|f| f.encoder_events.latency_median_frames),
            alarms_difference: first.1.alarms.all.alarms as i64 - second.1.alarms.all.alarms as i64,
        }
    }
}
