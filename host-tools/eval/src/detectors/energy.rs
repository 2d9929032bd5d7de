//! `energy`: how many spreads the vibration energy is above its running median, the plain threshold rule
//! of vibration-based slip detection.
//!
//! Energy is the mean square of the last 128 high-passed samples over all axes; median and median
//! absolute deviation run over the last 8 s of the sensor ([`super::running`]), silent in the first half
//! second. The score is (energy − median) / MAD, the largest of all sensors; the threshold k is fitted on
//! train.

use slipsense_recording::Episode;

use super::PerSensor;
use super::ear::Ear;
use super::running::Running;
use super::threshold::Score;

pub(crate) struct EnergyScore {
    sensors: PerSensor<(Ear, Running)>,
}

impl EnergyScore {
    pub(crate) const fn new() -> Self {
        Self { sensors: PerSensor::new() }
    }
}

impl Score for EnergyScore {
    fn step(&mut self, episode: &Episode, frame: usize) -> f32 {
        let sensors = self.sensors.of(episode.sensors, || (Ear::new(), Running::default()));
        let mut largest = f64::MIN;
        for (sensor, (ear, running)) in sensors.iter_mut().enumerate() {
            ear.listen_to(episode, frame, sensor);
            let energy = ear.mean_square_g2();
            let score = running.step(energy).map_or(0.0, |normal| (energy - normal.median) / normal.mad);
            largest = largest.max(score);
        }
        largest.min(f64::from(f32::MAX)) as f32
    }

    fn reset(&mut self) {
        self.sensors.clear();
    }
}
