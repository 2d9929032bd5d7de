//! Hand-made episodes with known answers.

use std::ops::Range;

use serde_json::{Value, json};
use slipsense::params::{TAXELS, XL_RATE_HZ};
use slipsense::sensor::PiezoFrame;
use slipsense_bench::detectors::{Detector, NEVER, Verdict};
use slipsense_bench::disturbance::CLASSES;
use slipsense_bench::metrics::bootstrap::Intervals;
use slipsense_bench::metrics::cdf::Cdf;
use slipsense_bench::metrics::operating::{curve, figures_at, non_slip_scores, threshold_for};
use slipsense_bench::metrics::pairs::Pair;
use slipsense_bench::metrics::record::{Figures, Record};
use slipsense_bench::paper::Comparison;
use slipsense_bench::results::{NULL_REASONS, Results};
use slipsense_bench::run::{Entrant, Run, run};
use slipsense_bench::source::Input;
use slipsense_bench::truth::Truth;
use slipsense_episode::score::Detection;
use slipsense_episode::{Episode, Meta};

/// Frames per hour.
const HOUR: f64 = 240.0 * 3600.0;

/// An episode of one sensor with contact throughout that slips in the given frames by the label.
fn episode(frames: usize, slip: &[Range<usize>]) -> Episode {
    let mut counts = [0; TAXELS];
    counts[500] = 2000;
    let mut label = vec![1; frames];
    for range in slip {
        label[range.clone()].fill(2);
    }
    let per_frame = XL_RATE_HZ as usize / 240;
    Episode {
        sensors: 1,
        piezo: vec![PiezoFrame::from_scan(counts); frames],
        xl: vec![vec![Default::default(); frames * per_frame]],
        xl_end: (1..=frames).map(|f| (f * per_frame) as u32).collect(),
        label: Some(label),
        slip_true_mm_s: None,
        slip_fraction: None,
        displacement_mm: None,
        meta: Meta::nominal(0.000488),
    }
}

/// The same with sliding of the interface at this speed in other frames.
fn sliding(mut episode: Episode, slides: &[Range<usize>], mm_s: f32) -> Episode {
    let mut speed = vec![0.0; episode.frames()];
    let mut fraction = vec![0.2; episode.frames()];
    for range in slides {
        speed[range.clone()].fill(mm_s);
        fraction[range.clone()].fill(1.0);
    }
    (episode.slip_true_mm_s, episode.slip_fraction) = (Some(speed), Some(fraction));
    episode
}

fn with(mut episode: Episode, key: &str, value: Value) -> Episode {
    episode.meta.other.insert(key.to_owned(), value);
    episode
}

fn truth(episode: &Episode) -> Truth {
    Truth::new(episode, "input", "episode").unwrap()
}

/// Class 2 in the given frames, else 1.
fn class(frames: usize, flags: &[Range<usize>]) -> Vec<u8> {
    let mut class = vec![1; frames];
    for range in flags {
        class[range.clone()].fill(2);
    }
    class
}

#[expect(clippy::single_range_in_vec_init, reason = "a list of intervals may have one")]
mod events {
    use super::*;

    #[test]
    fn hits_early_ones_late_ones_and_misses_by_hand() {
        // Five events of 100 frames, 300 apart: hit at 0, hit at 4, early by 3, late (a miss), missed.
        let slips: Vec<_> = (0..5).map(|i| 300 * i + 100..300 * i + 200).collect();
        let truth = truth(&episode(1600, &slips));
        let flags = [100..110, 404..410, 697..720, 1100..1105];
        let record = Record::new(&truth, &class(1600, &flags));
        let detections: Vec<_> = record.events.encoder.iter().map(|o| o.event.detection).collect();
        assert_eq!(
            detections,
            [
                Detection::Hit { delay: 0 },
                Detection::Hit { delay: 4 },
                Detection::Early { lead: 3 },
                Detection::Missed,
                Detection::Missed
            ]
        );
        let figures = Figures::new([&record]);
        let events = &figures.encoder_events;
        assert_eq!((events.events, events.hits, events.early, events.missed), (5, 2, 1, 2));
        // Hits and misses: 0, 4, infinite, infinite.
        assert_eq!(events.latency_median_frames, None);
        assert_eq!(events.within_5_frames_share, Some(0.5));
        assert_eq!((events.miss_share, events.early_share), (Some(0.4), Some(0.2)));
        assert_eq!(
            (events.latency_max_of_hits_frames, events.latency_mean_of_hits_frames),
            (Some(4.0), Some(2.0))
        );
        assert_eq!((events.latency_p90_frames, events.latency_p95_frames), (None, None));
        // From the onset on: 0, 4, 0 (the flag stays up), infinite, infinite.
        assert_eq!(events.from_onset_median_frames, Some(4.0));
        assert_eq!(events.at_onset_share, Some(0.4));
        assert_eq!(events.at_onset_with_transition_share, Some(0.2));
        // The flag at 1100 is within 50 ms after the end: no hit and no alarm.
        assert_eq!(figures.alarms.all.alarms, 0);
        let cdf = Cdf::new(&record.events.encoder);
        assert_eq!((cdf.latency_at_most_frames, cdf.events_share), (vec![0, 4], vec![0.25, 0.5]));
    }

