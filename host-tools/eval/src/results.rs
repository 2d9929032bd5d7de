//! All results of an evaluation, as they stand in `metrics.json`.
//!
//! Every number carries its unit in its key: `_frames` of 1/240 s, `_share` from 0 to 1, `_per_hour`,
//! `_hours`, `_mm`, `_us`, `_s`, `_percent`, `_points`; F1 has none. A number that does not exist is null,
//! and [`NULL_REASONS`] says why.

use std::collections::BTreeMap;

use rayon::prelude::*;
use serde::Serialize;
use slipsense_recording::score::SLIP;

use crate::detectors::Verdict;
use crate::directions::{DirectionFigures, by_direction};
use crate::integer_float::{self, QuantizationRow};
use crate::metrics::alarms;
use crate::metrics::bootstrap::Intervals;
use crate::metrics::cdf::Cdf;
use crate::metrics::groups::{Grouping, grip_bounds_n, groupings};
use crate::metrics::operating::{CurvePoint, TARGET_FPR, curve, figures_at, non_slip_scores, threshold_for};
use crate::metrics::pairs::Pair;
use crate::metrics::record::{Figures, Record};
use crate::paper::{Comparison, VALIDATION};
use crate::run::{Entrant, Run};
use crate::source::{Input, STREAMS};
use crate::targets::{self, TargetRow};
use crate::truth::Truth;

/// Name and version of the layout of `metrics.json`; a new number where a key changes its meaning.
pub const SCHEMA: &str = "slipsense-eval/1";

/// Why a key may be null: by the key's beginning, the first that fits.
pub const NULL_REASONS: [(&str, &str); 28] = [
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
        "operating_point_missing_because says it; that itself is null where there is a point",
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
    /// [`SCHEMA`].
    pub schema: &'static str,
    /// Whether every episode was made by a generator.
    pub synthetic: bool,
    /// Whether any was.
    pub partly_synthetic: bool,
    /// What was evaluated.
    pub inputs: Vec<InputFacts>,
    /// Streams per input, at most.
    pub streams: usize,
    /// From start to end, loading or generating the episodes included.
    pub wall_s: f64,
    /// Threads that worked.
    pub threads: usize,
    /// Bounds between the terciles of the grip force.
    pub grip_bounds_n: Option<[f64; 2]>,
    /// Detector by detector, in the order asked for.
    pub detectors: Vec<DetectorResults>,
    /// Pairs that should be the same.
    pub pairs: Vec<Pair>,
    /// Families of more than one seed.
    pub seeds: Vec<Spread>,
    /// Ours beside the paper's, where inputs and detectors have the names of its tables.
    pub paper: Vec<Comparison>,
    /// The network beside its targets, where inputs have the names of the frozen splits.
    pub targets: Vec<TargetRow>,
    /// Integer against float, input by input: each pair, and their mean where there are several.
    pub integer_against_float: Vec<QuantizationRow>,
    /// Why a key may be null, by its beginning.
    pub null_reasons: BTreeMap<&'static str, &'static str>,
}

/// One input.
#[derive(Clone, Debug, Serialize)]
pub struct InputFacts {
    /// Name.
    pub name: String,
    /// Episodes.
    pub episodes: usize,
    /// Frames.
    pub frames: usize,
    /// Length of all episodes.
    pub duration_hours: f64,
    /// No contact, no slip, slip by the labels.
    pub class_shares: [f64; 3],
    /// Labelled slip events.
    pub labelled_events: usize,
    /// Slip events of the interface; null where not every episode holds them.
    pub interface_events: Option<usize>,
    /// Every episode was made by a generator.
    pub synthetic: bool,
}

