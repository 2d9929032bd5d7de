//! `band-pass`: power in a band, ON above a threshold, OFF below half of it; after Romeo et al. (2017),
//! who band-pass, rectify and threshold a tactile signal into an ON/OFF slip flag.
//!
//! Power of the accelerometer from 62.5 to 1000 Hz, where fingers ring; in g², smoothed over 8 frames
//! (exponential, 33 ms) as their envelope is. Hysteresis of a factor of two in power.
//!
//! Hysteresis without a state that hangs on the threshold: a flag with threshold θ is up now if the power
//! was above θ at some time and has stayed at θ/2 or more since. The largest such θ is
//! `score = max(power, min(score before, 2 · power))`, so comparing this score with θ is the hysteresis
//! detector of threshold θ, for every θ at once.

use slipsense_recording::Episode;

use super::PerSensor;
use super::ear::Ear;
use super::threshold::Score;

/// Bins of 62.5 Hz: 62.5 to 1000 Hz.
const BAND: std::ops::RangeInclusive<usize> = 1..=16;
/// Share of a new frame in the envelope.
const SMOOTHING: f64 = 1.0 / 8.0;
/// ON threshold over OFF threshold, power.
const HYSTERESIS: f64 = 2.0;

#[derive(Clone)]
struct Sensor {
    ear: Ear,
    envelope: f64,
    score: f64,
}

pub(crate) struct BandPassScore {
    sensors: PerSensor<Sensor>,
}

impl BandPassScore {
    pub(crate) const fn new() -> Self {
        Self { sensors: PerSensor::new() }
    }
}

impl Score for BandPassScore {
    fn step(&mut self, episode: &Episode, frame: usize) -> f32 {
        let fresh = || Sensor { ear: Ear::new(), envelope: 0.0, score: 0.0 };
        let mut largest = 0f64;
        for (index, sensor) in self.sensors.of(episode.sensors, fresh).iter_mut().enumerate() {
            sensor.ear.listen_to(episode, frame, index);
            let power: f64 = sensor.ear.power_g2()[BAND].iter().sum();
            sensor.envelope += SMOOTHING * (power - sensor.envelope);
            sensor.score = with_hysteresis(sensor.score, sensor.envelope);
            largest = largest.max(sensor.score);
        }
        largest as f32
    }

    fn reset(&mut self) {
        self.sensors.clear();
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