    #[test]
    fn the_distribution_starts_at_zero() {
        let truth = truth(&episode(1000, &[100..200, 400..500, 700..800]));
        let record = Record::new(&truth, &class(1000, &[103..200, 403..500, 707..800]));
        let cdf = Cdf::new(&record.events.encoder);
        assert_eq!(cdf.latency_at_most_frames, [0, 3, 7]);
        assert_eq!(cdf.events_share, [0.0, 2.0 / 3.0, 1.0]);
        let figures = Figures::new([&record]).encoder_events;
        assert_eq!((figures.latency_median_frames, figures.latency_p76_frames), (Some(3.0), Some(7.0)));
    }

    #[test]
    fn both_truths_by_hand() {
        // Labelled from 100, slides from 112; labelled from 500, never slides.
        let episode = sliding(episode(800, &[100..200, 500..600]), &[112..190], 24.0);
        let truth = truth(&episode);
        let interface = truth.interface.as_ref().unwrap();
        assert_eq!((&interface.slip[..], &interface.of_label[..]), (&[(112, 190)][..], &[Some(0), None][..]));
        let record = Record::new(&truth, &class(800, &[115..210, 520..530]));
        let figures = Figures::new([&record]);
        assert_eq!(figures.encoder_events.latency_median_frames, Some((15.0 + 20.0) / 2.0));
        assert_eq!(figures.interface_events.latency_median_frames, Some(3.0));
        assert_eq!((figures.interface_events.events, figures.labelled_without_interface_slip), (1, 1));
        // Three frames at 24 mm/s.
        let slid = figures.interface_events.travel_median_mm.unwrap();
        println!("slid {slid:.6} mm against 0.3 mm");
        assert!((slid - 0.3).abs() < 1e-6);
        // The sliding ends at 190, so the flag up to 210 outlasts its margin, and that at 520 is alone.
        assert_eq!(figures.alarms.all.alarms, 0);
        assert_eq!(figures.alarms.against_interface.unwrap().alarms, 2);
    }

    #[test]
    fn a_flag_before_the_sliding_is_early_against_the_interface() {
        let truth = truth(&sliding(episode(400, &[100..200]), &[110..200], 5.0));
        let record = Record::new(&truth, &class(400, &[101..200]));
        assert_eq!(record.events.encoder[0].event.detection, Detection::Hit { delay: 1 });
        assert_eq!(record.events.interface[0].event.detection, Detection::Early { lead: 9 });
    }

    #[test]
    fn sliding_is_closed_sustained_and_near_its_label() {
        // A gap of 11 frames is closed, one of 12 is not; 11 frames alone are not sustained.
        let slides = [100..130, 141..150, 162..180, 300..311];
        let truth = truth(&sliding(episode(1000, &[161..220, 260..330, 900..950]), &slides, 1.0));
        let interface = truth.interface.unwrap();
        assert_eq!(interface.slip, [(100, 150), (162, 180)]);
        // 100 is more than 60 frames before 161 and so is 162 before 260.
        assert_eq!(interface.of_label, [Some(1), None, None]);
    }

    #[test]
    fn the_crossheads_travel_by_hand() {
        let mut episode = episode(400, &[100..200]);
        episode.displacement_mm = Some((0..400).map(|f| 0.02 * f as f32).collect());
        let record = Record::new(&truth(&episode), &class(400, &[105..120]));
        let figures = Figures::new([&record]).encoder_events;
        assert!((figures.travel_median_mm.unwrap() - 0.1).abs() < 1e-6);
        assert!((figures.travel_max_of_hits_mm.unwrap() - 0.1).abs() < 1e-6);
        // A miss is infinitely far.
        let missed = Record::new(&truth(&episode), &class(400, &[]));
        let both = Figures::new([&record, &missed]).encoder_events;
        assert_eq!((both.travel_median_mm, both.travel_p90_mm), (None, None));
        assert!(both.travel_max_of_hits_mm.is_some());
    }
}

