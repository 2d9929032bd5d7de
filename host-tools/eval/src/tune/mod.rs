//! The operating point of a model: threshold and k-of-n, chosen on validation data only.
//!
//! Two inputs: disturbances without slip, and the validation splits, which give what is missed and how late the rest is
//! found; both give false alarms. They are of validation objects, in the laboratory's physics and in families that
//! training may see. Training has none of these objects; of the tests, `noslip` and `transfer_noslip` have them in a
//! third of their episodes, with other seeds. For every rule of [`RULES`] the threshold is the lowest that keeps to the
//! rate of false alarms; of the rules that one is chosen that finds most of the interface's sustained sliding
//! [in time](IN_TIME_FRAMES), then the one that misses least, then the one that remembers least. In time first: what is
//! found later helps a controller little, and a rule of many frames trades the one for the other.
//!
//! Events, false alarms and exposure are the benchmark's ([`crate::metrics`]), with one exception: an alarm while most of
//! the contact slides is not false here. By the labels it is where an object turns around a centre that sticks, or comes
//! to rest, and of the few false alarms that are allowed most would be such ones.

use std::cmp::Reverse;
use std::fmt;
use std::ops::Range;

use anyhow::{Result, ensure};
use plotters::prelude::{IntoLogRange, SeriesLabelPosition};
use rayon::prelude::*;
use serde::Serialize;
use serde_json::{Value, json};
use slipsense::fixed::Logit;
use slipsense::net::Model;
use slipsense::net::format::OperatingPoint;
use slipsense::params::FRAME_RATE_HZ;
use slipsense_recording::threshold::lowest_threshold;
use slipsense_synth::Split;
use slipsense_synth::splits::{EpisodeSet, FROZEN_SEED, tuning_disturbances};

use crate::detectors::network::{KthLargest, PipelineStream};
use crate::metrics::alarms::{AlarmCounts, AlarmFigures};
use crate::metrics::events::{EventFigures, Outcome, Outcomes};
use crate::metrics::statistics::share;
use crate::report::plots::{Axes, Line, plot};
use crate::source::{Handle, Input};
use crate::table::{Table, latency, number, percent};
use crate::truth::Truth;

/// The rules tried, k of n: from the first frame over the threshold to 8 of 50 ms.
pub const RULES: [(u8, u8); 14] = [
    (1, 1),
    (2, 2),
    (2, 3),
    (3, 3),
    (3, 4),
    (3, 5),
    (4, 5),
    (4, 6),
    (5, 8),
    (6, 8),
    (8, 10),
    (8, 12),
    (10, 16),
    (16, 24),
];

/// Frames from the onset within which a slip is found in time: 50 ms.
const IN_TIME_FRAMES: usize = FRAME_RATE_HZ as usize / 20;

/// False alarms per hour at which the chosen rule is shown.
const CURVE_PER_HOUR: [f64; 9] = [0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0];

/// Disturbances without slip, generated while they are used; each episode is a minute.
pub fn disturbances(hours: f64) -> Input {
    Input::recipes("disturbances", tuning_disturbances((hours * 60.0).ceil() as usize))
}

/// The first episodes of the validation splits in turn.
pub fn slips(episodes: usize) -> Input {
    let first = |split: Split| EpisodeSet::first(split, FROZEN_SEED, episodes.div_ceil(2)).episodes;
    let pairs = first(Split::Val).into_iter().zip(first(Split::ValAnywhere));
    let both = pairs.flat_map(|(laboratory, families)| [laboratory, families]).take(episodes);
    Input::recipes("val, val_anywhere", both.map(|e| (e.name, e.recipe)).collect())
}

/// The detector's log-odds in one episode.
#[derive(Clone, Debug)]
pub struct Margins {
    pub(crate) truth: Truth,
    /// The same with [`Truth::slip_or_mostly_sliding`] as the slip: no alarm is false in it.
    sliding: Truth,
    /// [`Output::log_odds`](slipsense::pipeline::Output::log_odds) of each frame.
    pub(crate) margin: Vec<Option<Logit>>,
    /// The pipeline was new: nothing of the episodes before is remembered.
    pub(crate) starts_anew: bool,
}

impl Margins {
    pub(crate) fn new(truth: Truth, margin: Vec<Option<Logit>>, starts_anew: bool) -> Self {
        let sliding = Truth { slip: truth.slip_or_mostly_sliding(), ..truth.clone() };
        Self { truth, sliding, margin, starts_anew }
    }
}

