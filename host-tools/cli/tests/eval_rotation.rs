//! `slipsense eval-rotation`: what it prints, and what a user can get wrong.

mod support;

use std::fs;

use serde_json::Value;
use support::{Arrays, Place, fails, model, succeeds};

#[test]
fn what_it_prints() {
    let place = Place::new();
    fs::create_dir(place.path("episodes")).unwrap();
    for i in 0..3 {
        Arrays::valid().write(&place.path("episodes").join(format!("e{i}.npz")));
    }
    let (input, model) = (place.path("episodes"), place.file("m.slipnet", model().to_bytes().unwrap()));
    let (input, model) = (input.to_str().unwrap(), model.to_str().unwrap());
    let base = ["eval-rotation", input, "--model", model, "--rotations", "3", "--episodes", "2"];
    let text = succeeds(base);
    assert!(text.contains("random rotations") && text.contains("target: at least 99.50 %"), "{text}");
    let json: Value = serde_json::from_str(&succeeds([&base[..], &["--json"]].concat())).unwrap();
    assert_eq!(json["schema"], "slipsense-rotation/1");
    assert_eq!((&json["episodes"], &json["frames"]), (&2.into(), &80.into()));
    assert_eq!((&json["touched_frames"], &json["synthetic"]), (&40.into(), &false.into()));
    let kinds = json["kinds"].as_array().unwrap();
    let turns: Vec<usize> = kinds.iter().map(|kind| kind["turns"].as_array().unwrap().len()).collect();
    assert_eq!(turns, [3, 5, 7]);
    // Axes are summed as powers, whatever the model: exchanged ones change no bit.
    assert_eq!((&kinds[1]["kind"], &kinds[1]["agree_share_min"]), (&"permutation".into(), &1.0.into()));

    // The same seed gives the same, another another.
    let again: Value = serde_json::from_str(&succeeds([&base[..], &["--json"]].concat())).unwrap();
    assert_eq!(again, json);
}

#[test]
fn what_a_user_can_get_wrong() {
    let place = Place::new();
    let error = fails(["eval-rotation", "nowhere"]);
    assert!(error.contains("nowhere: no such folder, and no split"), "{error}");
    let error = fails(["eval-rotation", "--model", "none.slipnet"]);
    assert!(error.contains("none.slipnet: cannot read"), "{error}");
    let bad = place.file("bad.slipnet", "no model");
    let error = fails(["eval-rotation", "--model", bad.to_str().unwrap()]);
    assert!(error.contains("bad.slipnet"), "{error}");
    let error = support::slipsense(["eval-rotation", "--rotations", "0"]);
    assert_eq!(error.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&error.stderr).contains("--rotations"));
}
