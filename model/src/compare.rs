//! Float against integer, activation by activation.
//!
//! Both networks run freely over the same features, each from its own past, so an error shown at a layer is
//! everything that the integers before it added up to, not that layer's alone.

use std::collections::BTreeMap;

use anyhow::{Context, Result, ensure};
use serde::Serialize;
use slipsense::features::XlFrontEnd;
use slipsense::fixed::Logit;
use slipsense::net::{Model, Network, SensorFeatures};
use slipsense::params::CONTACT_SUM_MIN;
use slipsense_recording::Episode;
use slipsense_recording::model_file::SCALES_KEY;

use crate::evaluate::decide;
use crate::trace::{ACTIVATIONS, IntegerTrace, Trace};
use crate::tract::{Graphs, TractNetwork};
use crate::weights::Weights;

/// What becomes of one activation in integers.
#[derive(Clone, Debug, Serialize)]
pub struct ActivationError {
    /// As in [`ACTIVATIONS`].
    pub activation: &'static str,
    /// Values compared: frames, times sensors where each has its own, times width.
    pub values: u64,
    /// Real value of one integer unit.
    pub scale: f64,
    /// Largest magnitude in float, real units.
    pub largest: f64,
    /// Root mean square in float, real units.
    pub rms: f64,
    /// Power of the float values over that of the differences, dB. `None` where nothing differs or all is zero.
    pub snr_db: Option<f64>,
    /// Largest difference, real units.
    pub worst_error: f64,
}

/// Both networks over one episode.
#[derive(Clone, Debug, Serialize)]
pub struct LayerComparison {
    /// In the order of [`ACTIVATIONS`].
    pub activations: Vec<ActivationError>,
    pub frames: usize,
    /// Frames with the same class, under the same no-contact rule.
    pub agreed: usize,
    /// The frames, counted from 0, where the classes differ.
    pub differing_frames: Vec<usize>,
}

impl LayerComparison {
    /// Share of frames with the same class, 0 to 1; `None` without frames.
    pub fn agreement(&self) -> Option<f64> {
        (self.frames > 0).then(|| self.agreed as f64 / self.frames as f64)
    }

    pub fn activation(&self, name: &str) -> Option<&ActivationError> {
        self.activations.iter().find(|a| a.activation == name)
    }
}

#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    values: u64,
    power: f64,
    error: f64,
    largest: f64,
    worst: f64,
}

impl Sums {
    fn add(&mut self, float: &[f32], integer: &[f32]) {
        for (&float, &integer) in float.iter().zip(integer) {
            let (float, error) = (f64::from(float), f64::from(integer) - f64::from(float));
            self.values += 1;
            self.power += float * float;
            self.error += error * error;
            self.largest = self.largest.max(float.abs());
            self.worst = self.worst.max(error.abs());
        }
    }
}

/// Real value of one unit of every activation, from a model's provenance.
pub fn scales(model: &Model<'_>) -> Result<BTreeMap<String, f64>> {
    let provenance: serde_json::Value =
        serde_json::from_str(model.provenance).context("provenance is not JSON")?;
    let scales = provenance.get(SCALES_KEY);
    let scales = scales.with_context(|| {
        format!("provenance has no {SCALES_KEY}: the model was quantized by an older version, or not at all")
    })?;
    let scales: BTreeMap<String, f64> = serde_json::from_value(scales.clone())
        .with_context(|| format!("provenance {SCALES_KEY} must be numbers by activation"))?;
    for activation in ACTIVATIONS {
        let scale = scales.get(activation);
        let scale = scale.with_context(|| format!("provenance {SCALES_KEY} lacks {activation}"))?;
        ensure!(
            scale.is_finite() && *scale > 0.0,
            "provenance {SCALES_KEY} {activation} is {scale}, must be positive"
        );
    }
    Ok(scales)
}

/// Run both networks over one episode. Refuses weights of other sizes than the model's.
pub fn compare_activations(
    model: Model<'_>,
    weights: &Weights,
    episode: &Episode,
) -> Result<LayerComparison> {
    let [of_model, of_weights] = [model.dims, weights.dims].map(|dims| dims.to_fields());
    ensure!(
        of_model == of_weights,
        "the model's sizes are {of_model:?}, the weights' {of_weights:?}: not the same network"
    );
    let scales = scales(&model)?;
    let sensors = episode.sensors;
    let mut front_ends = vec![XlFrontEnd::new(); sensors];
    let mut float_network = TractNetwork::new(&Graphs::traced(weights)?, sensors)?;
    let mut network = Network::new(model);
    let mut integer = IntegerTrace { scales: &scales, trace: Trace::default() };
    let mut sums = [Sums::default(); ACTIVATIONS.len()];
    let mut differing_frames = Vec::new();
    for frame in 0..episode.frames() {
        let seen = front_ends.iter_mut().enumerate().map(|(sensor, front_end)| {
            front_end.push(episode.xl_batch(frame, sensor));
            let xl = front_end.log_mel().features();
            SensorFeatures { piezo: Some(episode.piezo(frame, sensor)), xl: Some(xl) }
        });
        let seen: Vec<_> = seen.collect();
        let from_integer = network.step_observed(&seen, &mut integer).map(Logit::to_bits);
        let from_float = float_network.step(&seen)?;

        let touched = (0..sensors).any(|sensor| episode.piezo(frame, sensor).sum() >= CONTACT_SUM_MIN);
        if decide(touched, &from_integer) != decide(touched, &from_float) {
            differing_frames.push(frame);
        }
        let float = &mut float_network.trace;
        for ((sums, float), integer) in sums.iter_mut().zip(float.values()).zip(integer.trace.values()) {
            ensure!(float.len() == integer.len(), "the networks return different numbers of values");
            sums.add(float, integer);
        }
        float.clear();
        integer.trace.clear();
    }
    let activations = ACTIVATIONS.into_iter().zip(sums).map(|(activation, sums)| ActivationError {
        activation,
        values: sums.values,
        scale: scales[activation],
        largest: sums.largest,
        rms: if sums.values > 0 { (sums.power / sums.values as f64).sqrt() } else { 0.0 },
        snr_db: (sums.power > 0.0 && sums.error > 0.0).then(|| 10.0 * (sums.power / sums.error).log10()),
        worst_error: sums.worst,
    });
    Ok(LayerComparison {
        activations: activations.collect(),
        frames: episode.frames(),
        agreed: episode.frames() - differing_frames.len(),
        differing_frames,
    })
}
