//! `slipsense model`.

mod support;

use serde_json::Value;
use support::{Place, fails, model, succeeds};

fn info(place: &Place) -> Value {
    let path = place.file("m.slipnet", model().to_bytes().unwrap());
    let json = succeeds(["model", "info", "--json", path.to_str().unwrap()]);
    serde_json::from_str(&json).unwrap()
}

#[test]
fn info_counts_layers_and_totals() {
    let place = Place::new();
    let info = info(&place);
    let layers = info["layers"].as_array().unwrap();
    assert_eq!(layers.len(), 7 + 3 * 6 + 1);
    let sum = |key: &str| layers.iter().map(|layer| layer[key].as_u64().unwrap()).sum::<u64>();
    let total = |index: usize| info["totals"][index]["value"].as_u64().unwrap();
    assert_eq!((total(0), total(1)), (sum("macs_one_sensor"), sum("macs_three_sensors")));
    assert_eq!(total(2), std::fs::metadata(place.path("m.slipnet")).unwrap().len());
    assert!((40_000..=100_000).contains(&total(3)), "RAM of {} bytes", total(3));
    for layer in layers {
        let head_room = layer["head_room_bits"].as_f64().unwrap();
        assert!((0.0..31.0).contains(&head_room), "{layer}");
        // A random model has no scales.
        assert!(layer["unit"].is_null(), "{layer}");
    }
    assert_eq!(info["model"]["provenance"]["random"], true);
    assert_eq!(info["model"]["operating_point"]["k"], 1);
    let sizes: Vec<u64> =
        info["sizes"].as_array().unwrap().iter().map(|s| s["value"].as_u64().unwrap()).collect();
    assert_eq!(sizes, [2, 2, 2, 4, 2, 4, 2, 8]);
}

#[test]
fn info_reads_as_a_table() {
    let place = Place::new();
    let hash = info(&place)["model"]["hash"].as_str().unwrap().to_owned();
    let text = succeeds(["model", "info", place.path("m.slipnet").to_str().unwrap()]);
    for part in [hash.as_str(), "piezo.conv1", "2 × 18", "36,864", "head-room", "fits", "\"random\": true"] {
        assert!(text.contains(part), "{part} is missing in\n{text}");
    }
    assert!(!text.contains("TOO MUCH"), "{text}");
}

#[test]
fn a_file_that_is_no_model_is_refused_by_name() {
    let place = Place::new();
    let path = place.file("notes.txt", "not a model at all");
    let error = fails(["model", "info", path.to_str().unwrap()]);
    assert!(error.contains("notes.txt") && error.contains("not a SlipSense model file"), "{error}");
    let error = fails(["model", "info", place.path("none").to_str().unwrap()]);
    assert!(error.contains("none: cannot read the model"), "{error}");
}

#[cfg(not(feature = "train"))]
#[test]
fn comparing_says_which_build_can() {
    let error = fails(["model", "compare", "e.npz"]);
    assert!(error.contains("cargo run --release --features train -- model compare e.npz"), "{error}");
}

#[cfg(feature = "train")]
mod with_float_network {
    use std::path::PathBuf;

    use serde_json::{Value, json};
    use slipsense::params::MEL_BINS;
    use slipsense_model::quantize::{activation_scales, quantize};
    use slipsense_model::tract::{Graphs, SensorFrame, TractNetwork};
    use slipsense_model::weights::{FIRST_DIMS, Weights};
    use slipsense_model::{export, output};
    use slipsense_recording::model_file::{SCALES_KEY, random_model};

    use super::support::{Arrays, Place, fails, succeeds};

    /// Untrained weights, the model made from them, and an episode.
    fn files(place: &Place) -> [PathBuf; 3] {
        let weights = Weights::init(FIRST_DIMS, 7);
        let mut network = TractNetwork::new(&Graphs::traced(&weights).unwrap(), 1).unwrap();
        for frame in 0..40i16 {
            let scan = std::array::from_fn(|taxel| (taxel % 97 + frame as usize) as u16 * 9);
            let log_mel: [i16; MEL_BINS] =
                std::array::from_fn(|bin| (bin as i16 - 8) * 100 * (frame % 7 + 1));
            network.step(&[SensorFrame { piezo: Some(&scan), log_mel: Some(&log_mel) }]).unwrap();
        }
        let provenance = json!({
            "weights_sha256": output::sha256_hex(&weights.to_bytes().unwrap()),
            SCALES_KEY: activation_scales(&FIRST_DIMS, &network.ranges).unwrap(),
        });
        let file = quantize(&weights, &network.ranges, &provenance.to_string()).unwrap();
        let path = place.path("w.safetensors");
        weights.write(&path).unwrap();
        std::fs::create_dir(place.path("episodes")).unwrap();
        let episode = place.path("episodes/e.npz");
        Arrays::valid().write(&episode);
        [place.file("m.slipnet", export::to_bytes(&file).unwrap()), path, episode]
    }

