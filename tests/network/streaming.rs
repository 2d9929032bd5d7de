//! The streaming network against a batch oracle, bit for bit, and against what a file may contain.

use super::batch;
use super::inputs::{SHAPES, Sensor, random_frames};
use slipsense::fixed::Logit;
use slipsense::net::{Model, Network, SensorFeatures};
use slipsense::params::OUTPUTS;
use slipsense_recording::model_file::random_model;

fn stream(network: &mut Network<'_>, frame: &[Sensor]) -> [i32; OUTPUTS] {
    let seen: Vec<SensorFeatures> =
        frame.iter().map(|s| SensorFeatures { piezo: s.piezo.as_ref(), xl: s.xl }).collect();
    network.step(&seen).map(Logit::to_bits)
}

#[test]
fn streaming_equals_batch_in_the_shipped_the_smallest_an_odd_and_the_largest_shape() {
    for (shape, frames, sensors) in [(0, 1000, 2), (1, 50, 1), (2, 150, 3), (3, 100, 3)] {
        let file = random_model(SHAPES[shape], shape as u64);
        let bytes = file.to_bytes().unwrap();
        let mut network = Network::new(Model::parse(&bytes).unwrap());
        let frames = random_frames(frames, sensors, 100 + shape as u64);
        let batch = batch::outputs(&file, &frames);
        let mut distinct = std::collections::HashSet::new();
        for (t, frame) in frames.iter().enumerate() {
            let streamed = stream(&mut network, frame);
            assert_eq!(streamed, batch[t], "shape {shape}, frame {t}");
            distinct.insert(streamed);
        }
        assert!(distinct.len() > frames.len() / 2 || SHAPES[shape].embed == 1, "the oracle saw no signal");
    }
}
