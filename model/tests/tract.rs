//! tract's graphs against the network written out by hand.

mod common;

use slipsense_model::reference::{Reference, SensorFrame};
use slipsense_model::tract::{Graphs, TractNetwork};
use slipsense_model::weights::Weights;

/// More than two windows, so that frames leave the caches.
const FRAMES: usize = 150;
const TOLERANCE: f32 = 1e-4;

/// Largest difference of a logit over random frames. `missing`: leave parts of some frames out.
fn worst_difference(weights: &Weights, sensors: usize, missing: bool) -> f32 {
    let scans = common::scans(FRAMES, sensors, 21);
    let log_mels = common::log_mels(FRAMES, sensors, 22);
    let mut reference = Reference::new(weights, sensors);
    let mut network = TractNetwork::new(&Graphs::new(weights).unwrap(), sensors).unwrap();
    let mut worst = 0f32;
    for frame in 0..FRAMES {
        let seen: Vec<SensorFrame<'_>> = (0..sensors)
            .map(|sensor| {
                let at = frame * sensors + sensor;
                let there = |period: usize| !missing || (frame + sensor) % period != 0;
                SensorFrame {
                    piezo: there(3).then(|| scans[at].counts()),
                    log_mel: there(4).then(|| &log_mels[at]),
                }
            })
            .collect();
        for (a, b) in reference.step(&seen).into_iter().zip(network.step(&seen).unwrap()) {
            assert!(a.is_finite() && b.is_finite(), "frame {frame}: {a} {b}");
            worst = worst.max((a - b).abs());
        }
    }
    worst
}

#[test]
fn tract_computes_the_same_network() {
    let weights = common::random_weights(20);
    for (sensors, missing) in [(1, false), (3, false), (2, true)] {
        let worst = worst_difference(&weights, sensors, missing);
        println!("{sensors} sensors, parts missing {missing}: worst difference {worst:.2e}");
        assert!(worst < TOLERANCE, "{sensors} sensors, parts missing {missing}: {worst}");
    }
}

#[test]
fn a_single_changed_weight_shows() {
    let weights = common::random_weights(20);
    let mut changed = weights.clone();
    changed.tensors[0][0] += 1.0;
    let (scans, log_mels) = (common::scans(1, 1, 21), common::log_mels(1, 1, 22));
    let seen = [SensorFrame { piezo: Some(scans[0].counts()), log_mel: Some(&log_mels[0]) }];
    let logits = |weights| TractNetwork::new(&Graphs::new(weights).unwrap(), 1).unwrap().step(&seen).unwrap();
    let pairs = logits(&weights).into_iter().zip(logits(&changed));
    assert!(pairs.into_iter().any(|(a, b)| (a - b).abs() > 10.0 * TOLERANCE));
}

#[test]
fn another_number_of_sensors_is_refused() {
    let weights = common::random_weights(20);
    let mut network = TractNetwork::new(&Graphs::new(&weights).unwrap(), 2).unwrap();
    let error = network.step(&[SensorFrame::default()]).unwrap_err().to_string();
    assert_eq!(error, "1 sensors given, 2 expected");
}
