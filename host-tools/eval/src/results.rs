//! All results of an evaluation, as they stand in `metrics.json`.
//!
//! Every number carries its unit in its key: `_frames` of 1/240 s, `_share` from 0 to 1, `_per_hour`,
//! `_hours`, `_mm`, `_us`, `_s`, `_percent`, `_points`; F1 has none. A number that does not exist is null,
//! and [`NULL_REASONS`] says why.

use std::collections::BTreeMap;
use std::ops::Range;

use rayon::prelude::*;
use serde::Serialize;
use slipsense_recording::score::SLIP;

use crate::detector::Prediction;
use crate::detectors::NETWORK;
use crate::directions::{DirectionFigures, by_direction};
use crate::metrics::alarms;
use crate::metrics::bootstrap::{InputFigures, Intervals};
use crate::metrics::events::Cdf;
use crate::metrics::figures::{EpisodeRecord, Figures};
use crate::metrics::groups::{Grouping, grip_bounds_n, groupings};
use crate::metrics::operating::{CurvePoint, TARGET_FPR, curve, figures_at, non_slip_scores, threshold_for};
use crate::metrics::statistics::{mean, share};
use crate::paper::{Comparison, VALIDATION};
use crate::quantization::{QuantizationRow, quantization_rows};
use crate::run::{Candidate, Run};
use crate::source::{Input, STREAMS};
use crate::targets::{TargetRow, target_rows};
use crate::truth::Truth;

/// Name and version of the layout of `metrics.json`; a new number where a key changes its meaning.
pub(crate) const SCHEMA: &str = "slipsense-eval/1";

/// Why a key may be null: by the key's beginning, the first that fits.
pub(crate) const NULL_REASONS: [(&str, &str); 28] = [
    ("latency_", "infinite: that share of the events is missed; or no event was hit or missed"),
    ("from_onset_", "infinite: that share of the events has no flag after its onset; or there is no event"),
    ("travel_", "infinite as the latency is, or the episodes do not hold the position"),
    ("within_", "no event was hit or missed"),
    ("miss_", "no labelled event"),
    ("early_", "no labelled event"),
    ("at_onset_", "no labelled event"),
    ("labelled_", "no labelled event"),
    ("alarms_per_hour", "no time in which an alarm could occur, or too few episodes for an interval"),
    ("upper_bound_per_hour", "no time in which an alarm could occur"),
    ("of_these_truly_sliding", "not every episode holds the slip of the interface"),
    ("interface_events", "not every episode holds the slip of the interface"),
    ("grip_bounds_n", "no episode states its grip"),
    ("worst", "a single group, or no episode with a miss or a false alarm"),
    (
        "operating_point",
        "operating_point_missing_because gives the reason; that itself is null where there is a point",
    ),
    ("against_interface", "not every episode holds the slip of the interface"),
    ("fpr_", "no frame that does not slip, or too few episodes for an interval"),
    ("accuracy", "no frame, or too few episodes for an interval"),
    ("macro_f1", "no frame, or too few episodes for an interval"),
    ("precision_share", "no frame is decided so"),
    ("recall_share", "no frame is so"),
    ("f1", "the class neither occurs nor is decided"),
    ("same_class_share", "no frame"),
    ("detected_share", "no labelled event"),
    ("interface_detected_share", "no event of the interface among the labelled ones"),
    ("mean", "a seed has no such figure; of a latency: it is infinite"),
    ("standard_deviation", "one seed, or a seed has no such figure"),
    ("seed_values", "no such figure; of a latency: it is infinite"),
];

/// The root of `metrics.json`.
#[derive(Clone, Debug, Serialize)]
pub struct Results {
    pub(crate) schema: &'static str,
    /// Whether every episode was made by a generator.
    pub(crate) synthetic: bool,
    /// Whether any was.
    pub(crate) partly_synthetic: bool,
    pub(crate) inputs: Vec<InputInfo>,
    pub(crate) streams: usize,
    /// From start to end, loading or generating the episodes included; of parts, their sum.
    pub wall_s: f64,
    pub threads: usize,
    /// Bounds between the terciles of the grip force.
    pub(crate) grip_bounds_n: Option<[f64; 2]>,
    pub(crate) detectors: Vec<DetectorResults>,
    /// Families of more than one seed.
    pub(crate) seeds: Vec<Spread>,
    /// Ours beside the paper's, where inputs and detectors have the names of its tables.
    pub(crate) paper: Vec<Comparison>,
    /// The network beside its targets, where inputs have the names of the frozen splits.
    pub(crate) targets: Vec<TargetRow>,
    /// Integer against float, input by input: each pair, and their mean where there are several.
    pub(crate) integer_against_float: Vec<QuantizationRow>,
    pub(crate) null_reasons: BTreeMap<&'static str, &'static str>,
}

