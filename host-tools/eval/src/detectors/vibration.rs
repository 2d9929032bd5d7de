//! Threshold rules on the accelerometer's vibration: `energy`, `flux-cusum` and `band-pass`.

use slipsense::params::FRAME_RATE_HZ;
use slipsense_recording::Episode;

use super::running::RunningMedian;
use crate::detector::SensorScore;
use crate::spectrum::{FILTERS, XlSpectrum};

/// `energy`: how many spreads the vibration energy is above its running median, the plain threshold rule of
/// vibration-based slip detection. Energy is the mean square of the last 128 high-passed samples over all axes;
/// the score is (energy − median) / MAD.
#[derive(Clone, Default)]
pub(crate) struct EnergyScore {
    spectrum: XlSpectrum,
    normal: RunningMedian,
}

impl SensorScore for EnergyScore {
    fn step(&mut self, episode: &Episode, frame: usize, sensor: usize) -> f64 {
        self.spectrum.push_frame(episode, frame, sensor);
        self.normal.spreads_above(self.spectrum.mean_square_g2()).unwrap_or(0.0)
    }
}

/// Share of a new frame in the reference spectrum: a time constant of 1 s.
const REFERENCE_SHARE: f64 = 1.0 / FRAME_RATE_HZ as f64;
/// Subtracted in every frame, spreads.
const DRIFT: f64 = 1.0;
const STEP_MAX: f64 = 10.0;
const SUM_MAX: f64 = 50.0;

/// `flux-cusum`: one-sided CUSUM on the spectral flux.
///
/// Flux of a frame: mean over the 26 mel filters of how far the log power is above that sensor's running
/// reference spectrum (exponential, 1 s), rises only: spectral flux with a slow reference, so that it
/// lasts as long as the slip does. It is measured in spreads z of its running median; the sum grows by z − 1 per
/// frame, z held to at most 10, and stays between 0 and 50, so that it is back within a quarter of a second after
/// the vibration ends. The score is the sum.
#[derive(Clone, Default)]
pub(crate) struct FluxCusumScore {
    spectrum: XlSpectrum,
    reference: Option<[f64; FILTERS]>,
    normal: RunningMedian,
    sum: f64,
}

impl SensorScore for FluxCusumScore {
    fn step(&mut self, episode: &Episode, frame: usize, sensor: usize) -> f64 {
        self.spectrum.push_frame(episode, frame, sensor);
        let spectrum = self.spectrum.log_mel();
        let reference = self.reference.get_or_insert(spectrum);
        let mut flux = 0.0;
        for (reference, now) in reference.iter_mut().zip(spectrum) {
            flux += (now - *reference).max(0.0) / FILTERS as f64;
            *reference += REFERENCE_SHARE * (now - *reference);
        }
        if let Some(z) = self.normal.spreads_above(flux) {
            self.sum = (self.sum + z.min(STEP_MAX) - DRIFT).clamp(0.0, SUM_MAX);
        }
        self.sum
    }
}

/// Bins of 62.5 Hz: 62.5 to 1000 Hz, where fingers resonate.
const BAND: std::ops::RangeInclusive<usize> = 1..=16;
/// Share of a new frame in the envelope: 8 frames, 33 ms.
const SMOOTHING: f64 = 1.0 / 8.0;
/// ON threshold over OFF threshold, power.
const HYSTERESIS: f64 = 2.0;

/// `band-pass`: power in a band, g², ON above a threshold, OFF below half of it; after Romeo et al. (2017),
/// who band-pass, rectify and threshold a tactile signal into an ON/OFF slip flag.
///
/// Hysteresis without a state that depends on the threshold: a flag with threshold θ is up now if the power
/// was above θ at some time and has stayed at θ/2 or more since. The largest such θ is
/// `score = max(power, min(score before, 2 · power))`, so comparing this score with θ is the hysteresis
/// detector of threshold θ, for every θ at once.
#[derive(Clone, Default)]
pub(crate) struct BandPassScore {
    spectrum: XlSpectrum,
    envelope: f64,
    score: f64,
}

impl SensorScore for BandPassScore {
    fn step(&mut self, episode: &Episode, frame: usize, sensor: usize) -> f64 {
        self.spectrum.push_frame(episode, frame, sensor);
        let power: f64 = self.spectrum.power_g2()[BAND].iter().sum();
        self.envelope += SMOOTHING * (power - self.envelope);
        self.score = with_hysteresis(self.score, self.envelope);
        self.score
    }
}

fn with_hysteresis(before: f64, power: f64) -> f64 {
    power.max(before.min(HYSTERESIS * power))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_score_is_the_hysteresis_detector_at_every_threshold() {
        let powers = [0.1, 3.0, 1.6, 1.4, 2.9, 0.2, 5.0, 2.6, 2.4, 1.3, 1.1, 0.0, 4.0];
        let mut flags_up = 0;
        for threshold in [0.5, 1.0, 1.5, 2.0, 2.5, 3.5, 4.5, 6.0] {
            let (mut score, mut on) = (0.0, false);
            for power in powers {
                score = with_hysteresis(score, power);
                on = power > threshold || on && power > threshold / HYSTERESIS;
                assert_eq!(score > threshold, on, "threshold {threshold}, power {power}, score {score}");
                flags_up += usize::from(on && power <= threshold);
            }
        }
        assert!(flags_up >= 5, "hysteresis held the flag up {flags_up} times");
    }
}