#[expect(clippy::single_range_in_vec_init, reason = "a list of intervals may have one")]
mod alarms {
    use super::*;

    fn of(figures: &Figures, name: &str) -> (u64, f64) {
        let class = figures.alarms.by_disturbance.iter().find(|class| class.disturbance == name).unwrap();
        (class.rate.alarms, class.rate.exposure_hours * HOUR)
    }

    #[test]
    fn alarms_are_merged_and_put_down_to_what_went_on() {
        let events = json!([
            {"name": "tap", "start_s": 1.0, "end_s": 1.0},
            {"name": "motion", "start_s": 0.5, "end_s": 2.0},
        ]);
        let truth = truth(&with(episode(1440, &[1000..1100]), "events", events));
        // Two runs 47 frames apart at the tap; one in the motion; one where nothing goes on; slip.
        let flags = [250..253, 300..310, 400..401, 700..702, 1000..1100];
        let figures = Figures::new([&Record::new(&truth, &class(1440, &flags))]);
        assert_eq!(figures.alarms.all.alarms, 3);
        // 240 to 276: the tap and 150 ms. Motion from 120 to 516, less the tap.
        assert_eq!(of(&figures, "tap"), (1, 37.0));
        assert_eq!(of(&figures, "motion"), (1, 397.0 - 37.0));
        // 1440 frames, less 124 of slip and its margins.
        let (alarms, frames) = of(&figures, "none");
        assert_eq!(alarms, 1);
        assert!((frames - (1440.0 - 397.0 - 124.0)).abs() < 1e-6, "{frames}");
        let exposure: f64 = figures.alarms.by_disturbance.iter().map(|c| c.rate.exposure_hours).sum();
        assert!((exposure - figures.alarms.all.exposure_hours).abs() < 1e-12);
        let per_hour = figures.alarms.all.alarms_per_hour.unwrap();
        assert!((per_hour - 3.0 * HOUR / (1440.0 - 124.0)).abs() < 1e-6);
        assert!(figures.alarms.all.upper_bound_per_hour.unwrap() > per_hour);
    }

    #[test]
    fn an_alarm_belongs_to_its_start() {
        let events = json!([{"name": "lift", "start_s": 1.0, "end_s": 1.1}]);
        let truth = truth(&with(episode(960, &[]), "events", events));
        let figures = Figures::new([&Record::new(&truth, &class(960, &[200..280, 600..601]))]);
        assert_eq!((of(&figures, "lift").0, of(&figures, "none").0), (0, 2));
    }

    #[test]
    fn alarms_of_true_sliding_are_told_apart() {
        let truth = truth(&sliding(episode(960, &[]), &[300..400], 3.0));
        let figures = Figures::new([&Record::new(&truth, &class(960, &[310..320, 700..710]))]);
        assert_eq!((figures.alarms.all.alarms, figures.alarms.of_these_truly_sliding), (2, Some(1)));
        assert_eq!(figures.alarms.against_interface.unwrap().alarms, 1);
    }

    #[test]
    fn nothing_is_known_of_the_interface_where_one_episode_does_not_say() {
        let knows = truth(&sliding(episode(960, &[]), &[300..400], 3.0));
        let not = truth(&episode(960, &[]));
        let quiet = class(960, &[]);
        let figures = Figures::new([&Record::new(&knows, &quiet), &Record::new(&not, &quiet)]);
        assert_eq!((figures.alarms.of_these_truly_sliding, figures.alarms.against_interface), (None, None));
    }

    #[test]
    fn every_class_has_a_place() {
        for (i, name) in CLASSES.iter().enumerate() {
            assert_eq!(CLASSES.iter().position(|other| other == name), Some(i));
        }
    }
}

#[expect(clippy::single_range_in_vec_init, reason = "a list of intervals may have one")]
mod frames {
    use super::*;