#[derive(Clone, Debug, Serialize)]
pub(crate) struct InputInfo {
    pub(crate) name: String,
    pub(crate) episodes: usize,
    pub(crate) frames: usize,
    pub(crate) duration_hours: f64,
    /// No contact, no slip, slip by the labels.
    pub(crate) class_shares: [f64; 3],
    pub(crate) labelled_events: usize,
    /// Slip events of the interface; null where not every episode holds them.
    pub(crate) interface_events: Option<usize>,
    pub(crate) synthetic: bool,
}

#[derive(Clone, Debug, Serialize)]
pub(crate) struct DetectorResults {
    pub(crate) name: String,
    /// Threshold of its own, in the unit of its score.
    pub(crate) threshold_score: f64,
    /// Mean processor time on one core of this computer.
    pub(crate) compute_us_per_frame: Option<f64>,
    /// All inputs but validation (where there are others).
    pub(crate) all: Figures,
    pub(crate) all_intervals: Intervals,
    pub(crate) inputs: Vec<InputFigures>,
    /// All inputs but validation, by their properties.
    pub(crate) groupings: Vec<Grouping>,
    /// All inputs but validation, by direction of the slips; empty where all are the rig's.
    pub(crate) directions: Vec<DirectionFigures>,
    /// Distribution of the latencies against the encoder truth, all inputs but validation.
    pub(crate) encoder_cdf: Cdf,
    /// ... against the interface truth.
    pub(crate) interface_cdf: Cdf,
    /// ... against the encoder truth, by speed of the pull.
    pub(crate) speed_cdfs: Vec<SpeedCdf>,
    /// Threshold swept, over all inputs but validation.
    pub(crate) curve: Vec<CurvePoint>,
    pub(crate) operating_point: Option<OperatingPoint>,
    pub(crate) operating_point_missing_because: Option<&'static str>,
    /// The episode with most misses and false alarms; none where nothing went wrong.
    pub(crate) worst_episode: Option<WorstEpisode>,
    #[serde(skip)]
    pub(crate) worst_index: Option<usize>,
}

#[derive(Clone, Debug, Serialize)]
pub(crate) struct SpeedCdf {
    pub(crate) speed_mm_s: f64,
    pub(crate) encoder_cdf: Cdf,
}

/// Figures at the threshold that validation fixed.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct OperatingPoint {
    pub(crate) threshold_score: f64,
    /// FPR of the frames that do not slip that it aims at.
    pub(crate) target_fpr_of_non_slip_share: f64,
    pub(crate) inputs: Vec<PointFigures>,
}

#[derive(Clone, Debug, Serialize)]
pub(crate) struct PointFigures {
    pub(crate) input: String,
    pub(crate) figures: Figures,
}

#[derive(Clone, Debug, Serialize)]
pub(crate) struct WorstEpisode {
    pub(crate) input: String,
    pub(crate) name: String,
    pub(crate) missed_events: usize,
    pub(crate) false_alarms: usize,
}

/// Spread over training seeds on one input: lowest, mean and highest; null where a seed has none.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Spread {
    pub(crate) family: String,
    pub(crate) input: String,
    pub(crate) seeds: usize,
    pub(crate) accuracy_share: Option<[f64; 3]>,
    pub(crate) macro_f1: Option<[f64; 3]>,
    pub(crate) fpr_of_non_slip_share: Option<[f64; 3]>,
    /// Of the medians of the seeds.
    pub(crate) latency_median_frames: Option<[f64; 3]>,
    pub(crate) alarms_per_hour: Option<[f64; 3]>,
}

