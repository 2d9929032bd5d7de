//! What the integers cost: the shipped network beside the float network it was made from, split by split and
//! seed by seed, against the most that they may differ.

use serde::Serialize;

use crate::grid::Grid;
use crate::metrics::record::Figures;
use crate::metrics::statistics::mean;
use crate::results::DetectorResults;
use crate::table::{latency, number};

/// Macro F1 may differ by less than this, percentage points.
pub const MACRO_F1_POINTS: f64 = 0.2;
/// FPR of the frames that do not slip may differ by less than this, percentage points.
pub const FPR_POINTS: f64 = 0.1;

/// One split, one seed or the mean over all.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct QuantizationRow {
    /// The input.
    pub input: String,
    /// The integer detector's name, or what the mean is of.
    pub seed: String,
    /// Integer less float.
    pub macro_f1_difference_points: Option<f64>,
    /// Integer less float.
    pub fpr_of_non_slip_difference_points: Option<f64>,
    /// Median of hits and misses, integer.
    pub latency_integer_frames: Option<f64>,
    /// Median of hits and misses, float.
    pub latency_float_frames: Option<f64>,
    /// Whether both differences are within their bounds and the latency is the same.
    pub met: bool,
}

impl QuantizationRow {
    /// Integer against float figures of one seed on one input.
    pub fn new(input: &str, seed: &str, integer: &Figures, float: &Figures) -> Self {
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
        .judged()
    }

    /// The mean of several seeds' rows of one input, signs kept; none of no rows. Infinite latencies that are
    /// infinite on both sides are the same.
    pub fn mean(rows: &[Self]) -> Option<Self> {
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
        Some(row.judged())
    }

    fn judged(self) -> Self {
        let within = |points: Option<f64>, most: f64| points.is_some_and(|points| points.abs() < most);
        let met = within(self.macro_f1_difference_points, MACRO_F1_POINTS)
            && within(self.fpr_of_non_slip_difference_points, FPR_POINTS)
            && self.latency_integer_frames == self.latency_float_frames;
        Self { met, ..self }
    }
}

/// Input by input: each pair of positions of an integer and a float detector, then their mean where there are
/// several.
pub(crate) fn rows(detectors: &[DetectorResults], pairs: &[(usize, usize)]) -> Vec<QuantizationRow> {
    let inputs = detectors.first().map_or(0, |detector| detector.inputs.len());
    let mut rows = Vec::new();
    for input in 0..inputs {
        let row = |&(integer, float): &(usize, usize)| {
            let (a, b) = (&detectors[integer].inputs[input], &detectors[float].inputs[input]);
            QuantizationRow::new(&a.input, &detectors[integer].name, &a.figures, &b.figures)
        };
        let of_seeds: Vec<QuantizationRow> = pairs.iter().map(row).collect();
        let mean = QuantizationRow::mean(&of_seeds).filter(|_| of_seeds.len() > 1);
        rows.extend(of_seeds);
        rows.extend(mean);
    }
    rows
}

/// The table for terminal and report; `kind` says what data it is.
pub(crate) fn grid(rows: &[QuantizationRow], kind: &str) -> Grid {
    let points = |value: Option<f64>| value.map_or("–".to_owned(), |points| format!("{points:+.3}"));
    let cells = |row: &QuantizationRow| {
        vec![
            row.input.clone(),
            row.seed.clone(),
            points(row.macro_f1_difference_points),
            points(row.fpr_of_non_slip_difference_points),
            latency(row.latency_integer_frames, 1),
            latency(row.latency_float_frames, 1),
            if row.met { "yes" } else { "no" }.to_owned(),
        ]
    };
    Grid {
        title: format!("integer against float ({kind})"),
        header: vec!["input", "network", "F1 points", "FPR points", "latency fr", "float", "met"],
        word_columns: 2,
        rows: rows.iter().map(cells).collect(),
        note: format!(
            "integer less float; met: under {} points of F1, under {} of FPR, same median latency (∞: half of the \
             events or more are missed, or there are none)",
            number(Some(MACRO_F1_POINTS), 1),
            number(Some(FPR_POINTS), 1)
        ),
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
        let text = grid(&[mean], "synthetic data").to_string();
        assert!(text.contains("+0.050") && text.contains("synthetic data"), "{text}");
    }
}