    #[test]
    fn contact_only_and_guard_band_by_hand() {
        let mut episode = episode(100, &[40..60]);
        episode.label.as_mut().unwrap()[..20].fill(0);
        // No contact right but for 5 frames of slip; slip from 41 to 61.
        let mut class = class(100, &[10..15, 41..61]);
        for f in (0..20).filter(|f| !(10..15).contains(f)) {
            class[f] = 0;
        }
        let frame = Figures::new([&Record::new(&truth(&episode), &class)]).frame;
        assert_eq!(frame.confusion_frames, [[15, 0, 5], [0, 59, 1], [0, 1, 19]]);
        assert_eq!(frame.accuracy_share, Some(0.93));
        assert_eq!(frame.fpr_of_non_slip_share, Some(6.0 / 80.0));
        assert_eq!(frame.fpr_of_all_share, Some(6.0 / 100.0));
        let contact = &frame.contact_only_slip;
        assert_eq!((contact.precision_share, contact.recall_share), (Some(0.95), Some(0.95)));
        // 38 to 42 and 58 to 62 are left out, and with them both errors at the boundaries.
        assert_eq!(frame.guard_band.frames, 92);
        assert_eq!(frame.guard_band.accuracy_share, Some(87.0 / 92.0));
        assert_eq!(frame.guard_band.fpr_of_non_slip_share, Some(5.0 / 76.0));
    }
}

mod operating {
    use super::*;

    /// Scores 0 to 999 without slip, then 100 frames of slip with scores 900 and up.
    fn judged() -> (Truth, Verdict) {
        let truth = truth(&episode(1100, std::slice::from_ref(&(1000..1100))));
        let score: Vec<f32> = (0..1000).chain(900..1000).map(|s| s as f32).collect();
        (truth, Verdict::new(score, 500.0, vec![1; 1100]))
    }

    #[test]
    fn the_threshold_meets_the_rate_from_below() {
        let (truth, verdict) = judged();
        let scores = non_slip_scores(&[(&truth, &verdict)]);
        assert_eq!((scores.len(), scores[0]), (1000, 999.0));
        assert_eq!(threshold_for(&scores, 0.015), Some(984.0));
        let fpr = |threshold| figures_at(&[(&truth, &verdict)], threshold).frame.fpr_of_non_slip_share;
        assert_eq!(fpr(984.0), Some(0.015));
        assert_eq!(fpr(984.0_f32.next_down()), Some(0.016));
        // Equal scores stand or fall together.
        assert_eq!(threshold_for(&[7.0, 5.0, 5.0, 5.0, 1.0], 0.5), Some(5.0));
        assert_eq!(threshold_for(&[7.0, 5.0], 1.0), Some(5.0));
        assert_eq!(threshold_for(&[], 0.1), None);
    }

    #[test]
    fn the_curve_by_hand() {
        let (truth, verdict) = judged();
        let curve = curve(&[(&truth, &verdict)], 500.0, Some(984.0));
        assert!(curve.len() > 20 && curve.is_sorted_by(|a, b| a.threshold_score < b.threshold_score));
        assert!(curve.is_sorted_by(|a, b| a.fpr_of_non_slip_share >= b.fpr_of_non_slip_share));
        let own = curve.iter().find(|point| point.is_detectors_own).unwrap();
        assert_eq!((own.threshold_score, own.fpr_of_non_slip_share), (500.0, Some(0.499)));
        // The alarm runs into the event: the frames before the onset are early.
        assert_eq!((own.early_share, own.latency_median_frames), (Some(1.0), None));
        let fixed = curve.iter().find(|point| point.is_operating_point).unwrap();
        assert_eq!((fixed.threshold_score, fixed.is_detectors_own), (984.0, false));
        // Above all scores without slip nothing is left but a miss.
        let last = curve.last().unwrap();
        assert_eq!(
            (last.threshold_score, last.miss_share, last.alarms_per_hour),
            (999.0, Some(1.0), Some(0.0))
        );
    }

    #[test]
    fn a_gate_stays_shut_at_any_threshold() {
        let (truth, verdict) = judged();
        let shut = Verdict::new(vec![NEVER; 1100], 0.0, vec![0; 1100]);
        for point in curve(&[(&truth, &shut)], 0.0, None) {
            assert_eq!((point.fpr_of_non_slip_share, point.miss_share), (Some(0.0), Some(1.0)));
        }
        assert_eq!(verdict.class[501], 2);
    }
}

#[expect(clippy::single_range_in_vec_init, reason = "a list of intervals may have one")]
mod intervals {
    use super::*;

