//! `logistic`: logistic regression on a dozen features of both sensors, the simplest learned fusion.
//!
//! Features, each the largest of all sensors:
//! 1. entropy of the pressure changes, nat (as in `entropy`)
//! 2. ln(1 + sum of the counts)
//! 3. |change of the sum| over the sum + 942
//! 4. largest change of a taxel over the peak + 8
//! 5. to 10. log-mel power of the 26 filters in six groups, ln g²
//! 11. ln of the mean square of the last 16 ms, ln g²
//! 12. mean rise of the log-mel powers since the frame 16 ms ago, nat
//!
//! Standardised on train. The score is the log-odds.

use slipsense::params::{ACTIVE_TAXELS, TAXEL_TOUCH_MIN};
use slipsense::sensor::PiezoFrame;
use slipsense_recording::Episode;

use super::paper::entropy_nat;
use crate::detector::{PerSensor, Score};
use crate::fitted::{LOGISTIC_FEATURES as FEATURES, LogisticFit};
use crate::spectrum::{FILTERS, XlSpectrum};

const GROUPS: [std::ops::Range<usize>; 6] = [0..4, 4..8, 8..13, 13..18, 18..22, 22..26];
/// Frames after which two analysis windows share no sample.
const APART: usize = 4;

#[derive(Clone, Default)]
struct Sensor {
    spectrum: XlSpectrum,
    before: Option<PiezoFrame>,
    /// Log-mel powers of the last frames, a ring.
    spectra: Option<[[f64; FILTERS]; APART]>,
    oldest: usize,
}

impl Sensor {
    fn step(&mut self, now: &PiezoFrame) -> [f64; FEATURES] {
        let before = self.before.as_ref().unwrap_or(now);
        let (sum, sum_before) = (f64::from(now.sum()), f64::from(before.sum()));
        let changes = now.counts().iter().zip(before.counts()).map(|(a, b)| a.abs_diff(*b));
        let change = changes.max().unwrap_or(0);
        let peak = now.counts().iter().copied().max().unwrap_or(0);
        let spectrum = self.spectrum.log_mel();
        let spectra = self.spectra.get_or_insert([spectrum; APART]);
        let then = std::mem::replace(&mut spectra[self.oldest], spectrum);
        self.oldest = (self.oldest + 1) % APART;

        let mut features = [0.0; FEATURES];
        features[0] = entropy_nat(before, now).into();
        features[1] = sum.ln_1p();
        features[2] = (sum - sum_before).abs() / (sum + ACTIVE_TAXELS as f64);
        features[3] = f64::from(change) / f64::from(peak + TAXEL_TOUCH_MIN);
        for (feature, group) in features[4..].iter_mut().zip(GROUPS) {
            let filters = group.len() as f64;
            *feature = spectrum[group].iter().sum::<f64>() / filters;
        }
        features[10] = self.spectrum.log_level();
        let rises = spectrum.iter().zip(then).map(|(now, then)| (now - then).max(0.0));
        features[11] = rises.sum::<f64>() / FILTERS as f64;
        self.before = Some(now.clone());
        features
    }
}

#[derive(Default)]
pub(crate) struct LogisticFeatures {
    sensors: PerSensor<Sensor>,
}

impl LogisticFeatures {
    pub(crate) fn step(&mut self, episode: &Episode, frame: usize) -> [f64; FEATURES] {
        let mut largest = [f64::MIN; FEATURES];
        for (index, sensor) in self.sensors.get(episode.sensors).iter_mut().enumerate() {
            sensor.spectrum.push_frame(episode, frame, index);
            let features = sensor.step(episode.piezo(frame, index));
            largest.iter_mut().zip(features).for_each(|(max, x)| *max = max.max(x));
        }
        largest
    }
}

pub(super) struct LogisticScore {
    features: LogisticFeatures,
    fit: LogisticFit,
}

impl LogisticScore {
    pub(super) fn new(fit: &LogisticFit) -> Self {
        Self { features: LogisticFeatures::default(), fit: fit.clone() }
    }
}

impl Score for LogisticScore {
    fn step(&mut self, episode: &Episode, frame: usize) -> f32 {
        self.fit.log_odds(&self.features.step(episode, frame)) as f32
    }
}
