//! What quantization costs: the shipped integer network beside the float network it was made from, split by
//! split and seed by seed, against the most that they may differ.

use serde::Serialize;

use crate::metrics::bootstrap::InputFigures;
use crate::metrics::figures::Figures;
use crate::metrics::statistics::mean;

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
    pub(crate) same_class_share: Option<f64>,
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
    /// From the figures in the order of the fields.
    fn new(input: &str, seed: String, [same, f1, fpr, integer, float]: [Option<f64>; 5]) -> Self {
        let within = |points: Option<f64>, most: f64| points.is_some_and(|points| points.abs() < most);
        Self {
            input: input.to_owned(),
            seed,
            same_class_share: same,
            macro_f1_difference_points: f1,
            fpr_of_non_slip_difference_points: fpr,
            latency_integer_frames: integer,
            latency_float_frames: float,
            met: within(f1, MACRO_F1_POINTS) && within(fpr, FPR_POINTS) && integer == float,
        }
    }

    fn of_seed(input: &str, seed: &str, same: Option<f64>, [integer, float]: [&Figures; 2]) -> Self {
        let points = |of: fn(&Figures) -> Option<f64>| Some(100.0 * (of(integer)? - of(float)?));
        let (f1, fpr) = (points(|f| f.frame.macro_f1), points(|f| f.frame.fpr_of_non_slip_share));
        let latencies = [integer, float].map(|figures| figures.encoder_events.latency_median_frames);
        Self::new(input, seed.to_owned(), [same, f1, fpr, latencies[0], latencies[1]])
    }

    /// The mean of several seeds' rows of one input, signs kept; none of no rows. Infinite latencies that are
    /// infinite on both sides are the same.
    fn mean(rows: &[Self]) -> Option<Self> {
        let of = |value: fn(&Self) -> Option<f64>| {
            mean(&rows.iter().map(value).collect::<Option<Vec<f64>>>().unwrap_or_default())
        };
        let figures = [
            of(|row| row.same_class_share),
            of(|row| row.macro_f1_difference_points),
            of(|row| row.fpr_of_non_slip_difference_points),
            of(|row| row.latency_integer_frames),
            of(|row| row.latency_float_frames),
        ];
        Some(Self::new(&rows.first()?.input, format!("mean of {}", rows.len()), figures))
    }
}

/// Input by input: each pair of an integer and a float detector, by name and figures, then their mean where there
/// are several. `same(pair, input)`: share of the frames that both give the same class.
pub(crate) fn quantization_rows(
    pairs: &[[(&str, &[InputFigures]); 2]],
    same: impl Fn(usize, usize) -> Option<f64>,
) -> Vec<QuantizationRow> {
    let inputs = pairs.first().map_or(0, |[(_, inputs), _]| inputs.len());
    let mut rows = Vec::new();
    for input in 0..inputs {
        let row = |(pair, [(name, integer), (_, float)]): (usize, &[(&str, &[InputFigures]); 2])| {
            let (integer, float) = (&integer[input], &float[input]);
            let figures = [&integer.figures, &float.figures];
            QuantizationRow::of_seed(&integer.input, name, same(pair, input), figures)
        };
        let seeds: Vec<QuantizationRow> = pairs.iter().enumerate().map(row).collect();
        let mean = QuantizationRow::mean(&seeds).filter(|_| seeds.len() > 1);
        rows.extend(seeds);
        rows.extend(mean);
    }
    rows
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

    fn row(f1: f64, fpr: f64, latency: Option<f64>) -> QuantizationRow {
        let float = figures(0.9600, 0.0100, Some(2.0));
        QuantizationRow::of_seed("palm", "network", None, [&figures(f1, fpr, latency), &float])
    }

    #[test]
    fn every_bound_counts() {
        let met = |f1, fpr, latency| row(f1, fpr, latency).met;
        assert!(met(0.9581, 0.0109, Some(2.0)) && met(0.9619, 0.0091, Some(2.0)));
        assert!(!met(0.9579, 0.0100, Some(2.0)) && !met(0.9621, 0.0100, Some(2.0)), "F1");
        assert!(!met(0.9600, 0.0111, Some(2.0)) && !met(0.9600, 0.0089, Some(2.0)), "FPR");
        assert!(!met(0.9600, 0.0100, Some(2.5)) && !met(0.9600, 0.0100, None), "latency");
        assert!(!QuantizationRow::new("palm", String::new(), [None; 5]).met, "no figure is no success");
    }

    #[test]
    fn the_mean_keeps_signs() {
        let (up, down) = (row(0.963, 0.01, Some(2.0)), row(0.958, 0.01, Some(2.0)));
        assert!(!up.met && !down.met);
        let mean = QuantizationRow::mean(&[up, down]).unwrap();
        assert!((mean.macro_f1_difference_points.unwrap() - 0.05).abs() < 1e-9 && mean.met);
        assert_eq!((mean.seed.as_str(), mean.latency_float_frames), ("mean of 2", Some(2.0)));
        assert_eq!(QuantizationRow::mean(&[]), None);
    }
}