    fn records() -> Vec<Record> {
        // Latencies 0 to 19, an alarm in every second episode.
        (0..20)
            .map(|i| {
                let alarm = if i % 2 == 0 { 700..710 } else { 0..0 };
                Record::new(&truth(&episode(1000, &[100..200])), &class(1000, &[100 + i..200, alarm]))
            })
            .collect()
    }

    #[test]
    fn the_bootstrap_is_the_same_every_time_and_holds_the_value() {
        let records = records();
        let all: Vec<&Record> = records.iter().collect();
        let intervals = Intervals::new(&all);
        assert_eq!(intervals, Intervals::new(&all));
        let figures = Figures::new(all.iter().copied());
        let holds = |interval: Option<[f64; 2]>, value: Option<f64>| {
            let ([low, high], value) = (interval.unwrap(), value.unwrap());
            println!("{value:.4} in {low:.4} to {high:.4}");
            assert!(low < value && value < high);
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
        let quiet = Record::new(&truth(&episode(1000, &[100..200])), &class(1000, &[]));
        let mut records = records();
        records.truncate(12);
        let all: Vec<&Record> = records.iter().chain(std::iter::repeat_n(&quiet, 8)).collect();
        let [low, high] = Intervals::new(&all).latency_median_frames.unwrap();
        assert!(low.is_some() && high.is_none(), "{low:?} {high:?}");
        assert_eq!(Intervals::new(&all[..4]), Intervals::default());
    }
}

#[test]
fn pairs_by_hand() {
    let truth = truth(&episode(1000, std::slice::from_ref(&(100..200))));
    let verdict = |from: usize| {
        let score = (0..1000).map(|f| if (from..200).contains(&f) { 1.0 } else { 0.0 }).collect();
        Verdict::new(score, 0.5, vec![1; 1000])
    };
    let (a, b) = (verdict(102), verdict(107));
    let figures = |v: &Verdict| Figures::new([&Record::new(&truth, &v.class)]);
    let pair = Pair::new(("a", &figures(&a)), ("b", &figures(&b)), [(&a, &b)]);
    assert_eq!((pair.different_class_frames, pair.same_class_share), (5, Some(0.995)));
    assert_eq!((pair.latency_median_difference_frames, pair.alarms_difference), (Some(-5.0), 0));
    assert!(pair.macro_f1_difference.unwrap() > 0.0);
}

#[test]
fn the_papers_rows_are_found_and_compared() {
    let mut figures = Figures::default();
    figures.frame.accuracy_share = Some(0.70);
    figures.frame.macro_f1 = Some(0.75);
    figures.frame.fpr_of_non_slip_share = Some(0.25);
    let row = Comparison::find("entropy", "umi_id", &figures).unwrap();
    assert!(row.within_6_points);
    assert!((row.accuracy_difference_points.unwrap() - (70.0 - 72.87)).abs() < 1e-9);
    figures.frame.macro_f1 = Some(0.65);
    assert!(!Comparison::find("entropy", "umi_id", &figures).unwrap().within_6_points);
    assert_eq!(Comparison::find("entropy", "palm", &figures), None);
}

/// Says slip from the n-th frame of its stream on, for 50 frames: shows whether state is carried.
struct Counter {
    seen: usize,
}

impl Detector for Counter {
    fn name(&self) -> &'static str {
        "counter"
    }

    fn judge(&mut self, episode: &Episode) -> anyhow::Result<Verdict> {
        let score = (0..episode.frames()).map(|f| (self.seen + f) as f32).collect();
        self.seen += episode.frames();
        Ok(Verdict::new(score, 1e9, vec![1; episode.frames()]))
    }

    fn reset(&mut self) {
        self.seen = 0;
    }
}

/// A folder of 20 labelled episodes of 300 frames.
fn folder() -> tempfile::TempDir {
    let place = tempfile::tempdir().unwrap();
    for i in 0..20 {
        let slip = if i % 4 == 3 { 0..0 } else { 100..200 };
        let meta = [("synthetic", json!(true)), ("speed_mm_s", json!([2, 10][i % 2])), ("grip_n", json!(i))];
        let episode =
            meta.into_iter().fold(episode(300, std::slice::from_ref(&slip)), |e, (k, v)| with(e, k, v));
        episode.write(place.path().join(format!("e{i:02}.npz"))).unwrap();
    }
    place
}

