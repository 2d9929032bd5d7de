//! The file of fitted numbers.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use serde::{Deserialize, Serialize};
use slipsense::params::CLASSES;
use slipsense_recording::score::SLIP;

use super::sample::Frame;
use super::youden::youden;
use crate::detectors::qda::{Gaussian, Scaling};
use crate::detectors::{ClassOrder, LOGISTIC_FEATURES, MfccRatio, NEVER, RIG_FEATURES, RIG_TERMS};

/// Version of the file's layout and of the meaning of its numbers.
pub const FORMAT: u32 = 1;

/// Everything that is fitted.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fitted {
    /// [`FORMAT`].
    pub format: u32,
    /// Which rule makes the classes first; the thresholds depend on it.
    pub class_order: ClassOrder,
    /// What it was fitted on.
    pub data: DataUsed,
    /// Training frames of each class, all of them.
    pub class_frames: [u64; CLASSES],
    /// `entropy`, nat.
    pub entropy: Cut,
    /// `mfcc-qda`.
    pub mfcc: MfccFit,
    /// `energy`, spreads.
    pub energy: Cut,
    /// `flux-cusum`, spreads.
    pub flux_cusum: Cut,
    /// `band-pass`, g².
    pub band_pass: Cut,
    /// `logistic`.
    pub logistic: LogisticFit,
    /// `clock`: training frames of each class in each quarter of a second since the episode began.
    pub clock: Vec<[u64; CLASSES]>,
    /// `rig-only`; absent if the training episodes were not generated.
    pub rig_only: Option<RigFit>,
}

/// What was fitted on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DataUsed {
    /// In words, with the seed.
    pub source: String,
    /// Always `train`.
    pub split: String,
    /// Name and version of the generator.
    pub generator: String,
    /// Episodes.
    pub episodes: u64,
    /// Frames in all; classes and clock count these.
    pub frames: u64,
    /// Of how many frames one was used for the rest.
    pub stride: u64,
    /// Frames used for the rest.
    pub frames_used: u64,
}

/// Threshold of a score.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cut {
    /// Slip where the score is above this.
    pub threshold: f32,
    /// Standard deviation of the score over the used training frames, above 0.
    pub std: f32,
}

impl Cut {
    /// By the largest Youden index.
    pub(super) fn fit<'a>(frames: impl Iterator<Item = (f32, &'a Frame)>, order: ClassOrder) -> Self {
        let frames: Vec<_> = frames.collect();
        let n = frames.len().max(1) as f64;
        let mean = frames.iter().map(|(score, _)| f64::from(*score)).sum::<f64>() / n;
        let variance = frames.iter().map(|(score, _)| (f64::from(*score) - mean).powi(2)).sum::<f64>() / n;
        let ruled_out = |frame: &Frame| order == ClassOrder::ContactFirst && !frame.touched;
        let with_truth = |(score, frame): (f32, &Frame)| {
            (if ruled_out(frame) { NEVER } else { score }, frame.label == SLIP)
        };
        let mut scored: Vec<_> = frames.into_iter().map(with_truth).collect();
        let threshold = youden(&mut scored).map_or(f32::MAX, |best| best.threshold);
        Self { threshold, std: if variance > 0.0 { variance.sqrt() as f32 } else { 1.0 } }
    }

    fn validate(&self) -> Result<()> {
        ensure!(self.threshold.is_finite(), "threshold must be finite");
        ensure!(self.std.is_finite() && self.std > 0.0, "std must be above 0");
        Ok(())
    }
}

/// Quadratic discriminants on MFCC.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MfccFit {
    /// Of the MFCC, over all sensors' frames.
    pub scaling: Scaling,
    /// Standardised MFCC of slip frames.
    pub slip: Gaussian,
    /// Standardised MFCC of all other frames.
    pub not_slip: Gaussian,
    /// Of the largest log-likelihood ratio of the sensors.
    pub cut: Cut,
}

/// Logistic regression of slip against not slip.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LogisticFit {
    /// Of the features.
    pub scaling: Scaling,
    /// Log-odds per standard deviation of each feature.
    pub weights: Vec<f64>,
    /// Log-odds at the mean of all features.
    pub intercept: f64,
    /// Of the log-odds.
    pub cut: Cut,
}

