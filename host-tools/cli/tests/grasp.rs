//! `slipsense grasp` through the binary: the loop, its files, its errors.

mod support;

use serde_json::Value;
use support::{Place, fails, slipsense, succeeds};

fn json(args: &[&str]) -> Value {
    serde_json::from_str(&succeeds(["grasp", "--json"].iter().chain(args))).unwrap()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is a number"))
}

#[test]
fn the_gripper_reacts_after_inference_bus_and_actuator() {
    let args = ["--trials", "4", "--hand", "umi", "--objects", "val", "--seed", "11"];
    let found = json(&args);
    assert_eq!(found["synthetic"], true);
    let trials = found["trials"].as_array().unwrap();
    assert_eq!(trials.len(), 4);
    let inference_ms = number(&found["inference_us"]) / 1e3;
    let mut reacted = 0;
    for trial in trials {
        assert!(trial["lost_without"].is_u64(), "slips out of a grip that does not react: {trial}");
        let Some(message_s) = trial["message_s"].as_f64() else { continue };
        // A slip frame takes 0.1 to 0.14 ms; one frame of a raw message may be on the bus already.
        let bus_ms = message_s * 1e3 - inference_ms;
        assert!(bus_ms > 0.1 && bus_ms < 0.3, "{trial}");
        let Some(peak_s) = trial["peak_s"].as_f64() else { continue };
        reacted += 1;
        let actuator_ms = number(&trial["actuator_ms"]);
        assert!((20.0..=40.0).contains(&actuator_ms), "{trial}");
        let motions = number(&trial["motions"]);
        assert!(motions >= 1.0 && number(&trial["grip_n"][1]) > number(&trial["grip_n"][0]), "{trial}");
        // Motions follow each other; none is faster than message and actuator.
        assert!(peak_s * 1e3 >= message_s * 1e3 + actuator_ms - 1e-6, "{trial}");
        assert!(
            trial["lost"].is_u64() || number(&trial["slid_mm"]) < number(&trial["slid_without_mm"]),
            "{trial}"
        );
    }
    assert!(reacted > 0, "{found}");
    assert_eq!(found, json(&args), "the same seed, the same trials");
    let slow = json(&[&args[..], &["--inference-us", "3500", "--foreign", "100"]].concat());
    let before = number(&found["totals"]["message"]["median_ms"]);
    assert!(number(&slow["totals"]["message"]["median_ms"]) > before + 1.5, "{slow}");
}

#[test]
fn pictures_numbers_and_table() {
    let place = Place::new();
    let out = place.path("out").display().to_string();
    let table = succeeds(["grasp", "--trials", "2", "--hand", "tesollo2", "--flag", "alarm", "--out", &out]);
    for words in
        ["synthetic", "flag alarm", "slips detected", "objects kept without any reaction", "by object"]
    {
        assert!(table.contains(words), "{words}: {table}");
    }
    assert_eq!(support::names(&place.path("out")), ["grasp.json", "latency.svg", "trial.svg"]);
    for name in ["latency.svg", "trial.svg"] {
        let picture = std::fs::read_to_string(place.path("out").join(name)).unwrap();
        assert!(picture.starts_with("<svg") && picture.contains("synthetic"), "{name}");
    }
    let numbers = std::fs::read_to_string(place.path("out/grasp.json")).unwrap();
    let numbers: Value = serde_json::from_str(&numbers).unwrap();
    assert_eq!(numbers["reaction"]["flag"], "alarm");
    assert_eq!(numbers["totals"]["trials"], 2);
}

#[test]
fn what_cannot_be_tried() {
    let place = Place::new();
    let out = place.path("out").display().to_string();
    let error = |args: &[&str]| fails(["grasp"].iter().chain(args));
    assert!(error(&["--trials", "2", "--show", "2", "--out", &out]).contains("numbered from 0"));
    let missing = place.path("none.slipnet").display().to_string();
    assert!(error(&["--model", &missing]).contains("cannot read the model"));
    let file = place.file("file", "x").display().to_string();
    assert!(error(&["--trials", "1", "--out", &file]).contains("is a file"));
    for (args, rule) in [
        (["--trials", "0"], "1..=1000"),
        (["--gain", "1"], "above 1, at most 4"),
        (["--settle-ms", "501"], "0 to 500"),
        (["--inference-us", "4001"], "0..=4000"),
        (["--hand", "claw"], "must be umi, tesollo2 or tesollo3"),
        (["--objects", "train"], "must be unseen or val"),
        (["--flag", "both"], "class, alarm"),
        (["--show", "0"], "--out"),
    ] {
        let output = slipsense(["grasp"].iter().chain(&args));
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{args:?}");
        assert!(said.contains(rule), "{args:?}: {said}");
    }
    assert_eq!(place.names(), ["file"]);
}