fn counters(inputs: &[Input]) -> Run {
    let entrant = || Entrant {
        name: "counter".to_owned(),
        family: "counter".to_owned(),
        make: Box::new(|| Ok(Box::new(Counter { seen: 0 }))),
    };
    run(inputs, &[entrant()], &|| ()).unwrap()
}

#[test]
fn state_is_carried_in_streams_that_do_not_depend_on_the_threads() {
    let place = folder();
    let inputs = [Input::folder("val", place.path()).unwrap()];
    let judge = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| counters(&inputs))
    };
    let (one, three) = (judge(1), judge(3));
    assert_eq!(one.verdicts, three.verdicts);
    assert_eq!(one.truths, three.truths);
    assert!(one.truths.is_sorted_by(|a, b| a.facts.name < b.facts.name));
    // 20 episodes in 8 streams: 2 or 3 each.
    let starts: Vec<usize> = one.verdicts[0].iter().map(|v| v.score[0] as usize / 300).collect();
    assert_eq!(starts, [0, 1, 0, 1, 2, 0, 1, 0, 1, 2, 0, 1, 0, 1, 2, 0, 1, 0, 1, 2]);
}

#[test]
fn results_say_what_is_missing_and_why() {
    let place = folder();
    let entrant = || Entrant {
        name: "counter".to_owned(),
        family: "counter".to_owned(),
        make: Box::new(|| Ok(Box::new(Counter { seen: 0 }))),
    };
    let mut inputs = vec![Input::folder("test", place.path()).unwrap()];
    let run = counters(&inputs);
    let without = Results::new(&inputs, &[entrant()], &run, &[]);
    assert!(without.synthetic && without.detectors[0].operating_point.is_none());
    assert!(without.detectors[0].operating_point_missing_because.is_some());
    let by_speed = &without.detectors[0].groupings.iter().find(|g| g.by == "speed").unwrap().groups;
    assert_eq!(by_speed.iter().map(|g| g.value.as_str()).collect::<Vec<_>>(), ["2 mm/s", "10 mm/s"]);

    // Every null of a number has its reason; counters say no slip at all.
    let mut nulls = Vec::new();
    collect_nulls(&serde_json::to_value(&without).unwrap(), "", &mut nulls);
    assert!(nulls.iter().any(|key| key == "latency_median_frames"));
    for key in nulls {
        let known = NULL_REASONS.iter().any(|(start, _)| key.starts_with(start));
        assert!(known, "{key}");
    }

    let html = slipsense_bench::report::html(&without, &run).unwrap();
    assert!(html.contains("synthetic") && html.contains("<svg") && !html.contains("NaN"), "a whole report");
    // Nothing is loaded: the only address is the name of SVG.
    assert_eq!(html.matches("://").count(), html.matches("http://www.w3.org/2000/svg").count());
    assert!(without.to_string().contains("synthetic data"));

    inputs.push(Input::folder("val", place.path()).unwrap());
    let with_val = Results::new(&inputs, &[entrant()], &counters(&inputs), &[]);
    let point = with_val.detectors[0].operating_point.as_ref().unwrap();
    let fpr = point.inputs[1].figures.frame.fpr_of_non_slip_share.unwrap();
    println!("FPR on val {fpr:.4} against a target of 0.015");
    assert!(fpr <= 0.015 && fpr > 0.0);
    // Validation is not tested on.
    assert_eq!(with_val.detectors[0].all.episodes, 20);
}

fn collect_nulls(value: &Value, key: &str, nulls: &mut Vec<String>) {
    match value {
        Value::Null => nulls.push(key.to_owned()),
        Value::Array(values) => values.iter().for_each(|value| collect_nulls(value, key, nulls)),
        Value::Object(map) => map.iter().for_each(|(key, value)| collect_nulls(value, key, nulls)),
        _ => {}
    }
}

#[test]
fn an_episode_without_labels_is_named() {
    let place = folder();
    let mut nameless = episode(300, &[]);
    nameless.label = None;
    nameless.write(place.path().join("e05.npz")).unwrap();
    let inputs = [Input::folder("mine", place.path()).unwrap()];
    let entrant = Entrant {
        name: "counter".to_owned(),
        family: "counter".to_owned(),
        make: Box::new(|| Ok(Box::new(Counter { seen: 0 }))),
    };
    let error = run(&inputs, &[entrant], &|| ()).unwrap_err().to_string();
    assert!(error.contains("mine/e05") && error.contains("label"), "{error}");
}