impl LogisticFit {
    /// Log-odds of slip.
    pub(crate) fn log_odds(&self, features: &[f64; LOGISTIC_FEATURES]) -> f64 {
        let z = self.scaling.apply(features);
        self.intercept + self.weights.iter().zip(z).map(|(w, z)| w * z).sum::<f64>()
    }
}

/// Two logistic regressions on the rig's sound, on its features and their squares.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RigFit {
    /// Of the features.
    pub scaling: Scaling,
    /// Slip against not slip.
    pub slip: Odds,
    /// Held against untouched, of the frames that do not slip.
    pub held: Odds,
}

/// One logistic regression.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Odds {
    /// Log-odds per unit of each term.
    pub weights: Vec<f64>,
    /// Log-odds where all terms are 0.
    pub intercept: f64,
}

impl Odds {
    /// Probability at these terms.
    pub(crate) fn probability(&self, terms: &[f64]) -> f64 {
        let odds = self.intercept + self.weights.iter().zip(terms).map(|(w, x)| w * x).sum::<f64>();
        1.0 / (1.0 + (-odds).exp())
    }
}

impl Fitted {
    /// The numbers that are committed with the code.
    pub fn bundled() -> Result<Self> {
        Self::from_json(include_str!("../../fitted.json")).context("bundled fitted.json")
    }

    /// Read a file and check it.
    pub fn read(path: &Path) -> Result<Self> {
        let name = || path.display().to_string();
        let text = std::fs::read_to_string(path).with_context(|| format!("{}: cannot read", name()))?;
        Self::from_json(&text).with_context(name)
    }

    /// Read JSON and check it.
    pub fn from_json(text: &str) -> Result<Self> {
        let fitted: Self = serde_json::from_str(text).context("not a file of fitted detectors")?;
        fitted.validate()?;
        Ok(fitted)
    }

    /// JSON, for people and machines.
    pub fn to_json(&self) -> Result<String> {
        Ok(super::json::to_text(self)?)
    }

    /// Check sizes and ranges, and that every covariance is one.
    pub fn validate(&self) -> Result<()> {
        ensure!(self.format == FORMAT, "format is {}, this program reads {FORMAT}", self.format);
        ensure!(self.data.split == "train", "data.split is \"{}\", must be \"train\"", self.data.split);
        let clocked: u64 = self.clock.iter().flatten().sum();
        let counted: u64 = self.class_frames.iter().sum();
        ensure!(counted > 0 && counted == self.data.frames, "class_frames must add up to data.frames");
        ensure!(clocked == counted, "clock must add up to data.frames");
        for (name, cut) in [
            ("entropy", &self.entropy),
            ("mfcc.cut", &self.mfcc.cut),
            ("energy", &self.energy),
            ("flux_cusum", &self.flux_cusum),
            ("band_pass", &self.band_pass),
            ("logistic.cut", &self.logistic.cut),
        ] {
            cut.validate().context(name)?;
        }
        MfccRatio::new(&self.mfcc)?;
        let LogisticFit { scaling, weights, intercept, .. } = &self.logistic;
        scaling.validate(LOGISTIC_FEATURES).context("logistic.scaling")?;
        ensure!(weights.len() == LOGISTIC_FEATURES, "logistic.weights must hold {LOGISTIC_FEATURES}");
        let finite = weights.iter().chain([intercept]).all(|w| w.is_finite());
        ensure!(finite, "logistic.weights and intercept must be finite");
        if let Some(rig) = &self.rig_only {
            rig.scaling.validate(RIG_FEATURES).context("rig_only.scaling")?;
            for (name, odds) in [("slip", &rig.slip), ("held", &rig.held)] {
                ensure!(odds.weights.len() == RIG_TERMS, "rig_only.{name}.weights must hold {RIG_TERMS}");
                let finite = odds.weights.iter().chain([&odds.intercept]).all(|w| w.is_finite());
                ensure!(finite, "rig_only.{name}: weights and intercept must be finite");
            }
        }
        Ok(())
    }
}
