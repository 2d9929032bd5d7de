//! What one training episode contributes.

use anyhow::{Context, Result, ensure};
use serde_json::Value;
use slipsense::params::CLASSES;
use slipsense_recording::{Episode, Meta};
use slipsense_synth::VibrationContent::{IdleNoise, RigOnly};

use crate::detector::touched;
use crate::detectors::idle::{IdleFeatures, generated_again};
use crate::detectors::limits::CLOCK_BIN_FRAMES;
use crate::detectors::paper::entropy;
use crate::fitted::IDLE_FEATURES;
use crate::spectrum::{COEFFICIENTS, XlSpectrum};

pub(super) struct Frame {
    pub label: u8,
    /// Of the laboratory, as the paper's baselines are; the others count for `clock`, `rig-only` and `idle-noise` alone.
    pub laboratory: bool,
    pub touched: bool,
    pub entropy: f32,
    /// One per sensor.
    pub mfcc: Vec<[f64; COEFFICIENTS]>,
    /// With the rig alone; `None` where the episode has no recipe.
    pub rig: Option<[f64; IDLE_FEATURES]>,
    /// With idle noise alone, likewise.
    pub noise: Option<[f64; IDLE_FEATURES]>,
}

/// The used frames of one episode, and the frames of each class by time.
pub(super) struct Sample {
    pub frames: Vec<Frame>,
    /// All frames of each class in each bin of the clock.
    pub clock: Vec<[u64; CLASSES]>,
}

impl Sample {
    /// From a training episode: frames 0, `stride`, 2 · `stride` and so on.
    pub(super) fn new(episode: &Episode, laboratory: bool, stride: usize) -> Result<Self> {
        refuse_other_splits(&episode.meta)?;
        let label = episode.label.as_ref().context("array label is missing, needed to fit")?;
        let has_recipe = episode.meta.other.contains_key("recipe");
        let idle = |content| has_recipe.then(|| generated_again(episode, content)).transpose();
        let (rig, noise) = (idle(RigOnly)?, idle(IdleNoise)?);
        let mut entropy = entropy();
        let mut spectra = vec![XlSpectrum::default(); episode.sensors];
        let [mut of_rig, mut of_noise] = [RigOnly, IdleNoise].map(IdleFeatures::new);
        let mut clock = vec![[0; CLASSES]; episode.frames().div_ceil(CLOCK_BIN_FRAMES)];
        let mut frames = Vec::with_capacity(episode.frames().div_ceil(stride));
        for (frame, &label) in label.iter().enumerate() {
            clock[frame / CLOCK_BIN_FRAMES][usize::from(label)] += 1;
            let mfcc = spectra.iter_mut().enumerate().map(|(sensor, spectrum)| {
                spectrum.push_frame(episode, frame, sensor);
                spectrum.mfcc()
            });
            let sample = Frame {
                label,
                laboratory,
                touched: touched(episode, frame),
                entropy: entropy(episode, frame),
                mfcc: mfcc.collect(),
                rig: rig.as_ref().map(|rig| of_rig.step(rig, frame)),
                noise: noise.as_ref().map(|noise| of_noise.step(noise, frame)),
            };
            if frame.is_multiple_of(stride) {
                frames.push(sample);
            }
        }
        Ok(Self { frames, clock })
    }
}

/// Metadata with a `split` must hold `train`; without one (files older than the splits, recordings) the object
/// must not be one that is kept from training.
fn refuse_other_splits(meta: &Meta) -> Result<()> {
    match meta.other.get("split") {
        Some(split) => ensure!(split == "train", "meta: split is {split}, only \"train\" may be fitted on"),
        None => ensure!(
            meta.other.get("held_out") != Some(&Value::Bool(true)),
            "meta: the object is held out, only training objects may be fitted on"
        ),
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn only_training_episodes_are_fitted_on() {
        let meta =
            |other: Value| Meta { other: other.as_object().unwrap().clone(), ..Meta::nominal(0.488e-3) };
        for (other, ok) in [
            (json!({"split": "train", "held_out": false}), true),
            (json!({"split": "val", "held_out": false}), false),
            (json!({"split": 1}), false),
            (json!({"held_out": false}), true),
            (json!({}), true),
            (json!({"held_out": true}), false),
        ] {
            assert_eq!(refuse_other_splits(&meta(other.clone())).is_ok(), ok, "{other}");
        }
    }
}
