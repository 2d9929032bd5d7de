//! Vibration of single grains that let go at random slid lengths: an impulse each.

use libm::{exp, pow};
use serde::Serialize;
use slipsense::params::MAX_SENSORS;

use super::scene::SlipSeries;
use super::slip::{LEVEL_G, REFERENCE_MM_S, SILENT_MM_S, from_reference};
use crate::draw::{Draw, Rng};
use crate::friction::STEP_HZ;
use crate::objects::Object;
use crate::timeline::Pulse;

/// The most grains in a second.
const MOST_HZ: f64 = 1_500.0;

#[derive(Serialize)]
pub(super) struct Grains {
    /// Mean slid length between two grains.
    spacing_mm: f64,
    width_s: f64,
    peak_g: f64,
    /// Logarithmic, within a recording.
    peak_spread: f64,
    speed_exponent: f64,
    force_exponent: f64,
    direction: [f64; 3],
}

impl Grains {
    pub fn draw(rng: &mut Rng, object: &Object) -> Self {
        let (spacing_mm, width_s) = (rng.log_between(0.01, 0.25), rng.log_between(0.15e-3, 1.2e-3));
        let peak_spread = rng.between(0.4, 1.2);
        let level = pow(object.roughness_um, 0.4) * exp(0.5 * rng.normal());
        // Mean square of half-sines at the reference: rate · peak² · width / 2, the peak's with its spread.
        let rate = (REFERENCE_MM_S / spacing_mm).min(MOST_HZ);
        let square = rate * width_s / 2.0 * exp(2.0 * peak_spread * peak_spread);
        Self {
            spacing_mm,
            width_s,
            peak_g: LEVEL_G * level / square.sqrt(),
            peak_spread,
            speed_exponent: rng.between(0.0, 0.8),
            force_exponent: rng.between(0.2, 0.8),
            direction: rng.direction(),
        }
    }

    pub fn pulses(&self, rubbing: &SlipSeries, rng: &mut Rng) -> Vec<Pulse> {
        let mut pulses = Vec::new();
        let mut left_mm = 0.0;
        for (i, (&speed, &share)) in rubbing.speed_mm_s.iter().zip(&rubbing.fraction).enumerate() {
            if speed < SILENT_MM_S || share < 1e-3 {
                continue;
            }
            let (moved_mm, mut at_mm) = (speed / STEP_HZ, left_mm);
            let spacing_mm = self.spacing_mm.max(speed / MOST_HZ);
            let exponents = (self.speed_exponent, self.force_exponent);
            let level = from_reference(share * self.peak_g, (speed, rubbing.grip_n[i]), exponents);
            while at_mm < moved_mm {
                let scatter = rng.direction();
                let direction = std::array::from_fn(|axis| self.direction[axis] + 0.6 * scatter[axis]);
                pulses.push(Pulse {
                    at_s: (i as f64 + at_mm / moved_mm) / STEP_HZ,
                    width_s: self.width_s * exp(0.3 * rng.normal()),
                    peak_g: level * exp(self.peak_spread * rng.normal()),
                    direction: rubbing.turned(i, direction),
                    share: [1.0; MAX_SENSORS],
                });
                at_mm += spacing_mm * rng.exponential(1e-6);
            }
            left_mm = at_mm - moved_mm;
        }
        pulses
    }
}
