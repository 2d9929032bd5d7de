//! The batched network under its banded mask against the same network run frame by frame.

mod common;

use burn::tensor::Device;
use slipsense::features::piezo::PiezoFrontEnd;
use slipsense_model::float::{FloatNetwork, Sequences};
use slipsense_model::reference::{Reference, SensorFrame, log_mel_real};

/// More than two windows, so that frames leave the band.
const FRAMES: usize = 140;

fn worst_difference(sensors: usize) -> f32 {
    let weights = common::random_weights(7);
    let scans = common::scans(FRAMES, sensors, 8);
    let log_mels = common::log_mels(FRAMES, sensors, 9);
    let mut input = Sequences { batch: 1, sensors, frames: FRAMES, ..Default::default() };
    for sensor in 0..sensors {
        let mut pad = PiezoFrontEnd::new();
        for frame in 0..FRAMES {
            let at = frame * sensors + sensor;
            let counts = scans[at].counts();
            pad.push(counts, |_, cell| input.piezo.extend(cell));
            input.log_mel.extend(log_mels[at].iter().map(|&q| log_mel_real(q)));
        }
    }

    let device = Device::flex();
    let network = FloatNetwork::fixed(&weights, &device);
    let batched = network.logits(&weights.dims, &input, &device);
    assert_eq!(batched.len(), FRAMES);

    let mut reference = Reference::new(&weights, sensors);
    let mut worst = 0f32;
    for (frame, batched) in batched.iter().enumerate() {
        let seen: Vec<SensorFrame<'_>> = (0..sensors)
            .map(|sensor| {
                let at = frame * sensors + sensor;
                SensorFrame { piezo: Some(scans[at].counts()), log_mel: Some(&log_mels[at]) }
            })
            .collect();
        let logits = reference.step(&seen);
        for (logit, batched) in logits.iter().zip(batched) {
            worst = worst.max((logit - batched).abs());
        }
    }
    worst
}

#[test]
fn a_batch_under_the_banded_mask_equals_the_stream() {
    for sensors in [1, 3] {
        let worst = worst_difference(sensors);
        println!("{sensors} sensors: worst difference {worst:.2e}");
        assert!(worst < 1e-4, "{sensors} sensors: worst difference {worst}");
    }
}
