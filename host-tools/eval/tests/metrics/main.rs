//! Hand-made episodes with known answers.

#![expect(clippy::single_range_in_vec_init, reason = "a list of intervals may have one")]

mod events;
mod alarms;
mod frames;
mod operating;
mod intervals;
mod goals;

use std::ops::Range;

use serde_json::{Value, json};
use slipsense::params::{TAXELS, XL_RATE_HZ};
use slipsense::sensor::PiezoFrame;
use slipsense_eval::detectors::{Detector, NEVER, Verdict};
use slipsense_eval::disturbance::CLASSES;
use slipsense_eval::metrics::bootstrap::Intervals;
use slipsense_eval::metrics::cdf::Cdf;
use slipsense_eval::metrics::operating::{curve, figures_at, non_slip_scores, threshold_for};
use slipsense_eval::metrics::pairs::Pair;
use slipsense_eval::metrics::record::{Figures, Record};
use slipsense_eval::paper::Comparison;
use slipsense_eval::results::{NULL_REASONS, Results};
use slipsense_eval::run::{Entrant, Run, run};
use slipsense_eval::source::Input;
use slipsense_eval::truth::Truth;
use slipsense_recording::score::Detection;
use slipsense_recording::{Episode, Meta};

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

    let html = slipsense_eval::report::html(&without, &run).unwrap();
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
