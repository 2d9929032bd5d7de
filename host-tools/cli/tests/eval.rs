//! `slipsense eval`: what it writes, and what a user can get wrong.

mod support;

use std::ffi::OsString;
use std::fs;
use std::path::Path;

use serde_json::Value;
use slipsense_eval::detectors::DETECTORS;
use support::{Arrays, Place, fails, names, slipsense, succeeds};

/// A folder `episodes` of three labelled episodes of 40 frames; the last 10 slip.
fn place() -> Place {
    let place = Place::new();
    fs::create_dir(place.path("episodes")).unwrap();
    for i in 0..3 {
        Arrays::valid().write(&place.path("episodes").join(format!("e{i}.npz")));
    }
    place
}

fn eval(input: &Path, out: &Path, more: &[&str]) -> Vec<OsString> {
    let mut args = vec!["eval".into(), input.into(), "--out".into(), out.into()];
    args.extend(more.iter().map(OsString::from));
    args
}

#[test]
fn two_detectors_by_hand() {
    let place = place();
    let (input, out) = (place.path("episodes"), place.path("deep/out"));
    let detectors = ["--detector", "oracle-label", "--detector", "majority"];
    let text = succeeds(eval(&input, &out, &detectors));
    assert!(text.contains("oracle-label") && text.contains("majority") && text.contains("100.00"), "{text}");
    assert_eq!(names(&out), ["metrics.json", "report.html"]);
    let metrics: Value = serde_json::from_slice(&fs::read(out.join("metrics.json")).unwrap()).unwrap();
    assert_eq!(metrics["schema"], "slipsense-eval/1");
    assert_eq!(
        (&metrics["inputs"][0]["frames"], &metrics["inputs"][0]["labelled_events"]),
        (&120.into(), &3.into())
    );
    let oracle = &metrics["detectors"][0]["all"];
    assert_eq!(
        (&oracle["frame"]["accuracy_share"], &oracle["frame"]["macro_f1"]),
        (&1.0.into(), &1.0.into())
    );
    assert_eq!(oracle["encoder_events"]["latency_median_frames"], 0.0);
    assert_eq!(oracle["alarms"]["all"]["alarms"], 0);
    let majority = &metrics["detectors"][1]["all"];
    assert_eq!(
        (&majority["encoder_events"]["missed"], &majority["encoder_events"]["hits"]),
        (&3.into(), &0.into())
    );
    assert_eq!(majority["encoder_events"]["latency_median_frames"], Value::Null);

    // The same as JSON, of a split looked up by name, but for the time it took.
    let data = place.path("").display().to_string();
    let args = [&["--data", &data, "--json"], &detectors[..]].concat();
    let json = succeeds(eval(Path::new("episodes"), &place.path("again"), &args));
    let again: Value = serde_json::from_str(&json).unwrap();
    assert_eq!(again["detectors"][0]["all"], metrics["detectors"][0]["all"]);
    assert_eq!(again["inputs"], metrics["inputs"]);
}

#[test]
fn half_a_sensor_beside_the_whole() {
    let place = place();
    let (input, out) = (place.path("episodes"), place.path("out"));
    let text = succeeds(eval(&input, &out, &["--drop", "piezo", "--drop", "xl"]));
    assert!(text.contains("network-without-piezo") && text.contains("network-without-xl"), "{text}");
    let metrics: Value = serde_json::from_slice(&fs::read(out.join("metrics.json")).unwrap()).unwrap();
    let names: Vec<_> = metrics["detectors"].as_array().unwrap().iter().map(|d| &d["name"]).collect();
    assert_eq!(names, ["network", "network-without-piezo", "network-without-xl"]);

    let again = place.path("again");
    // The command line's own error has a line on where help is.
    let refused = slipsense(eval(&input, &again, &["--drop", "ears"]));
    let error = String::from_utf8(refused.stderr).unwrap();
    assert_eq!(refused.status.code(), Some(2), "{error}");
    assert!(error.contains("ears") && error.contains("piezo, xl"), "{error}");
    let error = fails(eval(&input, &again, &["--drop", "xl", "--drop", "xl"]));
    assert!(error.contains("--drop: xl given twice"), "{error}");
    let error = fails(eval(&input, &again, &["--drop", "xl", "--detector", "majority"]));
    assert!(error.contains("--drop: only network"), "{error}");
}

#[test]
fn the_help_names_every_detector() {
    let help = succeeds(["eval", "--help"]);
    let words: Vec<&str> = help.split_whitespace().collect();
    for (name, _) in DETECTORS {
        assert!(words.contains(&name), "{name}");
    }
}

