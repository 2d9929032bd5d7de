//! `flux-cusum`: one-sided CUSUM on the spectral flux of the accelerometer.
//!
//! Flux of a frame: mean over the 26 mel filters of how far the log power is above that sensor's running
//! reference spectrum (exponential, 1 s), rises only: spectral flux with a slow reference, so that it
//! lasts as long as the slip does. It is measured in spreads z of its running median ([`super::running`]);
//! the sum grows by z − 1 per frame, z held to at most 10, and stays between 0 and 50, so that it is back
//! within a quarter of a second after the vibration ends. The score is the largest sum of all sensors; the
//! threshold is fitted on train.

use slipsense::params::FRAME_RATE_HZ;
use slipsense_recording::Episode;

use super::PerSensor;
use super::ear::Ear;
use super::mel::{FILTERS, log_mel};
use super::running::Running;
use super::threshold::Score;

/// Share of a new frame in the reference spectrum: a time constant of 1 s.
const REFERENCE_SHARE: f64 = 1.0 / FRAME_RATE_HZ as f64;
/// Taken off every frame, spreads.
const DRIFT: f64 = 1.0;
const STEP_MAX: f64 = 10.0;
const SUM_MAX: f64 = 50.0;

#[derive(Clone)]
struct Sensor {
    ear: Ear,
    reference: Option<[f64; FILTERS]>,
    running: Running,
    sum: f64,
}

pub(crate) struct FluxCusumScore {
    sensors: PerSensor<Sensor>,
}

impl FluxCusumScore {
    pub(crate) const fn new() -> Self {
        Self { sensors: PerSensor::new() }
    }
}

impl Sensor {
    fn new() -> Self {
        Self { ear: Ear::new(), reference: None, running: Running::default(), sum: 0.0 }
    }

    fn step(&mut self) -> f64 {
        let spectrum = log_mel(&self.ear.power_g2());
        let reference = self.reference.get_or_insert(spectrum);
        let mut flux = 0.0;
        for (reference, now) in reference.iter_mut().zip(spectrum) {
            flux += (now - *reference).max(0.0) / FILTERS as f64;
            *reference += REFERENCE_SHARE * (now - *reference);
        }
        if let Some(normal) = self.running.step(flux) {
            let z = ((flux - normal.median) / normal.mad).min(STEP_MAX);
            self.sum = (self.sum + z - DRIFT).clamp(0.0, SUM_MAX);
        }
        self.sum
    }
}

impl Score for FluxCusumScore {
    fn step(&mut self, episode: &Episode, frame: usize) -> f32 {
        let sensors = self.sensors.of(episode.sensors, Sensor::new);
        let mut largest = 0f64;
        for (index, sensor) in sensors.iter_mut().enumerate() {
            sensor.ear.listen_to(episode, frame, index);
            largest = largest.max(sensor.step());
        }
        largest as f32
    }

    fn reset(&mut self) {
        self.sensors.clear();
    }
}
