//! `rig-only`: hears the crosshead's drive and the parts' own noise, nothing else, to show whether the test
//! rig gives slip away.
//!
//! A generated episode carries its recipe; the detector makes the episode again with nothing heard but the
//! rig, and classifies that. Three classes by quadratic discriminant analysis of 13 MFCC and the level (ln
//! of the mean square), each the mean over the sensors, which all stand on the same rig; priors are the
//! classes' shares on train, so that it answers as the majority does wherever the rig tells nothing. Fitted
//! on the rig's sound of the training episodes. Only generated episodes have a recipe, others are refused.

use anyhow::{Context, Result, bail, ensure};
use slipsense::params::CLASSES;
use slipsense_episode::Episode;
use slipsense_synth::{Heard, Recipe, generate};

use super::ear::Ear;
use super::mel::{COEFFICIENTS, FLOOR_G2, log_mel, mfcc};
use super::qda::{Density, Scaling};
use super::{Detector, PerSensor, Verdict};
use crate::fit::RigFit;

/// 13 MFCC and the level.
pub(crate) const FEATURES: usize = COEFFICIENTS + 1;

/// The episode made again with only the rig heard.
pub(crate) fn rig_only_episode(episode: &Episode) -> Result<Episode> {
    let Some(recipe) = episode.meta.other.get("recipe") else {
        bail!("rig-only needs a generated episode: its meta has no \"recipe\"");
    };
    let recipe: Recipe = serde_json::from_value(recipe.clone()).context("meta: recipe")?;
    let rig = generate(&Recipe { heard: Heard::RigOnly, ..recipe })?;
    let same = rig.sensors == episode.sensors && rig.xl_end == episode.xl_end;
    ensure!(same, "meta: recipe makes another episode than this one; another generator made it");
    Ok(rig)
}

/// Features of an episode in which only the rig is heard, frame by frame.
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

pub(super) struct RigOnly {
    scaling: Scaling,
    /// Each class's density and the log of its share; `None` for a class that train does not have.
    classes: [Option<(Density<FEATURES>, f64)>; CLASSES],
    features: RigFeatures,
}

impl RigOnly {
    pub(super) fn new(fit: Option<&RigFit>) -> Result<Self> {
        let fit = fit.context("rig-only was not fitted: the training episodes carried no recipe")?;
        fit.scaling.validate(FEATURES).context("rig_only.scaling")?;
        let mut classes = [const { None }; CLASSES];
        for (class, of_fit) in classes.iter_mut().zip(&fit.classes) {
            if let Some(of_fit) = of_fit {
                let density = of_fit.gaussian.density().context("rig_only.classes")?;
                *class = Some((density, of_fit.share.ln()));
            }
        }
        Ok(Self { scaling: fit.scaling.clone(), classes, features: RigFeatures::new() })
    }

    /// Log of the posterior of each class, but for a constant; far below any for an unknown class.
    fn posterior(&self, features: &[f64; FEATURES]) -> [f64; CLASSES] {
        let z = self.scaling.apply(features);
        self.classes.each_ref().map(|class| match class {
            Some((density, ln_share)) => density.ln(&z) + ln_share,
            None => -1e30,
        })
    }
}

impl Detector for RigOnly {
    fn name(&self) -> &'static str {
        "rig-only"
    }

    /// The score is slip's log posterior less the larger of the other two, nat; threshold 0.
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