/// Run the pipeline over all episodes of an input, cut into streams as an evaluation is, in parallel.
/// `done` is called after each episode.
pub fn margins(input: &Input, model: Model<'_>, done: &(dyn Fn() + Sync)) -> Result<Vec<Margins>> {
    let stream = |episodes: Range<usize>| -> Result<Vec<Margins>> {
        let mut pipeline = PipelineStream::new(model, None);
        let run = |handle: &Handle| {
            let episode = handle.load()?;
            let truth = Truth::new(&episode, &input.name, &handle.name())?;
            let mut margin = Vec::with_capacity(episode.frames());
            let goes_on = pipeline.run(&episode, |output| margin.push(output.log_odds))?;
            done();
            Ok(Margins::new(truth, margin, !goes_on))
        };
        input.episodes[episodes].iter().map(run).collect()
    };
    let streams = input.streams().into_par_iter().map(stream).collect::<Result<Vec<_>>>()?;
    Ok(streams.into_iter().flatten().collect())
}

/// A k-of-n rule and its figures at its threshold.
#[derive(Clone, Debug, Serialize)]
pub struct Rule {
    /// The threshold, 1/1024 nat.
    pub(crate) threshold_q10: i32,
    /// Frames that must be over.
    pub(crate) k: u8,
    /// Frames looked back over.
    pub(crate) n: u8,
    /// False alarms of both inputs.
    pub(crate) disturbances: AlarmFigures,
    /// Sustained sliding of the interface; labelled events where an episode does not know it.
    pub(crate) slips: EventFigures,
    /// Of `slips`, those with the flag up within [`IN_TIME_FRAMES`] of the onset.
    pub(crate) in_time: usize,
}

impl Rule {
    /// The point to write into a model file.
    pub fn point(&self) -> OperatingPoint {
        OperatingPoint { threshold: Logit::from_bits(self.threshold_q10), k: self.k, n: self.n }
    }
}

/// All rules and which one is chosen.
#[derive(Clone, Debug, Serialize)]
pub struct Tuning {
    /// False alarms per hour that were allowed.
    pub(crate) target_alarms_per_hour: f64,
    /// In the order of [`RULES`].
    pub(crate) rows: Vec<Rule>,
    /// Index into `rows`.
    pub(crate) chosen: usize,
    /// The chosen rule at the rates of [`CURVE_PER_HOUR`].
    pub(crate) curve: Vec<Rule>,
}

/// Try every rule. `disturbances` must hold exposure, `slips` a labelled slip.
pub fn tune(disturbances: &[Margins], slips: &[Margins], target_alarms_per_hour: f64) -> Result<Tuning> {
    let mut exposure = AlarmCounts::default();
    for episode in disturbances.iter().chain(slips) {
        exposure.add(&AlarmCounts::new(&episode.sliding, &vec![0; episode.truth.frames()]));
    }
    // A product that should be whole may fall just short of it.
    let of_rate = |per_hour: f64| (per_hour * exposure.hours() + 1e-9) as u64;
    let allowed = of_rate(target_alarms_per_hour);
    ensure!(!disturbances.is_empty(), "there are no disturbances");
    ensure!(exposure.hours() > 0.0, "the episodes hold no frame in which an alarm would be false");
    ensure!(slips.iter().any(|episode| !episode.truth.slip.is_empty()), "the slip episodes hold no slip");
    let rows: Vec<Rule> =
        RULES.into_par_iter().map(|rule| at_most(disturbances, slips, rule, allowed)).collect();
    let rank = |&row: &usize| (Reverse(rows[row].in_time), rows[row].slips.missed, rows[row].n);
    let chosen = (0..rows.len()).min_by_key(rank).unwrap_or_default();
    let rule = (rows[chosen].k, rows[chosen].n);
    let curve = CURVE_PER_HOUR.into_par_iter();
    let curve = curve.map(|rate| at_most(disturbances, slips, rule, of_rate(rate))).collect();
    Ok(Tuning { target_alarms_per_hour, rows, chosen, curve })
}

/// A rule at the lowest threshold that raises no more than `allowed` false alarms.
fn at_most(disturbances: &[Margins], slips: &[Margins], (k, n): (u8, u8), allowed: u64) -> Rule {
    let (quiet, slipping) = (scores(disturbances, k, n), scores(slips, k, n));
    let scored: Vec<_> = quiet.into_iter().chain(slipping.iter().cloned()).collect();
    let of_slip: Vec<_> =
        scored.iter().map(|(episode, scores)| (&episode.sliding.slip[..], scores.clone())).collect();
    let threshold = lowest_threshold(&of_slip, allowed);
    let mut counts = AlarmCounts::default();
    for (episode, scores) in &scored {
        counts.add(&AlarmCounts::new(&episode.sliding, &flags(scores, threshold)));
    }
    let mut outcomes: Vec<Outcome> = Vec::new();
    for (Margins { truth, .. }, scores) in slipping {
        let found = Outcomes::new(truth, &flags(&scores, threshold));
        outcomes.extend(if truth.interface.is_some() { found.interface } else { found.encoder });
    }
    let slips = EventFigures::new(&outcomes.iter().collect::<Vec<_>>());
    let found = outcomes.iter().filter_map(|outcome| outcome.from_onset);
    let in_time = found.filter(|&delay| delay <= IN_TIME_FRAMES).count();
    Rule {
        threshold_q10: threshold.to_bits(),
        k,
        n,
        disturbances: AlarmFigures::new(&counts),
        slips,
        in_time,
    }
}

