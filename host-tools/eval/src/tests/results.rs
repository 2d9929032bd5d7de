//! From inputs to results: streams, operating point, what is missing and why, paper's rows.

use serde_json::json;
use slipsense_synth::objects::{Group, of_group};

use super::*;
use crate::paper::Comparison;
use crate::results::Results;
use crate::run::{Run, run};
use crate::source::Input;

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

/// Scores count the frames of the stream: shows whether state is carried. Slip is never predicted.
fn counter() -> Candidate<'static> {
    let make = || -> anyhow::Result<Detector<'static>> {
        let mut seen = 0;
        Ok(Box::new(move |episode| {
            let score = (seen..seen + episode.frames()).map(|frame| frame as f32).collect();
            seen += episode.frames();
            Ok(Prediction::new(score, 1e9, vec![1; episode.frames()]))
        }))
    };
    candidate("counter", "counter", make)
}

/// A folder of 20 labelled episodes of 300 frames.
fn folder() -> tempfile::TempDir {
    let place = tempfile::tempdir().unwrap();
    for i in 0..20 {
        let slip = if i % 4 == 3 { 0..0 } else { 100..200 };
        let object = of_group([Group::Val, Group::HeldOut][i % 2]).next().unwrap();
        let meta = [
            ("synthetic", json!(true)),
            ("speed_mm_s", json!([2, 10][i % 2])),
            ("grip_n", json!(i)),
            ("object", json!(object.name)),
        ];
        let episode = meta.into_iter().fold(episode(300, &[slip]), |e, (k, v)| with(e, k, v));
        episode.write(place.path().join(format!("e{i:02}.npz"))).unwrap();
    }
    place
}

fn run_counter(inputs: &[Input]) -> anyhow::Result<Run> {
    run(inputs, &[counter()], &|| ())
}

#[test]
fn state_is_carried_in_streams_that_do_not_depend_on_the_threads() {
    let place = folder();
    let inputs = [Input::folder("val", place.path()).unwrap()];
    let [one, three] = [1, 3].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| run_counter(&inputs)).unwrap()
    });
    assert_eq!(one.predictions, three.predictions);
    assert_eq!(one.truths, three.truths);
    assert!(one.truths.is_sorted_by(|a, b| a.info.name < b.info.name));
    // 20 episodes in 8 streams: 2 or 3 each.
    let starts: Vec<usize> = one.predictions[0].iter().map(|p| p.score[0] as usize / 300).collect();
    assert_eq!(starts, [0, 1, 0, 1, 2, 0, 1, 0, 1, 2, 0, 1, 0, 1, 2, 0, 1, 0, 1, 2]);
}

#[test]
fn results_say_what_is_missing_and_why() {
    let place = folder();
    let mut inputs = vec![Input::folder("test", place.path()).unwrap()];
    let run = run_counter(&inputs).unwrap();
    let without = Results::new(&inputs, &[counter()], &run, &[]);
    assert!(without.synthetic && without.detectors[0].operating_point.is_none());
    assert!(without.detectors[0].operating_point_missing_because.is_some());
    for (by, expected) in [("speed", ["2 mm/s", "10 mm/s"]), ("object_group", ["held out", "validation"])] {
        let groups = &without.detectors[0].groupings.iter().find(|g| g.by == by).unwrap().groups;
        assert_eq!(groups.iter().map(|g| g.value.as_str()).collect::<Vec<_>>(), expected);
    }
    assert!(check_nulls(&without).contains(&"latency_median_frames".to_owned()));

    let html = crate::report::html(&without, &run).unwrap();
    assert!(html.contains("synthetic") && html.contains("<svg") && !html.contains("NaN"), "a whole report");
    // Nothing is loaded: the only address is the name of SVG.
    assert_eq!(html.matches("://").count(), html.matches("http://www.w3.org/2000/svg").count());
    assert!(without.to_string().contains("synthetic data"));

    inputs.push(Input::folder("val", place.path()).unwrap());
    let with_val = Results::new(&inputs, &[counter()], &run_counter(&inputs).unwrap(), &[]);
    let point = with_val.detectors[0].operating_point.as_ref().unwrap();
    let fpr = point.inputs[1].figures.frame.fpr_of_non_slip_share.unwrap();
    assert!(fpr <= 0.015 && fpr > 0.0, "FPR on val {fpr:.4} against a target of 0.015");
    // Validation is not tested on.
    assert_eq!(with_val.detectors[0].all.episodes, 20);
}

#[test]
fn an_episode_without_labels_is_named() {
    let place = folder();
    let nameless = Episode { label: None, ..episode(300, &[]) };
    nameless.write(place.path().join("e05.npz")).unwrap();
    let error = run_counter(&[Input::folder("mine", place.path()).unwrap()]).unwrap_err().to_string();
    assert!(error.contains("mine/e05") && error.contains("label"), "{error}");
}
