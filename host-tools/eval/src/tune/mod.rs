//! The operating point of a model: threshold and k-of-n, chosen on validation data only.
//!
//! Two inputs: disturbances without slip, which give the false alarms per hour, and the validation split,
//! which gives what is missed and how late the rest is found. Both are of validation objects on the
//! hand-held gripper; the test splits, their objects and their seeds are never used. For every rule of
//! [`RULES`] the threshold is the lowest that keeps to the rate of false alarms; of the rules that one is
//! chosen that misses least, then the one whose median latency is least, then the one that remembers least.
//!
//! Events, false alarms and exposure are the benchmark's ([`crate::metrics`]).

mod kth_largest;
mod threshold;

pub use kth_largest::KthLargest;

use std::fmt;
use std::ops::Range;

use anyhow::{Result, ensure};
use rayon::prelude::*;
use serde::Serialize;
use slipsense::fixed::Logit;
use slipsense::net::Model;
use slipsense::net::format::OperatingPoint;
use slipsense_synth::Split;
use slipsense_synth::splits::{EpisodeSet, FROZEN_SEED, tuning_disturbances};

use crate::detectors::PipelineStream;
use crate::metrics::alarms::{AlarmCounts, AlarmFigures};
use crate::metrics::events::{EventFigures, Outcome, Outcomes};
use crate::source::Input;
use crate::table::{finished, latency, number, percent, table};
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

/// Disturbances without slip, generated while they are judged; each episode is a minute.
pub fn disturbances(hours: f64) -> Input {
    Input::recipes("disturbances", tuning_disturbances((hours * 60.0).ceil() as usize))
}

/// The first episodes of the validation split.
pub fn slips(episodes: usize) -> Input {
    let set = EpisodeSet::first(Split::Val, FROZEN_SEED, episodes);
    Input::recipes(Split::Val.name(), set.episodes.into_iter().map(|e| (e.name, e.recipe)).collect())
}

/// One episode as the network saw it.
#[derive(Clone, Debug)]
pub struct Heard {
    /// What happened.
    pub truth: Truth,
    /// [`Output::margin`](slipsense::pipeline::Output::margin) of each frame.
    pub margin_q10: Vec<Option<i32>>,
    /// The pipeline was new: nothing of the episodes before is remembered.
    pub starts_anew: bool,
}

/// Run the pipeline over all episodes of an input, cut into streams as an evaluation is, in parallel.
/// `done` is called after each episode.
pub fn hear(input: &Input, model: Model<'_>, done: &(dyn Fn() + Sync)) -> Result<Vec<Heard>> {
    let stream = |episodes: Range<usize>| -> Result<Vec<Heard>> {
        let mut pipeline = PipelineStream::new(model);
        let hear = |handle: &crate::source::Handle| {
            let episode = handle.load()?;
            let truth = Truth::new(&episode, &input.name, &handle.name())?;
            let mut margin_q10 = Vec::with_capacity(episode.frames());
            let goes_on =
                pipeline.run(&episode, |output| margin_q10.push(output.margin.map(Logit::to_bits)))?;
            done();
            Ok(Heard { truth, margin_q10, starts_anew: !goes_on })
        };
        input.episodes[episodes].iter().map(hear).collect()
    };
    let streams = input.streams().into_par_iter().map(stream).collect::<Result<Vec<_>>>()?;
    Ok(streams.into_iter().flatten().collect())
}

/// What one rule reaches at its threshold.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// The threshold, 1/1024 nat.
    pub threshold_q10: i32,
    /// Frames that must be over.
    pub k: u8,
    /// Frames looked back over.
    pub n: u8,
    /// False alarms in the disturbances.
    pub disturbances: AlarmFigures,
    /// Events of the validation split against the encoder truth.
    pub slips: EventFigures,
}

impl Row {
    /// The point to write into a model file.
    pub fn point(&self) -> OperatingPoint {
        OperatingPoint { threshold: Logit::from_bits(self.threshold_q10), k: self.k, n: self.n }
    }
}

/// All rules and which one is chosen.
#[derive(Clone, Debug, Serialize)]
pub struct Tuning {
    /// False alarms per hour that were allowed.
    pub target_alarms_per_hour: f64,
    /// In the order of [`RULES`].
    pub rows: Vec<Row>,
    /// Position in `rows`.
    pub chosen: usize,
}

