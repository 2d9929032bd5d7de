//! Percentile bootstrap over episodes: frames of one episode, and its events, are correlated, so whole
//! episodes are drawn with replacement. Each draw adds up the episodes' counts; no frame is touched.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use slipsense_recording::score::ClassScores;

use super::alarms::AlarmCounts;
use super::events::{WITHIN_FRAMES, latencies};
use super::figures::{EpisodeRecord, Figures};
use super::statistics::{CONFIDENCE, median_or_infinity, share};

const RESAMPLES: usize = 1000;
const SEED: u64 = 1;
/// With fewer episodes than this an interval would say little.
const EPISODES_MIN: usize = 5;

/// 95 % intervals, `[low, high]`; null where there are too few episodes or a bound is not finite.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Intervals {
    pub(crate) accuracy_share: Option<[f64; 2]>,
    pub(crate) macro_f1: Option<[f64; 2]>,
    pub(crate) fpr_of_non_slip_share: Option<[f64; 2]>,
    /// The upper bound is null where it is infinite.
    pub(crate) latency_median_frames: Option<[Option<f64>; 2]>,
    pub(crate) within_5_frames_share: Option<[f64; 2]>,
    pub(crate) miss_share: Option<[f64; 2]>,
    pub(crate) alarms_per_hour: Option<[f64; 2]>,
}

#[derive(Clone, Debug, Serialize)]
pub(crate) struct InputFigures {
    pub(crate) input: String,
    /// At the detector's own threshold.
    pub(crate) figures: Figures,
    pub(crate) intervals: Intervals,
}

impl Intervals {
    /// Intervals of the figures of these episodes. The same episodes give the same intervals.
    pub(crate) fn new(records: &[&EpisodeRecord]) -> Self {
        if records.len() < EPISODES_MIN {
            return Self::default();
        }
        let episodes: Vec<_> =
            records.iter().map(|record| (record, latencies(&record.events.encoder))).collect();
        let mut rng = ChaCha8Rng::seed_from_u64(SEED);
        let mut draws: [Vec<f64>; 7] = Default::default();
        let mut drawn = Vec::new();
        for _ in 0..RESAMPLES {
            let (mut classes, mut alarms, mut events) = (ClassScores::default(), AlarmCounts::default(), 0);
            drawn.clear();
            for _ in 0..episodes.len() {
                let (record, latencies) = &episodes[rng.random_range(0..episodes.len())];
                classes.add(&record.frames.all);
                alarms.add(&record.alarms);
                events += record.events.encoder.len();
                drawn.extend_from_slice(latencies);
            }
            drawn.sort_unstable_by(f64::total_cmp);
            let within = drawn.iter().filter(|&&frames| frames <= WITHIN_FRAMES as f64).count();
            let missed = drawn.iter().filter(|frames| frames.is_infinite()).count();
            let values = [
                classes.accuracy(),
                classes.macro_f1(),
                classes.fpr_of_non_slip(),
                median_or_infinity(&drawn),
                share(within, drawn.len()),
                share(missed, events),
                (alarms.hours() > 0.0).then(|| alarms.total() as f64 / alarms.hours()),
            ];
            // A draw without events has no latency; the others still count.
            for (draws, value) in draws.iter_mut().zip(values) {
                draws.extend(value);
            }
        }
        let [accuracy, f1, fpr, latency, within, miss, alarms] = draws.map(bounds);
        let finite = |[low, high]: [f64; 2]| (low.is_finite() && high.is_finite()).then_some([low, high]);
        Self {
            accuracy_share: accuracy.and_then(finite),
            macro_f1: f1.and_then(finite),
            fpr_of_non_slip_share: fpr.and_then(finite),
            latency_median_frames: latency.map(|of| of.map(|bound| bound.is_finite().then_some(bound))),
            within_5_frames_share: within.and_then(finite),
            miss_share: miss.and_then(finite),
            alarms_per_hour: alarms.and_then(finite),
        }
    }
}

fn bounds(mut values: Vec<f64>) -> Option<[f64; 2]> {
    values.sort_by(f64::total_cmp);
    let tail = (1.0 - CONFIDENCE) / 2.0;
    let last = values.len().checked_sub(1)?;
    Some([tail, 1.0 - tail].map(|p| values[(p * last as f64).round() as usize]))
}
