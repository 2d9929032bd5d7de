//! `slipsense tune`: what it writes.

use std::fs;

use slipsense::net::Model;
use slipsense::net::format::OperatingPoint;
use slipsense_recording::model_file::ModelFile;

use crate::support::{Place, assert_says, model, number};

#[test]
fn the_same_network_with_another_point() {
    let place = Place::with_files();
    let options = "--out @t.slipnet --curve @c.svg --hours 0.03 --episodes 4 --per-hour 60";
    let text = place.run(&format!("tune @m.slipnet {options}"));
    assert_says(&text, &["k of n", "chosen", "8 of 12", "curve", "synthetic", "h without slip"]);
    let curve = fs::read_to_string(place.path("c.svg")).unwrap();
    assert!(curve.starts_with("<svg") && curve.contains("false alarms per hour"));
    let tuned = fs::read(place.path("t.slipnet")).unwrap();
    let mut file = ModelFile::from_bytes(&tuned).unwrap();
    assert_ne!(file.point, OperatingPoint::EVEN);
    let provenance: serde_json::Value = serde_json::from_str(&file.provenance).unwrap();
    assert_eq!(provenance["random"], true, "the model's own provenance is kept");
    let chosen = &provenance["operating_point"];
    assert_eq!((&chosen["episodes"], &chosen["target_alarms_per_hour"]), (&4.into(), &60.0.into()));
    assert!(number(&chosen["alarms"]) <= 60.0 * number(&chosen["hours"]));
    (file.point, file.provenance) = (OperatingPoint::EVEN, model().provenance);
    assert_eq!(file, model(), "the tensors are as they were");

    // Again, onto itself, as JSON: the same point.
    let json = place.json(&format!("tune @t.slipnet {options}"));
    let best = &json["rows"][json["chosen"].as_u64().unwrap() as usize];
    let point = Model::parse(&tuned).unwrap().point;
    assert_eq!(best["threshold_q10"], point.threshold.to_bits());
    assert_eq!((&best["k"], &best["n"]), (&point.k.into(), &point.n.into()));
    assert_eq!(fs::read(place.path("t.slipnet")).unwrap(), tuned, "the same bytes");
}