/// Try every rule. `disturbances` must hold exposure, `slips` a labelled slip.
pub fn tune(disturbances: &[Heard], slips: &[Heard], target_alarms_per_hour: f64) -> Result<Tuning> {
    let mut exposure = AlarmCounts::zero();
    for heard in disturbances {
        exposure.add(&AlarmCounts::new(&heard.truth, &vec![0; heard.truth.frames()]));
    }
    // A product that should be whole may fall just short of it.
    let allowed = (target_alarms_per_hour * exposure.hours() + 1e-9) as u64;
    ensure!(exposure.hours() > 0.0, "the disturbances hold no frame in which an alarm would be false");
    ensure!(slips.iter().any(|heard| !heard.truth.slip.is_empty()), "the slip episodes hold no slip");
    let rows: Vec<Row> = RULES
        .into_par_iter()
        .map(|(k, n)| {
            let scored = scores(disturbances, k, n);
            let threshold_q10 = threshold::lowest_threshold(&scored, allowed);
            let mut counts = AlarmCounts::zero();
            for (truth, scores) in &scored {
                counts.add(&AlarmCounts::new(truth, &flags(scores, threshold_q10)));
            }
            let mut outcomes: Vec<Outcome> = Vec::new();
            for (truth, scores) in scores(slips, k, n) {
                outcomes.extend(Outcomes::new(truth, &flags(&scores, threshold_q10)).encoder);
            }
            let slips = EventFigures::new(&outcomes.iter().collect::<Vec<_>>());
            Row { threshold_q10, k, n, disturbances: AlarmFigures::new(&counts), slips }
        })
        .collect();
    let rank =
        |row: &Row| (row.slips.missed, row.slips.latency_median_frames.unwrap_or(f64::INFINITY), row.n);
    let better = |a: &Row, b: &Row| {
        let (a, b) = (rank(a), rank(b));
        a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2))
    };
    let chosen = (0..rows.len()).min_by(|&a, &b| better(&rows[a], &rows[b])).unwrap_or_default();
    Ok(Tuning { target_alarms_per_hour, rows, chosen })
}

/// The k-th largest margins, frame by frame, remembered from episode to episode as the alarm does.
fn scores(episodes: &[Heard], k: u8, n: u8) -> Vec<(&Truth, Vec<Option<i32>>)> {
    let mut recent = KthLargest::new(k, n);
    let of_episode = |heard: &'_ Heard| {
        if heard.starts_anew {
            recent.clear();
        }
        heard.margin_q10.iter().map(|&margin| recent.push(margin)).collect()
    };
    let scores: Vec<Vec<Option<i32>>> = episodes.iter().map(of_episode).collect();
    episodes.iter().map(|heard| &heard.truth).zip(scores).collect()
}

fn flags(scores: &[Option<i32>], threshold_q10: i32) -> Vec<u8> {
    scores.iter().map(|score| score.is_some_and(|score| score > threshold_q10).into()).collect()
}

impl Tuning {
    /// The chosen row.
    pub fn best(&self) -> &Row {
        &self.rows[self.chosen]
    }
}

impl fmt::Display for Tuning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut shown = table(&[
            "k of n",
            "",
            "threshold nat",
            "alarms",
            "/h",
            "< /h",
            "missed %",
            "early %",
            "latency fr",
        ]);
        for (i, row) in self.rows.iter().enumerate() {
            let (alarms, slips) = (&row.disturbances.all, &row.slips);
            let nat = Logit::from_bits(row.threshold_q10).to_f64();
            shown.add_row([
                format!("{} of {}", row.k, row.n),
                if i == self.chosen { "chosen" } else { "" }.to_owned(),
                format!("{nat:.3}"),
                alarms.alarms.to_string(),
                number(alarms.alarms_per_hour, 2),
                number(alarms.upper_bound_per_hour, 2),
                percent(slips.miss_share),
                percent(slips.early_share),
                latency(slips.latency_median_frames, slips.hits + slips.missed),
            ]);
        }
        writeln!(f, "{}", finished(shown))?;
        let row = self.best();
        write!(
            f,
            "  synthetic validation data: {:.2} h of disturbances without slip, {} slips; < /h: 95 % bound, of \
             a threshold that was chosen on these data",
            row.disturbances.all.exposure_hours, row.slips.events
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `margin` by frame; slip where the label says.
    fn heard(slip: Vec<(usize, usize)>, margin: impl Fn(usize) -> i32) -> Heard {
        let frames = 240 * 60;
        let mut label = vec![1; frames];
        for &(start, end) in &slip {
            label[start..end].fill(2);
        }
        let truth = Truth { label, slip, disturbance: vec![0; frames], ..Truth::default() };
        Heard { truth, margin_q10: (0..frames).map(|f| Some(margin(f))).collect(), starts_anew: true }
    }

    /// Disturbances are loud for 2 frames, slip is less loud and lasts: only a rule that asks for more than
    /// 2 frames tells them apart, and of those the quickest is chosen.
    #[test]
    fn short_and_loud_is_told_from_long_and_less_loud() {
        let taps: Vec<Heard> =
            (0..60).map(|_| heard(Vec::new(), |f| if f % 500 < 2 { 5_000 } else { -3_000 })).collect();
        let slip = |f: usize| if (3_000..3_100).contains(&f) { 2_000 } else { -3_000 };
        let slips = [heard(vec![(3_000, 3_100)], slip)];
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

    #[test]
    fn nothing_to_tune_on_is_an_error() {
        let quiet = [heard(Vec::new(), |_| 0)];
        assert!(tune(&[], &quiet, 1.0).unwrap_err().to_string().contains("disturbances"));
        assert!(tune(&quiet, &quiet, 1.0).unwrap_err().to_string().contains("no slip"));
    }
}