/// One detector.
#[derive(Clone, Debug, Serialize)]
pub struct DetectorResults {
    /// Name.
    pub name: String,
    /// Threshold of its own, in the unit of its score.
    pub threshold_score: f64,
    /// Mean processor time on one core of this computer.
    pub compute_us_per_frame: Option<f64>,
    /// All inputs but validation (where there are others).
    pub all: Figures,
    /// Of `all`.
    pub all_intervals: Intervals,
    /// Input by input.
    pub inputs: Vec<InputFigures>,
    /// All inputs but validation, cut up.
    pub groupings: Vec<Grouping>,
    /// All inputs but validation, by direction of the slips; empty where all are the rig's.
    pub directions: Vec<DirectionFigures>,
    /// Distribution of the latencies against the encoder truth, all inputs but validation.
    pub encoder_cdf: Cdf,
    /// ... against the interface truth.
    pub interface_cdf: Cdf,
    /// ... against the encoder truth, by speed of the pull.
    pub speed_cdfs: Vec<SpeedCdf>,
    /// Threshold swept, over all inputs but validation.
    pub curve: Vec<CurvePoint>,
    /// The point that the validation input fixed.
    pub operating_point: Option<OperatingPoint>,
    /// Why there is none.
    pub operating_point_missing_because: Option<&'static str>,
    /// The episode with most misses and false alarms; none where nothing went wrong.
    pub worst_episode: Option<WorstEpisode>,
    /// Its position among all episodes.
    #[serde(skip)]
    pub worst_index: Option<usize>,
}

/// Latencies at one speed.
#[derive(Clone, Debug, Serialize)]
pub struct SpeedCdf {
    /// Speed of the pull.
    pub speed_mm_s: f64,
    /// Against the encoder truth.
    pub encoder_cdf: Cdf,
}

/// One detector on one input.
#[derive(Clone, Debug, Serialize)]
pub struct InputFigures {
    /// Input.
    pub input: String,
    /// Figures at the detector's own threshold.
    pub figures: Figures,
    /// 95 % intervals, bootstrap over episodes.
    pub intervals: Intervals,
}

/// Figures at the threshold that validation fixed.
#[derive(Clone, Debug, Serialize)]
pub struct OperatingPoint {
    /// Threshold.
    pub threshold_score: f64,
    /// FPR of the frames that do not slip that it aims at.
    pub target_fpr_of_non_slip_share: f64,
    /// Input by input.
    pub inputs: Vec<PointFigures>,
}

/// One input at the operating point.
#[derive(Clone, Debug, Serialize)]
pub struct PointFigures {
    /// Input.
    pub input: String,
    /// Figures.
    pub figures: Figures,
}

/// Where it went worst.
#[derive(Clone, Debug, Serialize)]
pub struct WorstEpisode {
    /// Input.
    pub input: String,
    /// Episode.
    pub name: String,
    /// Missed events.
    pub missed_events: usize,
    /// False alarms.
    pub false_alarms: usize,
}

/// Spread over training seeds on one input: lowest, mean and highest.
#[derive(Clone, Debug, Serialize)]
pub struct Spread {
    /// Family of detectors.
    pub family: String,
    /// Input.
    pub input: String,
    /// Seeds.
    pub seeds: usize,
    /// Lowest, mean, highest; null where a seed has none.
    pub accuracy_share: Option<[f64; 3]>,
    /// Likewise.
    pub macro_f1: Option<[f64; 3]>,
    /// Likewise.
    pub fpr_of_non_slip_share: Option<[f64; 3]>,
    /// Likewise, of the medians of the seeds.
    pub latency_median_frames: Option<[f64; 3]>,
    /// Likewise.
    pub alarms_per_hour: Option<[f64; 3]>,
}

