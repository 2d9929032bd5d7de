//! `rig-only`: classifies the vibration of the crosshead's drive and the parts' own noise alone, to show
//! whether the test rig gives slip away.
//!
//! A generated episode carries its recipe; the detector generates the episode again with every other vibration
//! off, and classifies that: 13 MFCC and the level (ln of the mean square), each the mean over the sensors,
//! which all stand on the same rig, and their squares. Two logistic regressions fitted on the
//! rig's sound of the training episodes give the probability of slip, and of a held object where nothing
//! slips; the class is the likeliest. Calibrated probabilities matter here: where the rig tells nothing they
//! are the classes' shares and the answer is the majority's, while discriminants with wrong densities would
//! guess, and guessing by itself has a higher macro F1 than the majority class. Only generated episodes have
//! a recipe, others are refused.

use anyhow::{Context, Result, bail, ensure};
use slipsense_recording::Episode;
use slipsense_synth::{Recipe, VibrationContent, generate};

use crate::detector::{Detector, PerSensor, Prediction};
use crate::fitted::{RIG_FEATURES as FEATURES, RIG_TERMS as TERMS, RigFit};
use crate::spectrum::XlSpectrum;

/// The episode generated again with the rig's vibration alone.
pub(crate) fn rig_only_episode(episode: &Episode) -> Result<Episode> {
    let Some(recipe) = episode.meta.other.get("recipe") else {
        bail!("rig-only needs a generated episode: its meta has no \"recipe\"");
    };
    let recipe: Recipe = serde_json::from_value(recipe.clone()).context("meta: recipe")?;
    let rig = generate(&Recipe { vibration_content: VibrationContent::RigOnly, ..recipe })?;
    let same = rig.sensors == episode.sensors && rig.xl_end == episode.xl_end;
    ensure!(same, "meta: recipe makes another episode than this one; another generator made it");
    Ok(rig)
}

/// Features of an episode with the rig's vibration alone, frame by frame.
#[derive(Default)]
pub(crate) struct RigFeatures {
    sensors: PerSensor<XlSpectrum>,
}

impl RigFeatures {
    pub(crate) fn step(&mut self, rig: &Episode, frame: usize) -> [f64; FEATURES] {
        let mut mean = [0.0; FEATURES];
        for (sensor, spectrum) in self.sensors.get(rig.sensors).iter_mut().enumerate() {
            spectrum.push_frame(rig, frame, sensor);
            let features = spectrum.mfcc().into_iter().chain([spectrum.log_level()]);
            mean.iter_mut().zip(features).for_each(|(m, x)| *m += x / rig.sensors as f64);
        }
        mean
    }
}

/// The features and their squares. All their products as well would let the fit learn the training rigs
/// instead of what rigs have in common.
pub(crate) fn terms(z: &[f64; FEATURES]) -> [f64; TERMS] {
    std::array::from_fn(|i| if i < FEATURES { z[i] } else { z[i - FEATURES] * z[i - FEATURES] })
}

/// The score is slip's probability less the larger of the other two; threshold 0.
pub(super) fn rig_only(fit: Option<&RigFit>) -> Result<Detector<'static>> {
    let fit = fit.context("rig-only was not fitted: the training episodes carried no recipe")?.clone();
    let mut features = RigFeatures::default();
    Ok(Box::new(move |episode| {
        let rig = rig_only_episode(episode)?;
        Ok(Prediction::by_frame(rig.frames(), 0.0, |frame| {
            let terms = terms(&fit.scaling.apply(&features.step(&rig, frame)));
            let (slip, held) = (fit.slip.probability(&terms), fit.held.probability(&terms));
            let [none, held] = [(1.0 - slip) * (1.0 - held), (1.0 - slip) * held];
            ((slip - none.max(held)) as f32, u8::from(held > none))
        }))
    }))
}
