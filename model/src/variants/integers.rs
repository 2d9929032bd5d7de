//! The base's weights as the integers that the microcontroller runs: what quantization costs.

use anyhow::Result;
use slipsense::net::Model;
use slipsense::net::network::{Network, SensorFeatures};
use slipsense::params::OUTPUTS;
use slipsense::sensor::PiezoFrame;

use crate::command::{CALIBRATION_EPISODES, measure};
use crate::data::{Features, Reading};
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
        let readings = (0..features.sensors).map(|sensor| features.reading(frame, sensor));
        let scan = |reading: &Reading| PiezoFrame::from_counts(*reading.scan()).expect("counts of a scan");
        let scans: Vec<_> = readings.clone().map(scan).collect();
        let seen = scans.iter().zip(readings);
        let seen = seen.map(|(scan, reading)| SensorFeatures { piezo: Some(scan), xl: Some(reading.xl) });
        network.step(&seen.collect::<Vec<_>>()).map(|logit| logit.to_f64() as f32)
    };
    (0..features.frames()).map(frame).collect()
}