impl Results {
    /// Work out everything. `pairs` are positions of entrants that should be the same.
    pub fn new(inputs: &[Input], entrants: &[Entrant<'_>], run: &Run, pairs: &[(usize, usize)]) -> Self {
        let facts: Vec<InputFacts> = inputs
            .iter()
            .zip(&run.of_input)
            .map(|(input, range)| InputFacts::new(&input.name, &run.truths[range.clone()]))
            .collect();
        let detectors: Vec<DetectorResults> =
            entrants.par_iter().enumerate().map(|(e, entrant)| detector(inputs, entrant, e, run)).collect();
        let pair = |&(a, b): &(usize, usize)| {
            let of = |e: usize| (detectors[e].name.as_str(), &detectors[e].all);
            let tested = tested(inputs, run);
            let verdicts = tested.iter().map(|&i| (&run.verdicts[a][i], &run.verdicts[b][i]));
            Pair::new(of(a), of(b), verdicts)
        };
        let compare = |detector: &DetectorResults, entrant: &Entrant<'_>| -> Vec<Comparison> {
            let of_input = |of: &InputFigures| Comparison::find(&entrant.family, &of.input, &of.figures);
            detector.inputs.iter().filter_map(of_input).collect()
        };
        Self {
            schema: SCHEMA,
            synthetic: run.truths.iter().all(|truth| truth.facts.synthetic),
            partly_synthetic: run.truths.iter().any(|truth| truth.facts.synthetic),
            streams: STREAMS,
            wall_s: run.wall.as_secs_f64(),
            threads: rayon::current_num_threads(),
            grip_bounds_n: grip_bounds_n(&run.truths),
            targets: targets::rows(entrants, &detectors),
            integer_against_float: integer_float::rows(&detectors, pairs),
            pairs: pairs.iter().map(pair).collect(),
            seeds: spreads(entrants, &detectors, &facts),
            paper: detectors.iter().zip(entrants).flat_map(|(d, e)| compare(d, e)).collect(),
            null_reasons: NULL_REASONS.into(),
            inputs: facts,
            detectors,
        }
    }
}

impl InputFacts {
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
            synthetic: truths.iter().all(|truth| truth.facts.synthetic),
        }
    }
}

/// Positions of the episodes of all inputs but validation, or of validation if there is nothing else.
fn tested(inputs: &[Input], run: &Run) -> Vec<usize> {
    let all = |with_validation: bool| -> Vec<usize> {
        let inputs = inputs.iter().zip(&run.of_input);
        let wanted = inputs.filter(|(input, _)| with_validation || input.name != VALIDATION);
        wanted.flat_map(|(_, range)| range.clone()).collect()
    };
    let tested = all(false);
    if tested.is_empty() { all(true) } else { tested }
}

fn detector(inputs: &[Input], entrant: &Entrant<'_>, e: usize, run: &Run) -> DetectorResults {
    let verdicts = &run.verdicts[e];
    let records: Vec<Record> =
        run.truths.iter().zip(verdicts).map(|(truth, verdict)| Record::new(truth, &verdict.class)).collect();
    let tested = tested(inputs, run);
    let of_tested: Vec<&Record> = tested.iter().map(|&i| &records[i]).collect();
    let judged = |episodes: &mut dyn Iterator<Item = usize>| -> Vec<(&Truth, &Verdict)> {
        episodes.map(|i| (&run.truths[i], &verdicts[i])).collect()
    };
    let own = verdicts.first().map_or(0.0, |verdict| verdict.threshold);
    let validation = inputs.iter().zip(&run.of_input).find(|(input, _)| input.name == VALIDATION);
    let fixed = validation
        .and_then(|(_, range)| threshold_for(&non_slip_scores(&judged(&mut range.clone())), TARGET_FPR));
    let point = |threshold: f32| OperatingPoint {
        threshold_score: threshold.into(),
        target_fpr_of_non_slip_share: TARGET_FPR,
        inputs: inputs
            .iter()
            .zip(&run.of_input)
            .map(|(input, range)| PointFigures {
                input: input.name.clone(),
                figures: figures_at(&judged(&mut range.clone()), threshold),
            })
            .collect(),
    };
    let judged_tested: Vec<(&Truth, &Record)> =
        tested.iter().map(|&i| (&run.truths[i], &records[i])).collect();
    let worst = tested.iter().copied().max_by_key(|&i| (records[i].failures(), std::cmp::Reverse(i)));
    let worst = worst.filter(|&i| records[i].failures() > 0);
    DetectorResults {
        name: entrant.name.clone(),
        threshold_score: own.into(),
        compute_us_per_frame: run.us_per_frame(e),
        all: Figures::new(of_tested.iter().copied()),
        all_intervals: Intervals::new(&of_tested),
        inputs: inputs
            .iter()
            .zip(&run.of_input)
            .map(|(input, range)| {
                let records: Vec<&Record> = records[range.clone()].iter().collect();
                InputFigures {
                    input: input.name.clone(),
                    figures: Figures::new(records.iter().copied()),
                    intervals: Intervals::new(&records),
                }
            })
            .collect(),
        groupings: groupings(&judged_tested),
        directions: by_direction(&judged_tested),
        encoder_cdf: Cdf::new(of_tested.iter().flat_map(|record| &record.events.encoder)),
        interface_cdf: Cdf::new(of_tested.iter().flat_map(|record| &record.events.interface)),
        speed_cdfs: speed_cdfs(&tested, &run.truths, &records),
        curve: curve(&judged(&mut tested.iter().copied()), own, fixed),
        operating_point: fixed.map(point),
        operating_point_missing_because: fixed
            .is_none()
            .then_some("the validation split was not among the inputs, or holds no frame that does not slip"),
        worst_episode: worst.map(|i| {
            let (facts, record) = (&run.truths[i].facts, &records[i]);
            let false_alarms = record.alarms.total() as usize;
            WorstEpisode {
                input: facts.input.clone(),
                name: facts.name.clone(),
                missed_events: record.failures() - false_alarms,
                false_alarms,
            }
        }),
        worst_index: worst,
    }
}

