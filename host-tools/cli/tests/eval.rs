//! `slipsense eval`: what it writes, and what a user can get wrong.

mod support;

use std::ffi::OsString;
use std::fs;
use std::path::Path;

use serde_json::Value;
use slipsense_bench::detectors::DETECTORS;
use support::{Arrays, Place, fails, names, succeeds};

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
