//! The network frame by frame on tract against the training network, which takes all frames at once.

use burn::tensor::Device;
use slipsense::net::SensorFeatures;
use slipsense_model::float::{FloatNetwork, Sequences};
use slipsense_model::tract::{Graphs, TractNetwork};

use crate::common;

/// More than two windows, so that frames leave the band and the caches.
const FRAMES: usize = 140;
const TOLERANCE: f32 = 1e-4;

#[test]
fn a_batch_under_the_banded_mask_equals_the_stream() {
    let weights = common::random_weights(7);
    for sensors in [1, 3] {
        let scans = common::scans(FRAMES, sensors, 8);
        let xl_frames = common::xl_frames(FRAMES, sensors, 9);
        let mut input = Sequences { batch: 1, sensors, frames: FRAMES, ..Default::default() };
        common::add_sequence(&mut input, &scans, &xl_frames);
        let batched = FloatNetwork::new(&weights, &Device::flex()).outputs(&weights.dims, &input);
        assert_eq!(batched.len(), FRAMES);

        let mut stream = TractNetwork::new(&Graphs::new(&weights).unwrap(), sensors).unwrap();
        let seen =
            scans.iter().zip(xl_frames).map(|(scan, xl)| SensorFeatures { piezo: Some(scan), xl: Some(xl) });
        let seen: Vec<_> = seen.collect();
        let mut worst = 0f32;
        for (frame, (seen, batched)) in seen.chunks_exact(sensors).zip(&batched).enumerate() {
            for (logit, batched) in stream.step(seen).unwrap().iter().zip(batched) {
                assert!(logit.is_finite() && batched.is_finite(), "frame {frame}: {logit} {batched}");
                worst = worst.max((logit - batched).abs());
            }
        }
        println!("{sensors} sensors: worst difference {worst:.2e}");
        assert!(worst < TOLERANCE, "{sensors} sensors: worst difference {worst}");
    }
}

#[test]
fn a_single_changed_weight_shows() {
    let weights = common::random_weights(20);
    let mut changed = weights.clone();
    changed.tensors[0][0] += 1.0;
    let (scans, xl_frames) = (common::scans(1, 1, 21), common::xl_frames(1, 1, 22));
    let seen = [SensorFeatures { piezo: Some(&scans[0]), xl: Some(xl_frames[0]) }];
    let logits = |weights| TractNetwork::new(&Graphs::new(weights).unwrap(), 1).unwrap().step(&seen).unwrap();
    let pairs = logits(&weights).into_iter().zip(logits(&changed));
    assert!(pairs.into_iter().any(|(a, b)| (a - b).abs() > 10.0 * TOLERANCE));
}

#[test]
fn another_number_of_sensors_is_refused() {
    let weights = common::random_weights(20);
    let mut network = TractNetwork::new(&Graphs::new(&weights).unwrap(), 2).unwrap();
    let error = network.step(&[SensorFeatures::default()]).unwrap_err().to_string();
    assert_eq!(error, "1 sensors given, 2 expected");
}