fn speed_cdfs(tested: &[usize], truths: &[Truth], records: &[Record]) -> Vec<SpeedCdf> {
    let slips = |&&i: &&usize| !truths[i].slip.is_empty();
    let speed = |&i: &usize| truths[i].facts.speed_mm_s;
    let mut speeds: Vec<f64> = tested.iter().filter(slips).filter_map(speed).collect();
    speeds.sort_by(f64::total_cmp);
    speeds.dedup();
    let cdf = |speed_mm_s: f64| {
        let at_speed = tested.iter().filter(|&&i| truths[i].facts.speed_mm_s == Some(speed_mm_s));
        SpeedCdf { speed_mm_s, encoder_cdf: Cdf::new(at_speed.flat_map(|&i| &records[i].events.encoder)) }
    };
    speeds.into_iter().map(cdf).collect()
}

fn spreads(entrants: &[Entrant<'_>], detectors: &[DetectorResults], inputs: &[InputFacts]) -> Vec<Spread> {
    let mut families: Vec<&str> = entrants.iter().map(|entrant| entrant.family.as_str()).collect();
    families.dedup();
    let members = |family: &str| -> Vec<&DetectorResults> {
        let all = entrants.iter().zip(detectors);
        all.filter(|(entrant, _)| entrant.family == family).map(|(_, detector)| detector).collect()
    };
    let mut spreads = Vec::new();
    for family in families {
        let members = members(family);
        if members.len() < 2 {
            continue;
        }
        for (i, input) in inputs.iter().enumerate() {
            let of = |value: fn(&Figures) -> Option<f64>| -> Option<[f64; 3]> {
                let values =
                    members.iter().map(|m| value(&m.inputs[i].figures)).collect::<Option<Vec<f64>>>()?;
                let low = values.iter().copied().fold(f64::INFINITY, f64::min);
                let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
                Some([low, values.iter().sum::<f64>() / values.len() as f64, high])
            };
            spreads.push(Spread {
                family: family.to_owned(),
                input: input.name.clone(),
                seeds: members.len(),
                accuracy_share: of(|f| f.frame.accuracy_share),
                macro_f1: of(|f| f.frame.macro_f1),
                fpr_of_non_slip_share: of(|f| f.frame.fpr_of_non_slip_share),
                latency_median_frames: of(|f| f.encoder_events.latency_median_frames),
                alarms_per_hour: of(|f| f.alarms.all.alarms_per_hour),
            });
        }
    }
    spreads
}
