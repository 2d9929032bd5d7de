//! `rig-only`: hears the crosshead's drive and the parts' own noise, nothing else, to show whether the test
//! rig gives slip away.
//!
//! A generated episode carries its recipe; the detector makes the episode again with no vibration but the
//! rig, and classifies that: 13 MFCC and the level (ln of the mean square), each the mean over the sensors,
//! which all stand on the same rig, and their squares. Two logistic regressions fitted on the
//! rig's sound of the training episodes give the probability of slip, and of a held object where nothing
//! slips; the class is the likeliest. Calibrated probabilities matter here: where the rig tells nothing they
//! are the classes' shares and the answer is the majority's, while discriminants with wrong densities would
//! guess, and guessing by itself has a higher macro F1 than the majority class. Only generated episodes have
//! a recipe, others are refused.

use anyhow::{Context, Result, bail, ensure};
use slipsense::params::CLASSES;
use slipsense_recording::Episode;
use slipsense_synth::{Recipe, VibrationContent, generate};

use super::ear::Ear;
use super::mel::{COEFFICIENTS, FLOOR_G2, log_mel, mfcc};
use super::{Detector, PerSensor, Verdict};
use crate::fit::RigFit;

/// 13 MFCC and the level.
pub(crate) const FEATURES: usize = COEFFICIENTS + 1;
/// The features and their squares.
pub(crate) const TERMS: usize = 2 * FEATURES;

/// The episode made again with only the rig's vibration.
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

/// Features of an episode with only the rig's vibration, frame by frame.
pub(crate) struct RigFeatures {
    ears: PerSensor<Ear>,
}

impl RigFeatures {
    pub(crate) const fn new() -> Self {
        Self { ears: PerSensor::new() }
    }

    /// The next frame's.
    pub(crate) fn step(&mut self, rig: &Episode, frame: usize) -> [f64; FEATURES] {
        let mut mean = [0.0; FEATURES];
        for (sensor, ear) in self.ears.of(rig.sensors, Ear::new).iter_mut().enumerate() {
            ear.listen_to(rig, frame, sensor);
            let level = (ear.mean_square_g2() + FLOOR_G2).ln();
            let features = mfcc(&log_mel(&ear.power_g2())).into_iter().chain([level]);
            mean.iter_mut().zip(features).for_each(|(m, x)| *m += x / rig.sensors as f64);
        }
        mean
    }
}

/// The features and their squares. All their products as well would let the fit know the training rigs by
/// heart instead of what rigs have in common.
pub(crate) fn terms(z: &[f64; FEATURES]) -> [f64; TERMS] {
    std::array::from_fn(|i| if i < FEATURES { z[i] } else { z[i - FEATURES] * z[i - FEATURES] })
}

pub(super) struct RigOnly {
    fit: RigFit,
    features: RigFeatures,
}

impl RigOnly {
    pub(super) fn new(fit: Option<&RigFit>) -> Result<Self> {
        let fit = fit.context("rig-only was not fitted: the training episodes carried no recipe")?;
        Ok(Self { fit: fit.clone(), features: RigFeatures::new() })
    }

    /// Probability of each class.
    fn posterior(&self, features: &[f64; FEATURES]) -> [f64; CLASSES] {
        let terms = terms(&self.fit.scaling.apply(features));
        let (slip, held) = (self.fit.slip.probability(&terms), self.fit.held.probability(&terms));
        [(1.0 - slip) * (1.0 - held), (1.0 - slip) * held, slip]
    }
}

impl Detector for RigOnly {
    fn name(&self) -> &'static str {
        "rig-only"
    }

    /// The score is slip's probability less the larger of the other two; threshold 0.
    fn judge(&mut self, episode: &Episode) -> Result<Verdict> {
        let rig = rig_only_episode(episode)?;
        let (score, fallback) = (0..rig.frames())
            .map(|frame| {
                let features = self.features.step(&rig, frame);
                let [none, held, slip] = self.posterior(&features);
                ((slip - none.max(held)) as f32, u8::from(held > none))
            })
            .unzip();
        Ok(Verdict::new(score, 0.0, fallback))
    }

    fn reset(&mut self) {
        self.features.ears.clear();
    }
}