/// The k-th largest margins, frame by frame, remembered from episode to episode as the alarm does.
fn scores(episodes: &[Margins], k: u8, n: u8) -> Vec<(&Margins, Vec<Option<Logit>>)> {
    let mut recent = KthLargest::new(k, n);
    let episode_scores = |episode: &'_ Margins| {
        if episode.starts_anew {
            recent.clear();
        }
        episode.margin.iter().map(|&margin| recent.push(margin)).collect()
    };
    let scores: Vec<Vec<Option<Logit>>> = episodes.iter().map(episode_scores).collect();
    episodes.iter().zip(scores).collect()
}

fn flags(scores: &[Option<Logit>], threshold: Logit) -> Vec<u8> {
    scores.iter().map(|score| score.is_some_and(|score| score > threshold).into()).collect()
}

impl Tuning {
    pub fn best(&self) -> &Rule {
        &self.rows[self.chosen]
    }

    /// On what the point was chosen, for the provenance of the model; `episodes` of the validation split.
    pub fn provenance(&self, episodes: u32) -> Value {
        let best = self.best();
        json!({
            "data": "synthetic, validation objects: disturbances without slip, splits val and val_anywhere",
            "hours": best.disturbances.all.exposure_hours,
            "alarms": best.disturbances.all.alarms,
            "target_alarms_per_hour": self.target_alarms_per_hour,
            "episodes": episodes,
            "slips": best.slips.events,
            "missed": best.slips.missed,
            "in_time": best.in_time,
            "early": best.slips.early,
            "latency_median_frames": best.slips.latency_median_frames,
        })
    }

    /// The operating curve as a picture, SVG: what is missed and how late the rest is found, by false alarms per hour.
    pub fn curve_svg(&self) -> Result<String> {
        let line = |name: &str, value: &dyn Fn(&EventFigures) -> Option<f64>| {
            let at = |rule: &Rule| {
                let rate = rule.disturbances.all.alarms_per_hour?.max(CURVE_PER_HOUR[0]);
                Some((rate, value(&rule.slips).filter(|value| *value <= CURVE_TOP)?))
            };
            let marks = at(self.best()).map(|point| (point, true)).into_iter().collect();
            Line { name: name.to_owned(), points: self.curve.iter().filter_map(at).collect(), marks }
        };
        let axes = Axes {
            title: "Operating curve, synthetic validation data",
            x: "false alarms per hour",
            y: "% missed, frames of delay",
            legend: SeriesLabelPosition::UpperRight,
        };
        let lines = [
            line("missed, %", &|slips| slips.miss_share.map(|share| 100.0 * share)),
            line("median delay, frames", &|slips| slips.latency_median_frames),
        ];
        let rates = CURVE_PER_HOUR[0]..CURVE_PER_HOUR[CURVE_PER_HOUR.len() - 1];
        plot(&axes, rates.log_scale(), 0.0..CURVE_TOP, &lines)
    }
}

/// Largest value of the operating curve's axis.
const CURVE_TOP: f64 = 100.0;

