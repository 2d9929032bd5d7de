//! The numbers that are fitted on the training split, as `fitted.json` holds them.

use std::io::{self, Write};
use std::path::Path;

use anyhow::{Context, Result, ensure};
use serde::{Deserialize, Serialize};
use serde_json::ser::{Formatter, PrettyFormatter, Serializer};
use slipsense::params::CLASSES;

use crate::detector::ClassOrder;
use crate::gaussian::{Density, Gaussian, Scaling};
use crate::spectrum::COEFFICIENTS;

/// Features of `rig-only` and `idle-noise`: 13 MFCC and the level; mean, mean square and mean change of the counts,
/// which are 0 for `rig-only`.
pub(crate) const IDLE_FEATURES: usize = COEFFICIENTS + 4;
/// These features and their squares.
pub(crate) const IDLE_TERMS: usize = 2 * IDLE_FEATURES;

/// Version of the file's layout and of the meaning of its numbers.
pub const FORMAT: u32 = 3;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fitted {
    pub(crate) format: u32,
    /// Which rule makes the classes first; the thresholds depend on it.
    pub(crate) class_order: ClassOrder,
    pub data: DataUsed,
    /// Training frames of each class, all of them.
    pub(crate) class_frames: [u64; CLASSES],
    /// `entropy`, nat.
    pub(crate) entropy: Cutoff,
    pub(crate) mfcc: MfccFit,
    /// `clock`: training frames of each class in each quarter of a second since the episode began.
    pub(crate) clock: Vec<[u64; CLASSES]>,
    /// `rig-only`; absent if the training episodes were not generated.
    pub(crate) rig_only: Option<IdleFit>,
    /// `idle-noise`, likewise.
    pub(crate) idle_noise: Option<IdleFit>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DataUsed {
    /// In words, with the seed.
    pub source: String,
    /// Always `train`: what the paper's baselines are fitted on.
    pub split: String,
    pub generator: String,
    pub episodes: u64,
    /// Frames in all; classes and clock count these.
    pub frames: u64,
    /// Of how many frames one was used for the rest.
    pub stride: u64,
    pub frames_used: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cutoff {
    /// Slip where the score is above this.
    pub(crate) threshold: f32,
    /// Standard deviation of the score over the used training frames, above 0.
    pub(crate) std: f32,
}

impl Cutoff {
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
    pub(crate) scaling: Scaling,
    pub(crate) slip: Gaussian,
    /// Standardised MFCC of all other frames.
    pub(crate) not_slip: Gaussian,
    /// Of the largest log-likelihood ratio of the sensors.
    pub(crate) cut: Cutoff,
}

impl MfccFit {
    pub(crate) fn ratio(&self) -> Result<LikelihoodRatio> {
        self.scaling.validate(COEFFICIENTS).context("mfcc.scaling")?;
        Ok(LikelihoodRatio {
            scaling: self.scaling.clone(),
            slip: self.slip.density().context("mfcc.slip")?,
            not_slip: self.not_slip.density().context("mfcc.not_slip")?,
        })
    }
}

/// Log-likelihood ratio of slip against not slip, by the MFCC of one sensor.
#[derive(Clone, Debug)]
pub(crate) struct LikelihoodRatio {
    scaling: Scaling,
    slip: Density<COEFFICIENTS>,
    not_slip: Density<COEFFICIENTS>,
}

impl LikelihoodRatio {
    /// Nat.
    pub(crate) fn ln(&self, mfcc: &[f64; COEFFICIENTS]) -> f64 {
        let z = self.scaling.apply(mfcc);
        self.slip.ln(&z) - self.not_slip.ln(&z)
    }
}

/// Two logistic regressions on the features of `rig-only` or `idle-noise` and their squares.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct IdleFit {
    pub(crate) scaling: Scaling,
    /// Slip against not slip.
    pub(crate) slip: Odds,
    /// Held against untouched, of the frames that do not slip.
    pub(crate) held: Odds,
}

impl IdleFit {
    fn validate(&self) -> Result<()> {
        self.scaling.validate(IDLE_FEATURES).context("scaling")?;
        for (name, odds) in [("slip", &self.slip), ("held", &self.held)] {
            ensure!(odds.weights.len() == IDLE_TERMS, "{name}.weights must hold {IDLE_TERMS}");
            let finite = odds.weights.iter().chain([&odds.intercept]).all(|w| w.is_finite());
            ensure!(finite, "{name}: weights and intercept must be finite");
        }
        Ok(())
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Odds {
    /// Log-odds per unit of each term.
    pub(crate) weights: Vec<f64>,
    /// Log-odds where all terms are 0.
    pub(crate) intercept: f64,
}

impl Odds {
    pub(crate) fn probability(&self, terms: &[f64]) -> f64 {
        let odds = self.intercept + self.weights.iter().zip(terms).map(|(w, x)| w * x).sum::<f64>();
        1.0 / (1.0 + (-odds).exp())
    }
}

impl Fitted {
    /// The numbers that are committed with the code.
    pub fn bundled() -> Result<Self> {
        Self::from_json(include_str!("../fitted.json")).context("bundled fitted.json")
    }

    pub fn read(path: &Path) -> Result<Self> {
        let name = || path.display().to_string();
        let text = std::fs::read_to_string(path).with_context(|| format!("{}: cannot read", name()))?;
        Self::from_json(&text).with_context(name)
    }

    pub fn from_json(text: &str) -> Result<Self> {
        let fitted: Self = serde_json::from_str(text).context("not a file of fitted detectors")?;
        fitted.validate()?;
        Ok(fitted)
    }

    /// JSON with one line per object member and whole arrays on one line: a matrix is not a page.
    pub fn to_json(&self) -> Result<String> {
        let mut bytes = Vec::new();
        self.serialize(&mut Serializer::with_formatter(&mut bytes, OneLinePerMember::default()))?;
        bytes.push(b'\n');
        Ok(String::from_utf8(bytes)?)
    }

    /// Check sizes and ranges, and that every covariance is one.
    pub(crate) fn validate(&self) -> Result<()> {
        ensure!(self.format == FORMAT, "format is {}, this program reads {FORMAT}", self.format);
        ensure!(self.data.split == "train", "data.split is \"{}\", must be \"train\"", self.data.split);
        let clocked: u64 = self.clock.iter().flatten().sum();
        let counted: u64 = self.class_frames.iter().sum();
        ensure!(counted > 0 && counted == self.data.frames, "class_frames must add up to data.frames");
        ensure!(clocked == counted, "clock must add up to data.frames");
        self.entropy.validate().context("entropy")?;
        self.mfcc.cut.validate().context("mfcc.cut")?;
        self.mfcc.ratio()?;
        for (detector, fit) in [("rig_only", &self.rig_only), ("idle_noise", &self.idle_noise)] {
            fit.as_ref().map_or(Ok(()), IdleFit::validate).context(detector)?;
        }
        Ok(())
    }
}

/// [`PrettyFormatter`] for objects alone: arrays stay on one line.
#[derive(Default)]
struct OneLinePerMember(PrettyFormatter<'static>);

impl Formatter for OneLinePerMember {
    fn begin_object<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.0.begin_object(writer)
    }

    fn begin_object_key<W: ?Sized + Write>(&mut self, writer: &mut W, first: bool) -> io::Result<()> {
        self.0.begin_object_key(writer, first)
    }

    fn begin_object_value<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.0.begin_object_value(writer)
    }

    fn end_object_value<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.0.end_object_value(writer)
    }

    fn end_object<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.0.end_object(writer)
    }
}
