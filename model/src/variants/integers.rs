//! The base's weights as the integers that the microcontroller runs: what quantization costs.

use anyhow::Result;
use slipsense::net::{Model, Network, SensorFeatures};
use slipsense::params::OUTPUTS;

use crate::command::{CALIBRATION_EPISODES, measure};
use crate::data::Features;
use crate::export;
use crate::quantize::quantize;
use crate::trace::Ranges;
use crate::tract::Graphs;
use crate::weights::Weights;

/// A model file of weights that have the shipped network's layout.
pub fn model(weights: &Weights, training: &[Features]) -> Result<Vec<u8>> {
    let graphs = Graphs::traced(weights)?;
    let mut ranges = Ranges::default();
    for features in training.iter().take(CALIBRATION_EPISODES) {
        ranges.merge(&measure(&graphs, features)?);
    }
    export::to_bytes(&quantize(weights, &ranges, "{}")?)
}

/// Outputs of every frame, nat, by the microcontroller's own kernels.
pub fn outputs(model: Model<'_>, features: &Features) -> Vec<[f32; OUTPUTS]> {
    let mut network = Network::new(model);
    let frame = |frame: usize| {
        let scans = features.scans(frame);
        let seen = scans.iter().enumerate().map(|(sensor, scan)| SensorFeatures {
            piezo: Some(scan),
            xl: Some(features.reading(frame, sensor).xl),
        });
        network.step(&seen.collect::<Vec<_>>()).map(|logit| logit.to_f64() as f32)
    };
    (0..features.frames()).map(frame).collect()
}
