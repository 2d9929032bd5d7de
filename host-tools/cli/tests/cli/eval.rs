//! `slipsense eval`: what it writes, and what a user can get wrong.

use std::fs;

use serde_json::Value;
use slipsense_eval::detectors::DETECTORS;

use crate::support::{Place, assert_says, episode, names, unlabelled_episode};

/// A folder `episodes` of three labelled episodes of 40 frames; the last 10 slip.
fn place() -> Place {
    let place = Place::new();
    fs::create_dir(place.path("episodes")).unwrap();
    for i in 0..3 {
        episode().write(place.path(&format!("episodes/e{i}.npz"))).unwrap();
    }
    place
}

fn metrics(place: &Place) -> Value {
    serde_json::from_slice(&fs::read(place.path("out/metrics.json")).unwrap()).unwrap()
}

#[test]
fn two_detectors_by_hand() {
    let place = place();
    let detectors = "--detector oracle-label --detector majority";
    let text = place.run(&format!("eval @episodes --out @out {detectors}"));
    assert!(text.contains("oracle-label") && text.contains("majority") && text.contains("100.00"), "{text}");
    assert_eq!(names(&place.path("out")), ["metrics.json", "report.html"]);
    let metrics = metrics(&place);
    assert_eq!(metrics["schema"], "slipsense-eval/1");
    let input = &metrics["inputs"][0];
    assert_eq!((&input["frames"], &input["labelled_events"]), (&120.into(), &3.into()));
    let (oracle, majority) = (&metrics["detectors"][0]["all"], &metrics["detectors"][1]["all"]);
    let frame = &oracle["frame"];
    assert_eq!((&frame["accuracy_share"], &frame["macro_f1"]), (&1.0.into(), &1.0.into()));
    assert_eq!(oracle["encoder_events"]["latency_median_frames"], 0.0);
    assert_eq!(oracle["alarms"]["all"]["alarms"], 0);
    let events = &majority["encoder_events"];
    assert_eq!((&events["missed"], &events["hits"]), (&3.into(), &0.into()));
    assert_eq!(events["latency_median_frames"], Value::Null);

    // The same as JSON, of a split looked up by name, but for the time it took.
    let again = place.json(&format!("eval episodes --out @again --data @ {detectors}"));
    assert_eq!(again["detectors"][0]["all"], metrics["detectors"][0]["all"]);
    assert_eq!(again["inputs"], metrics["inputs"]);
}

#[test]
fn parts_give_the_figures_of_the_whole() {
    let place = place();
    let what = "eval @episodes umi_id --frames umi_id=3000 --detector network --detector entropy --detector majority";
    let mut whole = place.json(&format!("{what} --out @whole"));
    for part in ["2/3", "3/3", "2/3"] {
        let text = place.run(&format!("{what} --out @out --shard {part}"));
        assert_eq!(text, format!("part {part} evaluated, others missing\n"));
    }
    // A part of another evaluation does not count, whatever its name says.
    place.run("eval @episodes --out @out --shard 1/3");
    let parts = place.path("out/parts");
    assert_eq!(names(&parts), ["part-1-of-3.bin", "part-2-of-3.bin", "part-3-of-3.bin"]);
    // A process that was killed while it wrote.
    place.file("out/parts/.slipsense-x.partial", "");
    let mut parts = place.json(&format!("{what} --out @out --shard 1/3"));
    assert_eq!(names(&place.path("out")), ["metrics.json", "report.html"]);
    for all in [&mut whole, &mut parts] {
        all["wall_s"] = Value::Null;
        for detector in all["detectors"].as_array_mut().unwrap() {
            assert!(detector["compute_us_per_frame"].take().is_number());
        }
    }
    assert!(whole == parts, "the figures differ");
}

#[test]
fn half_a_sensor_beside_the_whole() {
    let place = place();
    let text = place.run("eval @episodes --out @out --drop piezo --drop xl");
    assert!(text.contains("network-without-piezo") && text.contains("network-without-xl"), "{text}");
    let metrics = metrics(&place);
    let names: Vec<_> = metrics["detectors"].as_array().unwrap().iter().map(|d| &d["name"]).collect();
    assert_eq!(names, ["network", "network-without-piezo", "network-without-xl"]);
}

