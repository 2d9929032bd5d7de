//! `mfcc-qda`: the paper's accelerometer baseline, 13 MFCC of 26 filters with quadratic discriminant
//! analysis, after Yoo et al. (2021).
//!
//! Two classes, slip and not slip, with equal priors: the accelerometer cannot see contact, and the rarity
//! of slip in a test protocol is nothing to learn. The score is the log of the likelihood ratio, nat, the
//! largest of all sensors; its threshold is fitted on train.

use anyhow::{Context, Result};
use slipsense_recording::Episode;

use super::PerSensor;
use super::ear::Ear;
use super::mel::{COEFFICIENTS, log_mel, mfcc};
use super::qda::{Density, Scaling};
use super::threshold::Score;
use crate::fit::MfccFit;

/// MFCC of every sensor, frame by frame.
#[derive(Clone)]
pub(crate) struct Mfccs {
    ears: PerSensor<Ear>,
}

impl Mfccs {
    pub(crate) const fn new() -> Self {
        Self { ears: PerSensor::new() }
    }

    /// The next frame's, in the order of the sensors.
    pub(crate) fn step(
        &mut self,
        episode: &Episode,
        frame: usize,
    ) -> impl Iterator<Item = [f64; COEFFICIENTS]> {
        let ears = self.ears.of(episode.sensors, Ear::new);
        ears.iter_mut().enumerate().map(move |(sensor, ear)| {
            ear.listen_to(episode, frame, sensor);
            mfcc(&log_mel(&ear.power_g2()))
        })
    }

    pub(crate) fn reset(&mut self) {
        self.ears.clear();
    }
}

/// Log-likelihood ratio of slip against not slip.
#[derive(Clone, Debug)]
pub(crate) struct Ratio {
    scaling: Scaling,
    slip: Density<COEFFICIENTS>,
    not_slip: Density<COEFFICIENTS>,
}

impl Ratio {
    pub(crate) fn new(fit: &MfccFit) -> Result<Self> {
        fit.scaling.validate(COEFFICIENTS).context("mfcc.scaling")?;
        Ok(Self {
            scaling: fit.scaling.clone(),
            slip: fit.slip.density().context("mfcc.slip")?,
            not_slip: fit.not_slip.density().context("mfcc.not_slip")?,
        })
    }

    /// Of one sensor's MFCC, nat.
    pub(crate) fn of(&self, mfcc: &[f64; COEFFICIENTS]) -> f64 {
        let z = self.scaling.apply(mfcc);
        self.slip.ln(&z) - self.not_slip.ln(&z)
    }
}

pub(super) struct MfccQdaScore {
    mfccs: Mfccs,
    ratio: Ratio,
}

impl MfccQdaScore {
    pub(super) fn new(fit: &MfccFit) -> Result<Self> {
        Ok(Self { mfccs: Mfccs::new(), ratio: Ratio::new(fit)? })
    }
}

impl Score for MfccQdaScore {
    fn step(&mut self, episode: &Episode, frame: usize) -> f32 {
        let ratios = self.mfccs.step(episode, frame).map(|mfcc| self.ratio.of(&mfcc));
        ratios.fold(f64::from(f32::MIN), f64::max) as f32
    }

    fn reset(&mut self) {
        self.mfccs.reset();
    }
}
