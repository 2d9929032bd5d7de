//! `slipsense tune`: what it writes, and what a user can get wrong.

mod support;

use std::fs;

use serde_json::Value;
use slipsense::net::Model;
use slipsense::net::format::OperatingPoint;
use slipsense_recording::model_file::ModelFile;
use support::{Place, fails, model, succeeds};

#[test]
fn the_same_network_with_another_point() {
    let place = Place::new();
    let (from, to) = (place.file("m.slipnet", model().to_bytes().unwrap()), place.path("t.slipnet"));
    let small = ["--hours", "0.03", "--episodes", "4", "--alarms-per-hour", "60"];
    let args = |out: &std::path::Path| -> Vec<std::ffi::OsString> {
        let mut args = vec!["tune".into(), from.clone().into(), "--out".into(), out.into()];
        args.extend(small.iter().map(Into::into));
        args
    };
    let text = succeeds(args(&to));
    for words in ["k of n", "chosen", "8 of 12", "synthetic", "h of disturbances without slip"] {
        assert!(text.contains(words), "{words}: {text}");
    }
    let tuned = fs::read(&to).unwrap();
    let mut file = ModelFile::from_bytes(&tuned).unwrap();
    assert_ne!(file.point, OperatingPoint::ARGMAX);
    let provenance: Value = serde_json::from_str(&file.provenance).unwrap();
    assert_eq!(provenance["random"], true, "what the model said of itself is kept");
    let chosen = &provenance["operating_point"];
    assert_eq!((&chosen["episodes"], &chosen["target_alarms_per_hour"]), (&4.into(), &60.0.into()));
    assert!(chosen["alarms"].as_f64().unwrap() <= 60.0 * chosen["hours"].as_f64().unwrap());
    (file.point, file.provenance) = (OperatingPoint::ARGMAX, model().provenance);
    assert_eq!(file, model(), "the tensors are as they were");

    // Again, onto itself, as JSON: the same point.
    let mut again = args(&to);
    again[1] = to.clone().into();
    again.push("--json".into());
    let json: Value = serde_json::from_str(&succeeds(again)).unwrap();
    let best = &json["rows"][json["chosen"].as_u64().unwrap() as usize];
    let point = Model::parse(&tuned).unwrap().point;
    assert_eq!(best["threshold_q10"], point.threshold.to_bits());
    assert_eq!((&best["k"], &best["n"]), (&point.k.into(), &point.n.into()));
    assert_eq!(fs::read(&to).unwrap(), tuned, "the same bytes");
}

#[test]
fn what_a_user_can_get_wrong() {
    let place = Place::new();
    let (from, out) = (place.file("m.slipnet", model().to_bytes().unwrap()), place.path("t.slipnet"));
    let error = |more: &[&str]| {
        let mut args: Vec<std::ffi::OsString> =
            vec!["tune".into(), from.clone().into(), "--out".into(), out.clone().into()];
        args.extend(more.iter().map(Into::into));
        fails(args)
    };
    assert_eq!(error(&["--hours", "0"]), "--hours is 0, must be 1/60 to 100");
    assert_eq!(error(&["--alarms-per-hour", "-1"]), "--alarms-per-hour is -1, must be 0 or more");
    let missing = place.path("none.slipnet");
    let error = fails(["tune".into(), missing, "--out".into(), out.clone()]);
    assert!(error.contains("none.slipnet: cannot read the model"), "{error}");
    let broken = place.file("b.slipnet", "SLIPNET\0");
    let error = fails(["tune".into(), broken, "--out".into(), out]);
    assert!(error.contains("b.slipnet") && error.contains("file ends inside header"), "{error}");
    assert_eq!(place.names(), ["b.slipnet", "m.slipnet"]);
}