#[test]
fn what_a_user_can_get_wrong() {
    let place = place();
    let (input, out) = (place.path("episodes"), place.path("out"));
    let error = fails(eval(&input, &out, &["--detector", "crystal-ball"]));
    assert!(
        error.contains("crystal-ball") && DETECTORS.iter().all(|(name, _)| error.contains(name)),
        "{error}"
    );
    let error = fails(eval(&place.path("none"), &out, &[]));
    assert!(error.contains("none: no such folder"), "{error}");
    let error = fails(eval(Path::new("umi_id"), &out, &["--data", "/nowhere"]));
    assert!(error.contains("umi_id") && error.contains("/nowhere"), "{error}");
    let error = fails(eval(Path::new("train"), &out, &[]));
    assert!(error.contains("train: no set of this split is frozen"), "{error}");
    fs::create_dir(place.path("empty")).unwrap();
    let error = fails(eval(&place.path("empty"), &out, &[]));
    assert!(error.contains("empty: holds no .npz file"), "{error}");
    let error = fails(eval(&input, &out, &[&input.display().to_string()]));
    assert!(error.contains("two inputs are called episodes"), "{error}");
    let error = fails(eval(&input, &out, &["--model", "m1", "--weights", "w1", "--weights", "w2"]));
    assert!(error.contains("--weights: 2 files, but 1 models"), "{error}");
    let file = place.file("file", "mine");
    let error = fails(eval(&input, &file, &["--detector", "majority"]));
    assert!(error.starts_with(&file.display().to_string()), "{error}");
    assert_eq!(place.names(), ["empty", "episodes", "file"]);
}

#[test]
fn a_split_of_any_length_and_what_caused_its_alarms() {
    let place = place();
    let (input, out) = (place.path("episodes"), place.path("out"));
    let more = ["noslip", "--frames", "noslip=20000", "--detector", "majority", "--detector", "always-slip"];
    let text = succeeds(eval(&input, &out, &more));
    for words in ["false alarms without slip (noslip, synthetic data)", "cause", "tap", "other inputs"] {
        assert!(text.contains(words), "{words}: {text}");
    }
    let metrics: Value = serde_json::from_slice(&fs::read(out.join("metrics.json")).unwrap()).unwrap();
    let noslip = &metrics["inputs"][1];
    assert_eq!((&noslip["episodes"], &noslip["frames"]), (&2.into(), &28_800.into()), "two minutes");
    let all = |detector: usize| {
        let alarms = &metrics["detectors"][detector]["inputs"][1]["figures"]["alarms"];
        let sum: u64 = alarms["by_disturbance"]
            .as_array()
            .unwrap()
            .iter()
            .map(|class| class["alarms"].as_u64().unwrap())
            .sum();
        assert_eq!(alarms["all"]["alarms"], sum);
        sum
    };
    assert!(all(0) == 0 && all(1) > 1);
    // What is missed stands beside the alarms: all three slips by one, none by the other.
    let row = |detector: &str| -> Vec<String> {
        let of = |line: &&str| line.trim_start().starts_with(detector) && line.contains(" all ");
        text.lines().find(of).unwrap().split_whitespace().map(str::to_owned).collect()
    };
    assert_eq!(row("majority").last().unwrap(), "100.00");
    assert_eq!(row("always-slip").last().unwrap(), "0.00");
}

#[test]
fn frames_are_for_splits() {
    let place = place();
    let (input, out) = (place.path("episodes"), place.path("out"));
    let majority = ["--detector", "majority"];
    let error = |input: &Path, more: &[&str]| fails(eval(input, &out, &[more, &majority].concat()));
    let refused = error(&input, &["--frames", "9000"]);
    assert!(refused.starts_with("--frames: ") && refused.contains("episodes is a folder"), "{refused}");
    let refused = error(&input, &["--frames", "noslip=9000"]);
    assert_eq!(refused, "--frames: noslip is not among the inputs");
    let twice = ["noslip", "--frames", "noslip=9000", "--frames", "noslip=1"];
    assert_eq!(error(&input, &twice), "--frames: given twice for noslip");
    let data = place.path("").display().to_string();
    fs::rename(&input, place.path("noslip")).unwrap();
    let refused = error(Path::new("noslip"), &["--data", &data, "--frames", "9000"]);
    assert!(refused.contains("noslip is a folder"), "{refused}");
    assert_eq!(place.names(), ["noslip"]);
}

#[test]
fn a_bad_episode_is_named_and_leaves_nothing() {
    let place = place();
    let mut arrays = Arrays::valid();
    arrays.label.clear();
    arrays.write(&place.path("episodes").join("e1.npz"));
    let error = fails(eval(&place.path("episodes"), &place.path("out"), &["--detector", "majority"]));
    assert!(error.contains("episodes/e1") && error.contains("array `label` is missing"), "{error}");
    fs::write(place.path("episodes").join("e1.npz"), "no").unwrap();
    let error = fails(eval(&place.path("episodes"), &place.path("out"), &["--detector", "majority"]));
    assert!(error.contains("e1.npz"), "{error}");
    assert_eq!(place.names(), ["episodes"]);
}
