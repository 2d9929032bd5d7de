//! Bootstrap intervals.

use super::*;
use crate::metrics::bootstrap::Intervals;

fn records() -> Vec<EpisodeRecord> {
    // Latencies 0 to 19, an alarm in every second episode.
    (0..20)
        .map(|i| {
            let alarm = if i % 2 == 0 { 700..710 } else { 0..0 };
            record(&episode(1000, &[100..200]), &[100 + i..200, alarm])
        })
        .collect()
}

#[test]
fn the_bootstrap_is_the_same_every_time_and_holds_the_value() {
    let records = records();
    let all: Vec<&EpisodeRecord> = records.iter().collect();
    let intervals = Intervals::new(&all);
    assert_eq!(intervals, Intervals::new(&all));
    let figures = Figures::new(all.iter().copied());
    let holds = |interval: Option<[f64; 2]>, value: Option<f64>| {
        let ([low, high], value) = (interval.unwrap(), value.unwrap());
        assert!(low < value && value < high, "{value:.4} in {low:.4} to {high:.4}");
    };
    holds(intervals.accuracy_share, figures.frame.accuracy_share);
    holds(intervals.macro_f1, figures.frame.macro_f1);
    holds(intervals.fpr_of_non_slip_share, figures.frame.fpr_of_non_slip_share);
    holds(intervals.within_5_frames_share, figures.encoder_events.within_5_frames_share);
    holds(intervals.alarms_per_hour, figures.alarms.all.alarms_per_hour);
    assert_eq!(intervals.miss_share, Some([0.0, 0.0]));
    // A binomial share of 6 of 20 has a standard error of 0.102.
    let [low, high] = intervals.within_5_frames_share.unwrap();
    assert!((high - low - 2.0 * 1.96 * 0.102).abs() < 0.06, "{low} to {high}");
}

#[test]
fn a_median_among_misses_has_no_upper_bound() {
    let quiet = record(&episode(1000, &[100..200]), &[]);
    let mut records = records();
    records.truncate(12);
    let all: Vec<&EpisodeRecord> = records.iter().chain(std::iter::repeat_n(&quiet, 8)).collect();
    let [low, high] = Intervals::new(&all).latency_median_frames.unwrap();
    assert!(low.is_some() && high.is_none(), "{low:?} {high:?}");
    assert_eq!(Intervals::new(&all[..4]), Intervals::default());
}
