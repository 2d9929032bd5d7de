//! `slipsense grasp`: the loop, its files, its errors.

use serde_json::Value;

use crate::support::{Place, assert_says, names, number};

#[test]
fn the_gripper_reacts_after_inference_bus_and_actuator() {
    let place = Place::new();
    let command = "grasp --trials 4 --hand umi --objects val --seed 11";
    let found = place.json(command);
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
        let [first_n, last_n] = [0, 1].map(|i| number(&trial["grip_n"][i]));
        assert!(number(&trial["motions"]) >= 1.0 && last_n > first_n, "{trial}");
        // Motions follow each other; none is faster than message and actuator.
        assert!(peak_s * 1e3 >= message_s * 1e3 + actuator_ms - 1e-6, "{trial}");
        let slid_less = number(&trial["slid_mm"]) < number(&trial["slid_without_mm"]);
        assert!(trial["lost"].is_u64() || slid_less, "{trial}");
    }
    assert!(reacted > 0, "{found}");
    assert_eq!(found, place.json(command), "the same seed, the same trials");
    let slow = place.json(&format!("{command} --inference-us 3500 --foreign 100"));
    let before = number(&found["totals"]["message"]["median_ms"]);
    assert!(number(&slow["totals"]["message"]["median_ms"]) > before + 1.5, "{slow}");
}

#[test]
fn pictures_numbers_and_table() {
    let place = Place::new();
    let table = place.run("grasp --trials 2 --hand tesollo2 --flag slip --out @out");
    assert_says(
        &table,
        &["synthetic", "flag slip", "slips detected", "objects kept without any reaction", "by object"],
    );
    assert_eq!(names(&place.path("out")), ["grasp.json", "latency.svg", "trial.svg"]);
    let read = |name: &str| std::fs::read_to_string(place.path("out").join(name)).unwrap();
    for name in ["latency.svg", "trial.svg"] {
        let picture = read(name);
        assert!(picture.starts_with("<svg") && picture.contains("synthetic"), "{name}");
    }
    let numbers: Value = serde_json::from_str(&read("grasp.json")).unwrap();
    assert_eq!(numbers["reaction"]["flag"], "slip");
    assert_eq!(numbers["totals"]["trials"], 2);
}

#[test]
fn what_cannot_be_tried() {
    Place::new().errors([
        ("grasp --trials 2 --show 2 --out @out", "numbered from 0"),
        ("grasp --trials 0", "1..=1000"),
        ("grasp --gain 1", "above 1, at most 4"),
        ("grasp --settle-ms 501", "0 to 500"),
        ("grasp --inference-us 4001", "0..=4000"),
        ("grasp --hand claw", "must be umi, tesollo2 or tesollo3"),
        ("grasp --objects train", "must be unseen or val"),
        ("grasp --flag both", "may-begin, slip"),
        ("grasp --show 0", "--out"),
    ]);
}
