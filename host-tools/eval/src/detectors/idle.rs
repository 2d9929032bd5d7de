//! `rig-only` and `idle-noise`: classify fingers that nothing touches, to show whether the test rig or the
//! sensors' noise give slip away.
//!
//! A generated episode carries its recipe; the detector generates the episode again with every vibration off but
//! the crosshead's drive (`rig-only`), or with that off too and untouched pads (`idle-noise`), and classifies
//! that: 13 MFCC and the level (ln of the mean square) of the accelerometers, for `idle-noise` mean, mean square and
//! mean change of the counts too, each the mean over the sensors, and their squares. Two logistic regressions
//! fitted on the training episodes give the probability of slip, and of a held object where nothing slips; the
//! class is the likeliest. Calibrated probabilities matter here: without information they are the classes' shares
//! and the answer is the majority's, while discriminants with wrong densities would guess, and guessing by itself
//! has a higher macro F1 than the majority class. Only generated episodes have a recipe, others are refused.

use anyhow::{Context, Result, bail, ensure};
use slipsense::params::TAXELS;
use slipsense_recording::Episode;
use slipsense_synth::{Recipe, VibrationContent, generate, generate_accelerometers};

use crate::detector::{Detector, PerSensor, Prediction};
use crate::fitted::{IDLE_FEATURES as FEATURES, IDLE_TERMS as TERMS, IdleFit};
use crate::spectrum::XlSpectrum;

/// The episode generated again with this vibration alone.
pub(crate) fn generated_again(episode: &Episode, content: VibrationContent) -> Result<Episode> {
    let Some(recipe) = episode.meta.other.get("recipe") else {
        bail!("rig-only and idle-noise need a generated episode: its meta has no \"recipe\"");
    };
    let recipe: Recipe = serde_json::from_value(recipe.clone()).context("meta: recipe")?;
    let recipe = Recipe { vibration_content: content, ..recipe };
    // The counts of `rig-only` are not looked at.
    let untouched = content == VibrationContent::IdleNoise;
    let idle = if untouched { generate(&recipe) } else { generate_accelerometers(&recipe) }?;
    let same = idle.sensors == episode.sensors && idle.xl_end == episode.xl_end;
    ensure!(same, "meta: recipe makes another episode than this one; another generator made it");
    Ok(idle)
}

/// Features of such an episode, frame by frame.
pub(crate) struct IdleFeatures {
    content: VibrationContent,
    sensors: PerSensor<XlSpectrum>,
}

impl IdleFeatures {
    pub(crate) fn new(content: VibrationContent) -> Self {
        Self { content, sensors: PerSensor::default() }
    }

    pub(crate) fn step(&mut self, idle: &Episode, frame: usize) -> [f64; FEATURES] {
        let mut mean = [0.0; FEATURES];
        for (sensor, spectrum) in self.sensors.get(idle.sensors).iter_mut().enumerate() {
            spectrum.push_frame(idle, frame, sensor);
            let untouched = self.content == VibrationContent::IdleNoise;
            let counts = if untouched { counts(idle, frame, sensor) } else { [0.0; 3] };
            let features = spectrum.mfcc().into_iter().chain([spectrum.log_level()]).chain(counts);
            mean.iter_mut().zip(features).for_each(|(m, x)| *m += x / idle.sensors as f64);
        }
        mean
    }
}

/// Mean, mean square and mean change since the last frame, of one array.
fn counts(idle: &Episode, frame: usize, sensor: usize) -> [f64; 3] {
    let [last, now] = [frame.saturating_sub(1), frame].map(|frame| idle.piezo(frame, sensor).counts());
    let mut sums = [0.0; 3];
    for (&now, &last) in now.iter().zip(last) {
        let (now, last) = (f64::from(now), f64::from(last));
        sums.iter_mut().zip([now, now * now, (now - last).abs()]).for_each(|(sum, x)| *sum += x);
    }
    sums.map(|sum| sum / TAXELS as f64)
}

/// The features and their squares. All their products as well would let the fit learn the training rigs
/// instead of what rigs have in common.
pub(crate) fn terms(z: &[f64; FEATURES]) -> [f64; TERMS] {
    std::array::from_fn(|i| if i < FEATURES { z[i] } else { z[i - FEATURES] * z[i - FEATURES] })
}

/// The score is slip's probability less the larger of the other two; threshold 0.
pub(super) fn idle(fit: Option<&IdleFit>, content: VibrationContent) -> Result<Detector<'static>> {
    let fit = fit.context("was not fitted: the training episodes carried no recipe")?.clone();
    let mut features = IdleFeatures::new(content);
    Ok(Box::new(move |episode| {
        let idle = generated_again(episode, content)?;
        Ok(Prediction::by_frame(idle.frames(), 0.0, |frame| {
            let terms = terms(&fit.scaling.apply(&features.step(&idle, frame)));
            let (slip, held) = (fit.slip.probability(&terms), fit.held.probability(&terms));
            let [none, held] = [(1.0 - slip) * (1.0 - held), (1.0 - slip) * held];
            ((slip - none.max(held)) as f32, u8::from(held > none))
        }))
    }))
}