#[test]
fn the_help_names_every_detector() {
    let help = Place::new().run("eval --help");
    for (name, _) in DETECTORS {
        assert!(help.split_whitespace().any(|word| word == name), "{name}");
    }
}

#[test]
fn what_a_user_can_get_wrong() {
    let place = place();
    place.file("file", "mine");
    for folder in ["empty", "noslip", "unlabelled", "bad"] {
        fs::create_dir(place.path(folder)).unwrap();
    }
    episode().write(place.path("noslip/e.npz")).unwrap();
    unlabelled_episode().write(place.path("unlabelled/e1.npz")).unwrap();
    place.file("bad/e1.npz", "no");
    let majority = "--out @out --detector majority";
    let cases = [
        ("eval @none", "@none: no such folder"),
        ("eval umi_id --data /nowhere", "/nowhere: no such folder, looked for umi_id"),
        ("eval train", "train: no set of this split is frozen"),
        ("eval @empty", "empty: holds no .npz file"),
        ("eval @episodes @episodes", "two inputs are called episodes"),
        ("eval @episodes --model m1 --weights w1 --weights w2", "--weights: 2 files, but 1 models"),
        ("eval @episodes --drop sound", "piezo, xl"),
        ("eval @episodes --detector network --drop xl --drop xl", "--drop: xl given twice"),
        ("eval @episodes --drop xl", "--drop: only network"),
        ("eval @episodes --frames 9000", "episodes is a folder"),
        ("eval @episodes --frames noslip=9000", "--frames: noslip is not among the inputs"),
        ("eval @episodes noslip --frames noslip=9000 --frames noslip=1", "--frames: given twice for noslip"),
        ("eval noslip --data @ --frames 9000", "noslip is a folder"),
        ("eval @unlabelled", "unlabelled/e1 … array `label` is missing"),
        ("eval @bad", "e1.npz"),
    ];
    place.errors(cases.map(|(line, rule)| (format!("{line} {majority}"), rule)));
    place.errors([
        ("eval @episodes --out @file --detector majority", "@file: "),
        ("eval nowhere --out @out", "nowhere: no such folder, and no split"),
    ]);
    let error = place.error("eval @episodes --out @out --detector crystal-ball");
    let named = DETECTORS.iter().all(|(name, _)| error.contains(name));
    assert!(error.contains("crystal-ball") && named, "{error}");
}

#[test]
fn a_split_of_any_length_and_what_caused_its_alarms() {
    let place = place();
    let text = place.run(
        "eval @episodes noslip --out @out --frames noslip=20000 --detector majority --detector always-slip",
    );
    assert_says(
        &text,
        &["false alarms without slip (noslip, synthetic data)", "cause", "tap", "other inputs"],
    );
    let metrics = metrics(&place);
    let noslip = &metrics["inputs"][1];
    assert_eq!((&noslip["episodes"], &noslip["frames"]), (&2.into(), &28_800.into()), "two minutes");
    let all = |detector: usize| {
        let alarms = &metrics["detectors"][detector]["inputs"][1]["figures"]["alarms"];
        let classes = alarms["by_disturbance"].as_array().unwrap().iter();
        let sum: u64 = classes.map(|class| class["alarms"].as_u64().unwrap()).sum();
        assert_eq!(alarms["all"]["alarms"], sum);
        sum
    };
    assert!(all(0) == 0 && all(1) > 1);
    // What is missed stands beside the alarms: all three slips by one, none by the other.
    for (detector, missed) in [("majority", "100.00"), ("always-slip", "0.00")] {
        let of = |line: &&str| line.trim_start().starts_with(detector) && line.contains(" all ");
        let row = text.lines().find(of).unwrap();
        assert_eq!(row.split_whitespace().last(), Some(missed), "{row}");
    }
}