impl fmt::Display for Tuning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let chosen =
            self.rows.iter().enumerate().map(|(i, row)| (if i == self.chosen { "chosen" } else { "" }, row));
        let rows = chosen.chain(self.curve.iter().map(|row| ("curve", row)));
        let table = Table::rows("", 2, rows).columns(&[
            ("k of n", |(_, row)| format!("{} of {}", row.k, row.n)),
            ("", |(mark, _)| (*mark).to_owned()),
            ("threshold nat", |(_, row)| format!("{:.3}", Logit::from_bits(row.threshold_q10).to_f64())),
            ("alarms", |(_, row)| row.disturbances.all.alarms.to_string()),
            ("/h", |(_, row)| number(row.disturbances.all.alarms_per_hour, 2)),
            ("< /h", |(_, row)| number(row.disturbances.all.upper_bound_per_hour, 2)),
            ("missed %", |(_, row)| percent(row.slips.miss_share)),
            ("≤50 ms %", |(_, row)| percent(share(row.in_time, row.slips.events))),
            ("latency fr", |(_, row)| {
                latency(row.slips.latency_median_frames, row.slips.hits + row.slips.missed)
            }),
        ]);
        write!(f, "{table}")?;
        let row = self.best();
        write!(
            f,
            "  synthetic validation data: {:.2} h without slip, {} slips; < /h: 95 % bound, of a threshold that was \
             chosen on these data",
            row.disturbances.all.exposure_hours, row.slips.events
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::truth::Interface;

    /// `margin` by frame; slip where the label says.
    fn margins(slip: Vec<(usize, usize)>, margin: impl Fn(usize) -> i32) -> Margins {
        let frames = 240 * 60;
        let mut label = vec![1; frames];
        for (start, end) in slip {
            label[start..end].fill(2);
        }
        let margin = (0..frames).map(|f| Some(Logit::from_bits(margin(f)))).collect();
        Margins::new(Truth::from_labels(label), margin, true)
    }

    /// Disturbances have large margins for 2 frames, slip smaller ones that last: only a rule of more than 2 frames
    /// distinguishes them, and of those the quickest is chosen.
    #[test]
    fn short_and_strong_is_distinguished_from_long_and_weak() {
        let taps = vec![margins(Vec::new(), |f| if f % 500 < 2 { 5_000 } else { -3_000 }); 60];
        let slip = |f: usize| if (3_000..3_100).contains(&f) { 2_000 } else { -3_000 };
        let slips = [margins(vec![(3_000, 3_100)], slip)];
        let tuning = tune(&taps, &slips, 1.0).unwrap();
        let best = tuning.best();
        assert_eq!((best.k, best.n, best.threshold_q10), (3, 3, -3_000), "{tuning}");
        assert_eq!((best.slips.missed, best.slips.latency_median_frames), (0, Some(2.0)));
        assert_eq!(best.disturbances.all.alarms, 0);
        assert_eq!((tuning.rows[0].threshold_q10, tuning.rows[0].slips.missed), (5_000, 1));
        for row in &tuning.rows {
            let allowed = row.disturbances.all.exposure_hours;
            assert!(row.disturbances.all.alarms as f64 <= allowed, "{} of {}", row.k, row.n);
        }
        assert_eq!(best.point().check(), Ok(()));
    }

    /// Disturbances of 15 frames: 16 of 24 ignores them and finds the weak slips, late; the others find the strong ones.
    #[test]
    fn what_is_found_in_time_counts_before_what_is_found_at_all() {
        let drags = vec![margins(Vec::new(), |f| if f % 500 < 15 { 4_000 } else { -3_000 }); 60];
        let starts = [1_000, 2_000, 3_000, 4_000, 5_000];
        let margin = |f: usize| match (f / 1_000, f % 1_000) {
            (1 | 2, 0..8) => 5_000,
            (3..=5, 0..100) => 1_000,
            _ => -3_000,
        };
        let slips = [margins(starts.map(|start| (start, start + 100)).to_vec(), margin)];
        let tuning = tune(&drags, &slips, 1.0).unwrap();
        let figures = |row: &Rule| (row.k, row.n, row.in_time, row.slips.missed);
        assert_eq!(figures(&tuning.rows[RULES.len() - 1]), (16, 24, 0, 2), "{tuning}");
        assert_eq!(figures(tuning.best()), (1, 1, 2, 3));
    }

    #[test]
    fn an_alarm_while_most_of_the_contact_slides_is_not_false() {
        let quiet = vec![margins(Vec::new(), |_| -3_000); 60];
        let margin = |f: usize| match f {
            2_000..2_100 => 5_000,
            3_000..3_100 => 2_000,
            _ => -3_000,
        };
        let by_label = margins(vec![(3_000, 3_100)], margin);
        let chosen = |slips: &Margins| {
            let tuning = tune(&quiet, std::slice::from_ref(slips), 0.5).unwrap();
            (tuning.best().threshold_q10, tuning.best().slips.missed)
        };
        assert_eq!(chosen(&by_label), (5_000, 1));
        let interface = Interface {
            slip: vec![(3_000, 3_100)],
            mostly_sliding: vec![(2_000, 2_100)],
            of_label: vec![Some(0)],
            slid_mm: vec![0.0; by_label.margin.len()],
        };
        let truth = Truth { interface: Some(interface), ..by_label.truth };
        assert_eq!(chosen(&Margins::new(truth, by_label.margin, true)), (-3_000, 0));
    }

    #[test]
    fn nothing_to_tune_on_is_an_error() {
        let quiet = [margins(Vec::new(), |_| 0)];
        assert!(tune(&[], &quiet, 1.0).unwrap_err().to_string().contains("disturbances"));
        assert!(tune(&quiet, &quiet, 1.0).unwrap_err().to_string().contains("no slip"));
    }
}
