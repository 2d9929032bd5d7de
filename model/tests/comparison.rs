//! The comparison of float and integer, activation by activation, on random weights.

use slipsense::net::Model;
use slipsense::params::OUTPUTS;
use slipsense_model::compare::{compare_activations, scales};
use slipsense_model::export;
use slipsense_model::quantize::{activation_scales, quantize};
use slipsense_model::trace::ACTIVATIONS;
use slipsense_model::weights::{FIRST_DIMS, Weights};
use slipsense_recording::Episode;
use slipsense_recording::model_file::SCALES_KEY;
use slipsense_synth::{Recipe, ScenarioChoice, generate};

use crate::common;
use crate::quantization::run_float;

/// The beginning of an episode of two sensors, until they touch: an untouched pad has nothing to compare.
fn episode() -> Episode {
    const FRAMES: usize = 1_000;
    let recipe = Recipe { scenario: ScenarioChoice::SixStep, ..Recipe::new(5) };
    let mut episode = generate(&recipe).unwrap();
    episode.piezo.truncate(FRAMES * episode.sensors);
    episode.xl_end.truncate(FRAMES * episode.sensors);
    episode
}

fn quantized(weights: &Weights) -> Vec<u8> {
    let (_, ranges) = run_float(weights, 1, false);
    let provenance = serde_json::json!({ SCALES_KEY: activation_scales(&FIRST_DIMS, &ranges).unwrap() });
    export::to_bytes(&quantize(weights, &ranges, &provenance.to_string()).unwrap()).unwrap()
}

#[test]
fn every_activation_is_compared_at_its_own_scale() {
    let weights = common::random_weights(11);
    let bytes = quantized(&weights);
    let episode = episode();
    let comparison = compare_activations(Model::parse(&bytes).unwrap(), &weights, &episode).unwrap();
    let frames = episode.frames() as u64;
    let sensors = episode.sensors as u64;
    for activation in &comparison.activations {
        println!("{activation:?}");
        let name = activation.activation;
        let per_frame = match name {
            "taxels" => sensors * 2 * 1024,
            "piezo.conv1" => sensors * 16 * 16 * 4,
            "piezo.conv2" => sensors * 8 * 8 * 8,
            "piezo.conv3" => sensors * 4 * 4 * 32,
            "log_mel" => sensors * 5 * 32,
            "xl.conv" | "xl.mix1" => sensors * FIRST_DIMS.xl_channels as u64,
            "piezo" | "xl" => sensors * 32,
            "fused" | "hidden" => 64,
            "logits" => OUTPUTS as u64,
            other if other.starts_with("temporal") => 64,
            _ => 32,
        };
        assert_eq!(activation.values, frames * per_frame, "{name}");
        match name {
            // The inputs are integers to begin with.
            "taxels" | "log_mel" => assert_eq!((activation.snr_db, activation.worst_error), (None, 0.0)),
            // A wrong scale gives 0 dB or less, a comparison with itself no error at all.
            _ => assert!((15.0..90.0).contains(&activation.snr_db.unwrap()), "{activation:?}"),
        }
    }
    let names: Vec<_> = comparison.activations.iter().map(|a| a.activation).collect();
    assert_eq!(names, ACTIVATIONS);
    assert_eq!(comparison.agreed + comparison.differing_frames.len(), episode.frames());
    assert!(comparison.agreement().unwrap() > 0.9);
}

#[test]
fn a_damaged_layer_shows_there_and_not_before() {
    let weights = common::random_weights(12);
    let bytes = quantized(&weights);
    let mut damaged = weights.clone();
    common::tensor_mut(&mut damaged, "piezo.conv2", "weight").iter_mut().for_each(|w| *w = -*w);
    let model = Model::parse(&bytes).unwrap();
    let whole = compare_activations(model, &weights, &episode()).unwrap();
    let broken = compare_activations(model, &damaged, &episode()).unwrap();
    let snr = |of: &slipsense_model::compare::LayerComparison, name| of.activation(name).unwrap().snr_db;
    for untouched in ["piezo.conv1", "xl", "cross_xl.query"] {
        assert_eq!(snr(&whole, untouched), snr(&broken, untouched), "{untouched}");
    }
    assert!(snr(&broken, "piezo.conv2").unwrap() < 5.0);
}

#[test]
fn scales_that_are_not_there_are_named() {
    let weights = common::random_weights(13);
    let (_, ranges) = run_float(&weights, 1, false);
    let refusal = |provenance: &str| {
        let bytes = export::to_bytes(&quantize(&weights, &ranges, provenance).unwrap()).unwrap();
        format!("{:#}", scales(&Model::parse(&bytes).unwrap()).unwrap_err())
    };
    assert!(refusal("{}").starts_with("provenance has no scales"));
    assert_eq!(refusal("{\"scales\":{\"piezo\":1.0}}"), "provenance scales lacks taxels");
    let mut all = activation_scales(&FIRST_DIMS, &ranges).unwrap();
    all.insert("fused".into(), 0.0);
    let zero = serde_json::json!({ SCALES_KEY: all }).to_string();
    assert_eq!(refusal(&zero), "provenance scales fused is 0, must be positive");
}
