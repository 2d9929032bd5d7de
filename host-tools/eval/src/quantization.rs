//! What quantization costs: the shipped integer network beside the float network it was made from, split by
//! split and seed by seed, against the most that they may differ.

use serde::Serialize;

use crate::detector::Prediction;
use crate::metrics::bootstrap::InputFigures;
use crate::metrics::figures::Figures;
use crate::metrics::statistics::{mean, share};

/// Macro F1 may differ by less than this, percentage points.
pub(crate) const MACRO_F1_POINTS: f64 = 0.2;
/// FPR of the frames that do not slip may differ by less than this, percentage points.
pub(crate) const FPR_POINTS: f64 = 0.1;

/// One split, one seed or the mean over all.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct QuantizationRow {
    pub(crate) input: String,
    /// The integer detector's name, or what the mean is of.
    pub(crate) seed: String,
    /// Integer less float.
    pub(crate) macro_f1_difference_points: Option<f64>,
    /// Integer less float.
    pub(crate) fpr_of_non_slip_difference_points: Option<f64>,
    /// Median of hits and misses, integer.
    pub(crate) latency_integer_frames: Option<f64>,
    pub(crate) latency_float_frames: Option<f64>,
    /// Whether both differences are within their bounds and the latency is the same.
    pub(crate) met: bool,
}

impl QuantizationRow {
    pub(crate) fn new(input: &str, seed: &str, integer: &Figures, float: &Figures) -> Self {
        let points = |of: fn(&Figures) -> Option<f64>| Some(100.0 * (of(integer)? - of(float)?));
        Self {
            macro_f1_difference_points: points(|f| f.frame.macro_f1),
            fpr_of_non_slip_difference_points: points(|f| f.frame.fpr_of_non_slip_share),
            latency_integer_frames: integer.encoder_events.latency_median_frames,
            latency_float_frames: float.encoder_events.latency_median_frames,
            input: input.to_owned(),
            seed: seed.to_owned(),
            met: false,
        }
        .with_met()
    }

    /// The mean of several seeds' rows of one input, signs kept; none of no rows. Infinite latencies that are
    /// infinite on both sides are the same.
    pub(crate) fn mean(rows: &[Self]) -> Option<Self> {
        let of = |value: fn(&Self) -> Option<f64>| {
            mean(&rows.iter().map(value).collect::<Option<Vec<f64>>>().unwrap_or_default())
        };
        let row = Self {
            input: rows.first()?.input.clone(),
            seed: format!("mean of {}", rows.len()),
            macro_f1_difference_points: of(|row| row.macro_f1_difference_points),
            fpr_of_non_slip_difference_points: of(|row| row.fpr_of_non_slip_difference_points),
            latency_integer_frames: of(|row| row.latency_integer_frames),
            latency_float_frames: of(|row| row.latency_float_frames),
            met: false,
        };
        Some(row.with_met())
    }

    fn with_met(self) -> Self {
        let within = |points: Option<f64>, most: f64| points.is_some_and(|points| points.abs() < most);
        let met = within(self.macro_f1_difference_points, MACRO_F1_POINTS)
            && within(self.fpr_of_non_slip_difference_points, FPR_POINTS)
            && self.latency_integer_frames == self.latency_float_frames;
        Self { met, ..self }
    }
}

/// Input by input: each pair of an integer and a float detector, by name and figures, then their mean where there
/// are several.
pub(crate) fn quantization_rows(pairs: &[[(&str, &[InputFigures]); 2]]) -> Vec<QuantizationRow> {
    let inputs = pairs.first().map_or(0, |[(_, inputs), _]| inputs.len());
    let mut rows = Vec::new();
    for input in 0..inputs {
        let row = |[(name, integer), (_, float)]: &[(&str, &[InputFigures]); 2]| {
            let (integer, float) = (&integer[input], &float[input]);
            QuantizationRow::new(&integer.input, name, &integer.figures, &float.figures)
        };
        let seeds: Vec<QuantizationRow> = pairs.iter().map(row).collect();
        let mean = QuantizationRow::mean(&seeds).filter(|_| seeds.len() > 1);
        rows.extend(seeds);
        rows.extend(mean);
    }
    rows
}

/// How two detectors differ on the same frames; differences are first minus second.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Pair {
    pub(crate) first: String,
    pub(crate) second: String,
    pub(crate) same_class_share: Option<f64>,
    pub(crate) different_class_frames: usize,
    pub(crate) macro_f1_difference: Option<f64>,
    pub(crate) fpr_of_non_slip_difference_share: Option<f64>,
    /// Difference of the median latencies; null where one is infinite.
    pub(crate) latency_median_difference_frames: Option<f64>,
    pub(crate) alarms_difference: i64,
}

impl Pair {
    /// Compare two detectors by their predictions on the same episodes, in the same order.
    pub(crate) fn new<'a>(
        first: (&str, &Figures),
        second: (&str, &Figures),
        predictions: impl IntoIterator<Item = (&'a Prediction, &'a Prediction)>,
    ) -> Self {
        let (mut same, mut frames) = (0, 0);
        for (a, b) in predictions {
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

#[cfg(test)]
mod tests {
    use super::*;

    fn figures(f1: f64, fpr: f64, latency: Option<f64>) -> Figures {
        let mut figures = Figures::default();
        (figures.frame.macro_f1, figures.frame.fpr_of_non_slip_share) = (Some(f1), Some(fpr));
        figures.encoder_events.latency_median_frames = latency;
        figures
    }

    #[test]
    fn every_bound_counts() {
        let float = figures(0.9600, 0.0100, Some(2.0));
        let met = |f1, fpr, latency| {
            QuantizationRow::new("palm", "network", &figures(f1, fpr, latency), &float).met
        };
        assert!(met(0.9581, 0.0109, Some(2.0)) && met(0.9619, 0.0091, Some(2.0)));
        assert!(!met(0.9579, 0.0100, Some(2.0)) && !met(0.9621, 0.0100, Some(2.0)), "F1");
        assert!(!met(0.9600, 0.0111, Some(2.0)) && !met(0.9600, 0.0089, Some(2.0)), "FPR");
        assert!(!met(0.9600, 0.0100, Some(2.5)) && !met(0.9600, 0.0100, None), "latency");
        let nothing = QuantizationRow::new("palm", "network", &Figures::default(), &Figures::default());
        assert!(!nothing.met, "no figure is no success");
    }

    #[test]
    fn the_mean_keeps_signs() {
        let row = |f1| {
            let float = figures(0.96, 0.01, Some(2.0));
            QuantizationRow::new("palm", "network#1", &figures(f1, 0.01, Some(2.0)), &float)
        };
        let (up, down) = (row(0.963), row(0.958));
        assert!(!up.met && !down.met);
        let mean = QuantizationRow::mean(&[up, down]).unwrap();
        assert!((mean.macro_f1_difference_points.unwrap() - 0.05).abs() < 1e-9 && mean.met);
        assert_eq!((mean.seed.as_str(), mean.latency_float_frames), ("mean of 2", Some(2.0)));
        assert_eq!(QuantizationRow::mean(&[]), None);
    }
}