impl Results {
    /// Compute everything. `pairs` are positions of candidates that should be the same.
    pub fn new(inputs: &[Input], candidates: &[Candidate<'_>], run: &Run, pairs: &[(usize, usize)]) -> Self {
        let infos = inputs.iter().zip(&run.of_input);
        let infos = infos.map(|(input, range)| InputInfo::new(&input.name, &run.truths[range.clone()]));
        let of_candidate = |(e, candidate)| detector(inputs, candidate, e, run);
        let detectors: Vec<DetectorResults> = candidates.par_iter().enumerate().map(of_candidate).collect();
        let same = |pair: usize, input: usize| {
            let episodes = run.of_input[input].clone();
            let [a, b] = [pairs[pair].0, pairs[pair].1].map(|e| &run.predictions[e][episodes.clone()]);
            let classes = a.iter().flat_map(|of| &of.class).zip(b.iter().flat_map(|of| &of.class));
            share(classes.clone().filter(|(a, b)| a == b).count(), classes.count())
        };
        let of_candidates = || candidates.iter().zip(&detectors);
        let paper = of_candidates().flat_map(|(candidate, detector)| {
            let find = |on: &InputFigures| Comparison::find(&candidate.family, &on.input, &on.figures);
            detector.inputs.iter().filter_map(find)
        });
        let seeds = of_candidates().filter(|(candidate, _)| candidate.family == NETWORK);
        let seeds: Vec<&[InputFigures]> = seeds.map(|(_, detector)| &detector.inputs[..]).collect();
        let inputs_of = |e: usize| (detectors[e].name.as_str(), &detectors[e].inputs[..]);
        let named_pairs: Vec<_> = pairs.iter().map(|&(a, b)| [inputs_of(a), inputs_of(b)]).collect();
        Self {
            schema: SCHEMA,
            synthetic: run.truths.iter().all(|truth| truth.info.synthetic),
            partly_synthetic: run.truths.iter().any(|truth| truth.info.synthetic),
            streams: STREAMS,
            wall_s: run.wall.as_secs_f64(),
            threads: rayon::current_num_threads(),
            grip_bounds_n: grip_bounds_n(&run.truths),
            targets: target_rows(&seeds),
            integer_against_float: quantization_rows(&named_pairs, same),
            seeds: spreads(candidates, &detectors),
            paper: paper.collect(),
            null_reasons: NULL_REASONS.into(),
            inputs: infos.collect(),
            detectors,
        }
    }

    pub(crate) fn kind_of_data(&self) -> &'static str {
        match (self.synthetic, self.partly_synthetic) {
            (true, _) => "synthetic data",
            (false, true) => "partly synthetic data",
            (false, false) => "data",
        }
    }
}

impl InputInfo {
    fn new(name: &str, truths: &[Truth]) -> Self {
        let frames: usize = truths.iter().map(Truth::frames).sum();
        let count = |class: u8| -> usize {
            truths.iter().map(|truth| truth.label.iter().filter(|&&label| label == class).count()).sum()
        };
        let interface = |truth: &Truth| truth.interface.as_ref().map(|interface| interface.slip.len());
        Self {
            name: name.to_owned(),
            episodes: truths.len(),
            frames,
            duration_hours: alarms::hours(frames as u64),
            class_shares: [0, 1, SLIP].map(|class| count(class) as f64 / frames.max(1) as f64),
            labelled_events: truths.iter().map(|truth| truth.slip.len()).sum(),
            interface_events: truths.iter().map(interface).sum(),
            synthetic: truths.iter().all(|truth| truth.info.synthetic),
        }
    }
}

/// Positions of the episodes of all inputs but validation, or of validation if there is nothing else.
fn tested(truths: &[Truth]) -> Vec<usize> {
    let all = 0..truths.len();
    let tested: Vec<usize> = all.clone().filter(|&i| truths[i].info.input != VALIDATION).collect();
    if tested.is_empty() { all.collect() } else { tested }
}