    fn text(path: &std::path::Path) -> &str {
        path.to_str().unwrap()
    }

    #[test]
    fn compare_shows_every_activation() {
        let place = Place::new();
        let [model, weights, episode] = files(&place);
        let args = ["model", "compare", text(&episode), "--model", text(&model), "--weights", text(&weights)];
        let json = succeeds(args.into_iter().chain(["--json"]));
        let report: Value = serde_json::from_str(&json).unwrap();
        let activations = report["activations"].as_array().unwrap();
        assert_eq!(activations.len(), slipsense_model::trace::ACTIVATIONS.len());
        let logits = activations.iter().find(|a| a["activation"] == "logits").unwrap();
        assert!((15.0..90.0).contains(&logits["snr_db"].as_f64().unwrap()), "{logits}");
        assert_eq!((&report["frames"], &report["weights_are_the_models"]), (&json!(40), &json!(true)));

        let table = succeeds(args);
        for part in ["temporal.residual", "exact", "same class in", "logits"] {
            assert!(table.contains(part), "{part} is missing in\n{table}");
        }
        assert!(!table.contains("not the weights"), "{table}");

        // Units are known now.
        let info: Value = serde_json::from_str(&succeeds(["model", "info", text(&model), "--json"])).unwrap();
        let units = info["layers"].as_array().unwrap().iter().filter(|layer| layer["unit"].is_number());
        assert_eq!(units.count(), 7 + 3 * 5 + 1, "all but the scores");
    }

    #[test]
    fn compare_refuses_half_a_pair_and_a_model_without_scales() {
        let place = Place::new();
        let [model, weights, episode] = files(&place);
        let error = super::support::slipsense(["model", "compare", text(&episode), "--model", text(&model)]);
        assert_eq!(error.status.code(), Some(2));
        assert!(String::from_utf8_lossy(&error.stderr).contains("--weights"));
        let bare = place.file("bare.slipnet", random_model(FIRST_DIMS, 1).to_bytes().unwrap());
        let args = ["model", "compare", text(&episode), "--weights", text(&weights), "--model", text(&bare)];
        let error = fails(args);
        assert!(error.contains("bare.slipnet") && error.contains("has no scales"), "{error}");
        let small = place.file("small.slipnet", super::model().to_bytes().unwrap());
        let args = ["model", "compare", text(&episode), "--weights", text(&weights), "--model", text(&small)];
        assert!(fails(args).contains("not the same network"));
    }

    #[test]
    fn quantize_refuses_where_it_cannot_write_before_it_works() {
        let place = Place::new();
        let [model, weights, _] = files(&place);
        let nowhere = place.path("no/such/file");
        for (out, report) in [(&nowhere, &model), (&model, &nowhere)] {
            let args =
                ["quantize", "--weights", text(&weights), "--out", text(out), "--report", text(report)];
            let error = fails(args);
            assert!(error.contains("no/such: cannot write into this folder"), "{error}");
        }
    }

    #[test]
    fn eval_runs_the_float_network_beside_the_integer_one() {
        let place = Place::new();
        let [model, weights, _] = files(&place);
        let (episodes, out) = (place.path("episodes"), place.path("out"));
        let json = succeeds([
            "eval",
            text(&episodes),
            "--model",
            text(&model),
            "--detector",
            "network",
            "--detector",
            "float",
            "--weights",
            text(&weights),
            "--out",
            text(&out),
            "--json",
        ]);
        let results: Value = serde_json::from_str(&json).unwrap();
        assert_eq!(results["detectors"].as_array().unwrap().len(), 2);
        assert_eq!(results["pairs"].as_array().unwrap().len(), 1, "the two are compared");
        let error = fails(["eval", text(&episodes), "--detector", "float", "--out", text(&out)]);
        assert!(error.contains("float needs the float weights"), "{error}");
    }
}
