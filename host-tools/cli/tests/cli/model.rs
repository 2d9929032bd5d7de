//! `slipsense model`.

use crate::support::{Place, assert_says, number};

#[test]
fn info_counts_layers_and_totals() {
    let place = Place::with_files();
    let info = place.json("model info @m.slipnet");
    let layers = info["layers"].as_array().unwrap();
    assert_eq!(layers.len(), 7 + 3 * 6 + 1);
    let sum = |key: &str| layers.iter().map(|layer| layer[key].as_u64().unwrap()).sum::<u64>();
    let total = |index: usize| info["totals"][index]["value"].as_u64().unwrap();
    assert_eq!((total(0), total(1)), (sum("macs_one_sensor"), sum("macs_three_sensors")));
    assert_eq!(total(2), std::fs::metadata(place.path("m.slipnet")).unwrap().len());
    assert!((40_000..=100_000).contains(&total(3)), "RAM of {} bytes", total(3));
    for layer in layers {
        assert!((0.0..31.0).contains(&number(&layer["head_room_bits"])), "{layer}");
        // A random model has no scales.
        assert!(layer["unit"].is_null(), "{layer}");
    }
    assert_eq!(info["model"]["provenance"]["random"], true);
    assert_eq!(info["model"]["operating_point"]["k"], 1);
    let sizes: Vec<_> = info["sizes"].as_array().unwrap().iter().map(|size| &size["value"]).collect();
    assert_eq!(sizes, [2, 2, 2, 4, 2, 4, 2, 8]);

    let text = place.run("model info @m.slipnet");
    let hash = info["model"]["hash"].as_str().unwrap();
    let [first, second] = [0, 1].map(|at| info["model_expected"][at].as_u64().unwrap());
    assert_eq!(format!("{first:08x}{second:08x}"), hash[..16]);
    let expected = format!("slipsense.model.expected: {first}, {second}");
    let parts = [hash, &expected, "piezo.conv1", "2 × 18", "36,864", "head-room", "fits", "\"random\": true"];
    assert_says(&text, &parts);
    assert!(!text.contains("TOO MUCH"), "{text}");
}

#[cfg(feature = "train")]
mod with_float_network {
    use serde_json::json;
    use slipsense::net::SensorFeatures;
    use slipsense::params::XL_FEATURES;
    use slipsense::sensor::PiezoFrame;
    use slipsense_model::quantize::{activation_scales, quantize};
    use slipsense_model::trace::Ranges;
    use slipsense_model::tract::{Graphs, TractNetwork};
    use slipsense_model::weights::{FIRST_DIMS, Weights};
    use slipsense_model::{export, output};
    use slipsense_recording::model_file::{SCALES_KEY, random_model};

    use crate::support::{Place, assert_says, model_bytes, number};

    /// Untrained weights `w.safetensors`, the model `q.slipnet` made from them, and an episode.
    fn place() -> Place {
        let place = Place::with_files();
        let weights = Weights::init(FIRST_DIMS, 7);
        let mut network = TractNetwork::new(&Graphs::traced(&weights).unwrap(), 1).unwrap();
        for frame in 0..40i16 {
            let scan = std::array::from_fn(|taxel| (taxel % 97 + frame as usize) as u16 * 9);
            let scan = PiezoFrame::from_scan(scan);
            let xl: [i16; XL_FEATURES] = std::array::from_fn(|bin| (bin as i16 - 16) * 250 * (frame % 7 + 1));
            network.step(&[SensorFeatures { piezo: Some(&scan), xl: Some(xl) }]).unwrap();
        }
        let ranges = Ranges::of(&network.trace);
        let provenance = json!({
            "weights_sha256": output::sha256_hex(&weights.to_bytes().unwrap()),
            SCALES_KEY: activation_scales(&FIRST_DIMS, &ranges).unwrap(),
        });
        let file = quantize(&weights, &ranges, &provenance.to_string()).unwrap();
        weights.write(&place.path("w.safetensors")).unwrap();
        place.file("q.slipnet", export::to_bytes(&file).unwrap());
        place
    }

    #[test]
    fn compare_shows_every_activation() {
        let place = place();
        let command = "model compare @e.npz --model @q.slipnet --weights @w.safetensors";
        let report = place.json(command);
        let activations = report["activations"].as_array().unwrap();
        assert_eq!(activations.len(), slipsense_model::trace::ACTIVATIONS.len());
        let logits = activations.iter().find(|a| a["activation"] == "logits").unwrap();
        assert!((15.0..90.0).contains(&number(&logits["snr_db"])), "{logits}");
        assert_eq!((&report["frames"], &report["weights_are_the_models"]), (&json!(40), &json!(true)));

        let table = place.run(command);
        assert_says(&table, &["temporal.residual", "exact", "same class in", "logits"]);
        assert!(!table.contains("not the weights"), "{table}");

        // Units are known now.
        let info = place.json("model info @q.slipnet");
        let units = info["layers"].as_array().unwrap().iter().filter(|layer| layer["unit"].is_number());
        assert_eq!(units.count(), 7 + 3 * 5 + 1, "all but the scores");
    }

    #[test]
    fn what_a_user_can_get_wrong() {
        let place = place();
        place.file("bare.slipnet", random_model(FIRST_DIMS, 1).to_bytes().unwrap());
        place.file("small.slipnet", model_bytes());
        std::fs::create_dir(place.path("episodes")).unwrap();
        std::fs::copy(place.path("e.npz"), place.path("episodes/e.npz")).unwrap();
        let compare = "model compare @e.npz --weights @w.safetensors --model";
        let nowhere = "@no: cannot write into this folder";
        place.errors([
            ("model compare @e.npz --model @q.slipnet".to_owned(), "--weights"),
            (format!("{compare} @bare.slipnet"), "bare.slipnet"),
            (format!("{compare} @bare.slipnet"), "has no scales"),
            (format!("{compare} @small.slipnet"), "not the same network"),
            // Refused before it works for minutes.
            ("quantize --weights @w.safetensors --out @no/f --report @r".to_owned(), nowhere),
            ("quantize --weights @w.safetensors --out @q.slipnet --report @no/f".to_owned(), nowhere),
            ("eval @episodes --detector float --out @out".to_owned(), "float needs the float weights"),
        ]);
        let both = "--detector network --detector float --weights @w.safetensors";
        let results = place.json(&format!("eval @episodes --model @q.slipnet {both} --out @out"));
        assert_eq!(results["detectors"].as_array().unwrap().len(), 2);
        assert_eq!(results["integer_against_float"].as_array().unwrap().len(), 1, "the two are compared");
    }
}
