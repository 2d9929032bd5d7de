//! What the network is to reach on the frozen test sets, and ours beside it: mean and standard deviation over
//! training seeds. Everything is synthetic; the targets are the paper's figures of real grippers, or a little
//! above them.

use serde::Serialize;

use crate::metrics::bootstrap::InputFigures;
use crate::metrics::figures::Figures;
use crate::metrics::statistics::{mean, standard_deviation};

/// A figure with a target. Percentages are of 100; latencies are medians in frames of 4.17 ms.
#[derive(Clone, Copy, Debug)]
struct Measure {
    /// Words for tables, with the unit.
    name: &'static str,
    /// More is better: the bound is a least value, else a most.
    more_is_better: bool,
    /// Value from which `factor` makes the unit.
    value: fn(&Figures) -> Option<f64>,
    factor: f64,
}

const fn measure(
    name: &'static str,
    more_is_better: bool,
    factor: f64,
    value: fn(&Figures) -> Option<f64>,
) -> Measure {
    Measure { name, more_is_better, value, factor }
}

const MACRO_F1: Measure = measure("macro F1 %", true, 100.0, |f| f.frame.macro_f1);
const FPR: Measure = measure("FPR %", false, 100.0, |f| f.frame.fpr_of_non_slip_share);
/// From the onset to the first flagged frame at or after it, flags before the onset ignored.
const LATENCY_FROM_ONSET: Measure =
    measure("latency from onset, frames", false, 1.0, |f| f.encoder_events.from_onset_median_frames);
/// Of hits and misses, early events apart: the stricter one.
const LATENCY_WITHOUT_EARLY: Measure =
    measure("latency without early ones, frames", false, 1.0, |f| f.encoder_events.latency_median_frames);
/// Of all events.
const WITHIN_5_FRAMES: Measure =
    measure("early or within 5 frames %", true, 100.0, |f| f.encoder_events.early_or_within_5_frames_share);
/// Of all events.
const AT_ONSET: Measure =
    measure("early or at onset %", true, 100.0, |f| f.encoder_events.early_or_at_onset_share);

/// A split, a measure, and its least or most by [`Measure::more_is_better`], in the measure's unit.
type Target = (&'static str, Measure, f64);

/// All targets, split by split. Whether early events count in a target's latency is not stated, so both latencies
/// are held against it.
const TARGETS: [Target; 16] = [
    ("umi_id", MACRO_F1, 96.8),
    ("umi_id", FPR, 1.33),
    ("umi_id", LATENCY_FROM_ONSET, 2.0),
    ("umi_id", LATENCY_WITHOUT_EARLY, 2.0),
    ("umi_id", WITHIN_5_FRAMES, 76.0),
    ("umi_id", AT_ONSET, 43.0),
    ("umi_ood", MACRO_F1, 95.8),
    ("umi_ood", FPR, 1.57),
    ("umi_ood", LATENCY_FROM_ONSET, 1.5),
    ("umi_ood", LATENCY_WITHOUT_EARLY, 1.5),
    ("umi_ood", WITHIN_5_FRAMES, 76.0),
    ("umi_ood", AT_ONSET, 43.0),
    ("palm", MACRO_F1, 94.6),
    ("tesollo2", MACRO_F1, 94.4),
    ("tesollo2", FPR, 1.14),
    ("tesollo3", MACRO_F1, 90.0),
];

/// Ours beside one target.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct TargetRow {
    pub(crate) input: String,
    /// [`Measure::name`], with the unit of all numbers here.
    pub(crate) measure: &'static str,
    /// Whether `bound` is a least value, else a most.
    pub(crate) at_least: bool,
    pub(crate) bound: f64,
    /// Seed by seed, in the order of the models.
    pub(crate) seed_values: Vec<Option<f64>>,
    /// Over the seeds; null where a seed has none.
    pub(crate) mean: Option<f64>,
    /// Over the seeds, with n − 1; null for one seed.
    pub(crate) standard_deviation: Option<f64>,
    /// Whether the mean, not rounded, keeps the bound.
    pub(crate) met: bool,
}

/// Ours beside a target, from the figures of each seed on the target's split. No seed: not met.
fn row((input, measure, bound): Target, seeds: &[&Figures]) -> TargetRow {
    let value = |figures: &&Figures| (measure.value)(figures).map(|value| measure.factor * value);
    let seed_values: Vec<Option<f64>> = seeds.iter().map(value).collect();
    let values = seed_values.iter().copied().collect::<Option<Vec<f64>>>().unwrap_or_default();
    let mean = mean(&values);
    let at_least = measure.more_is_better;
    let keeps = |mean: f64| if at_least { mean >= bound } else { mean <= bound };
    TargetRow {
        input: input.to_owned(),
        measure: measure.name,
        at_least,
        bound,
        seed_values,
        mean,
        standard_deviation: standard_deviation(&values),
        met: mean.is_some_and(keeps),
    }
}

/// The network beside the targets of the splits that were evaluated; `seeds` are its figures input by input.
pub(crate) fn target_rows(seeds: &[&[InputFigures]]) -> Vec<TargetRow> {
    let beside = |target: Target| {
        let at = seeds.first()?.iter().position(|input| input.input == target.0)?;
        Some(row(target, &seeds.iter().map(|seed| &seed[at].figures).collect::<Vec<_>>()))
    };
    TARGETS.into_iter().filter_map(beside).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn figures(f1: f64, latency: Option<f64>) -> Figures {
        let mut figures = Figures::default();
        figures.frame.macro_f1 = Some(f1);
        figures.encoder_events.from_onset_median_frames = latency;
        figures
    }

    #[test]
    fn means_decide_and_missing_seeds_do_not_pass() {
        let seeds = [figures(0.966, Some(2.0)), figures(0.969, Some(2.5)), figures(0.972, Some(1.0))];
        let seeds: Vec<&Figures> = seeds.iter().collect();
        let umi_id = |measure, bound| row(("umi_id", measure, bound), &seeds);
        let f1 = umi_id(MACRO_F1, 96.8);
        assert!(f1.met && f1.at_least);
        assert!(
            (f1.mean.unwrap() - 96.9).abs() < 1e-9 && (f1.standard_deviation.unwrap() - 0.3).abs() < 1e-9
        );
        assert!(!umi_id(MACRO_F1, 97.0).met);
        let latency = umi_id(LATENCY_FROM_ONSET, 2.0);
        assert!(latency.met && !latency.at_least, "5.5 / 3 frames");
        assert!(!umi_id(LATENCY_FROM_ONSET, 1.5).met);
        // A median at infinity in one seed is no mean, and no figure is no success.
        let missed = figures(0.97, None);
        let missing = row(("umi_id", LATENCY_FROM_ONSET, 2.0), &[seeds[0], &missed]);
        assert_eq!((missing.mean, missing.met), (None, false));
        assert_eq!(missing.seed_values, [Some(2.0), None]);
        assert!(!umi_id(FPR, 1.33).met);
        let one = row(("palm", MACRO_F1, 94.6), &seeds[..1]);
        assert_eq!((one.met, one.standard_deviation), (true, None));
    }
}