fn detector(inputs: &[Input], candidate: &Candidate<'_>, e: usize, run: &Run) -> DetectorResults {
    let predicted: Vec<(&Truth, &Prediction)> = run.truths.iter().zip(&run.predictions[e]).collect();
    let record = |(truth, prediction): &(&Truth, &Prediction)| EpisodeRecord::new(truth, &prediction.class);
    let records: Vec<EpisodeRecord> = predicted.iter().map(record).collect();
    let tested = tested(&run.truths);
    let of_tested: Vec<_> = tested.iter().map(|&i| (&run.truths[i], &records[i])).collect();
    let tested_records: Vec<&EpisodeRecord> = tested.iter().map(|&i| &records[i]).collect();
    let tested_predicted: Vec<_> = tested.iter().map(|&i| predicted[i]).collect();
    let own = predicted.first().map_or(0.0, |(_, prediction)| prediction.threshold);
    let of_inputs = || inputs.iter().map(|input| &input.name).zip(run.of_input.iter().cloned());
    let validation = of_inputs().find(|(name, _)| *name == VALIDATION);
    let fixed =
        validation.and_then(|(_, range)| threshold_for(&non_slip_scores(&predicted[range]), TARGET_FPR));
    let point = |threshold: f32| {
        let figures = |(name, range): (&String, Range<usize>)| PointFigures {
            input: name.clone(),
            figures: figures_at(&predicted[range], threshold),
        };
        OperatingPoint {
            threshold_score: threshold.into(),
            target_fpr_of_non_slip_share: TARGET_FPR,
            inputs: of_inputs().map(figures).collect(),
        }
    };
    let input_figures = |(name, range): (&String, Range<usize>)| {
        let records: Vec<&EpisodeRecord> = records[range].iter().collect();
        InputFigures {
            input: name.clone(),
            figures: Figures::new(records.iter().copied()),
            intervals: Intervals::new(&records),
        }
    };
    let worst = tested.iter().copied().max_by_key(|&i| (records[i].failures(), std::cmp::Reverse(i)));
    let worst = worst.filter(|&i| records[i].failures() > 0);
    DetectorResults {
        name: candidate.name.clone(),
        threshold_score: own.into(),
        compute_us_per_frame: run.us_per_frame(e),
        all: Figures::new(tested_records.iter().copied()),
        all_intervals: Intervals::new(&tested_records),
        inputs: of_inputs().map(input_figures).collect(),
        groupings: groupings(&of_tested),
        directions: by_direction(&of_tested),
        encoder_cdf: Cdf::new(tested_records.iter().flat_map(|record| &record.events.encoder)),
        interface_cdf: Cdf::new(tested_records.iter().flat_map(|record| &record.events.interface)),
        speed_cdfs: speed_cdfs(&of_tested),
        curve: curve(&tested_predicted, own, fixed),
        operating_point: fixed.map(point),
        operating_point_missing_because: fixed
            .is_none()
            .then_some("the validation split was not among the inputs, or holds no frame that does not slip"),
        worst_episode: worst.map(|i| {
            let (info, record) = (&run.truths[i].info, &records[i]);
            let false_alarms = record.alarms.total() as usize;
            WorstEpisode {
                input: info.input.clone(),
                name: info.name.clone(),
                missed_events: record.failures() - false_alarms,
                false_alarms,
            }
        }),
        worst_index: worst,
    }
}

fn speed_cdfs(episodes: &[(&Truth, &EpisodeRecord)]) -> Vec<SpeedCdf> {
    let slipping = episodes.iter().filter(|(truth, _)| !truth.slip.is_empty());
    let mut speeds: Vec<f64> = slipping.filter_map(|(truth, _)| truth.info.speed_mm_s).collect();
    speeds.sort_by(f64::total_cmp);
    speeds.dedup();
    let cdf = |speed_mm_s: f64| {
        let at_speed = episodes.iter().filter(|(truth, _)| truth.info.speed_mm_s == Some(speed_mm_s));
        SpeedCdf {
            speed_mm_s,
            encoder_cdf: Cdf::new(at_speed.flat_map(|(_, record)| &record.events.encoder)),
        }
    };
    speeds.into_iter().map(cdf).collect()
}

fn spreads(candidates: &[Candidate<'_>], detectors: &[DetectorResults]) -> Vec<Spread> {
    let mut spreads = Vec::new();
    let of_candidates: Vec<_> = candidates.iter().zip(detectors).collect();
    for seeds in of_candidates.chunk_by(|a, b| a.0.family == b.0.family) {
        let [(candidate, first), _, ..] = seeds else { continue };
        for (i, input) in first.inputs.iter().enumerate() {
            let spread = |value: fn(&Figures) -> Option<f64>| -> Option<[f64; 3]> {
                let values = seeds.iter().map(|(_, seed)| value(&seed.inputs[i].figures));
                let values = values.collect::<Option<Vec<f64>>>()?;
                let low = values.iter().copied().fold(f64::INFINITY, f64::min);
                let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
                Some([low, mean(&values)?, high])
            };
            spreads.push(Spread {
                family: candidate.family.clone(),
                input: input.input.clone(),
                seeds: seeds.len(),
                accuracy_share: spread(|f| f.frame.accuracy_share),
                macro_f1: spread(|f| f.frame.macro_f1),
                fpr_of_non_slip_share: spread(|f| f.frame.fpr_of_non_slip_share),
                latency_median_frames: spread(|f| f.encoder_events.latency_median_frames),
                alarms_per_hour: spread(|f| f.alarms.all.alarms_per_hour),
            });
        }
    }
    spreads
}
