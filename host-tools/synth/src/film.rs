//! From pressure to ADC counts: piezoresistive film, divider, scan.

use libm::{exp, pow, sin};
use slipsense::params::{COUNT_MAX, FRAME_RATE_HZ, TAXEL_COLS, TAXEL_ROWS, TAXELS};
use slipsense::sensor::{PiezoFrame, active_cols};

use crate::contact::PressureMap;
use crate::draw::{Draw, Rng};
use crate::unit::FilmUnit;

/// Pressure at which the divider stands at half of its asymptote. With full scale at 5 MPa this gives
/// 5.4 counts/kPa at low pressure, so that grips of a newton are far above the contact threshold.
pub const HALF_KPA: f64 = 900.0;
/// Pressure of full scale (paper).
pub const FULL_SCALE_KPA: f64 = 5_000.0;

/// Counts of a nominal taxel: a saturating divider, linear at low pressure.
pub fn counts(kpa: f64) -> f64 {
    let x = kpa / HALF_KPA;
    let full = FULL_SCALE_KPA / HALF_KPA;
    COUNT_MAX as f64 * (1.0 + 1.0 / full) * x / (1.0 + x)
}

/// The array of one sensor over time.
pub(crate) struct Film<'a> {
    unit: &'a FilmUnit,
    rng: Rng,
    /// Pressure as the film follows it.
    follow: Box<[f64; TAXELS]>,
    creep: [Box<[f64; TAXELS]>; 2],
    /// Mains pick-up of the whole array: amplitude in counts, phase step per frame.
    hum: (f64, f64),
}

impl<'a> Film<'a> {
    pub(crate) fn new(unit: &'a FilmUnit, mut rng: Rng) -> Self {
        let hum = (rng.between(0.0, 0.1), std::f64::consts::TAU * 50.0 / FRAME_RATE_HZ as f64);
        Self {
            unit,
            rng,
            follow: Box::new([0.0; TAXELS]),
            creep: std::array::from_fn(|_| Box::new([0.0; TAXELS])),
            hum,
        }
    }

    /// Scan number `frame` of the pressures in `map`. `force_back(s)` is the grip force that long before
    /// the tick relative to the force of `map`: the rows are read one after another, the last at the tick.
    #[expect(clippy::needless_range_loop, reason = "row and column are coordinates of several maps")]
    pub(crate) fn scan(
        &mut self,
        frame: usize,
        map: &PressureMap,
        force_back: impl Fn(f64) -> f64,
    ) -> PiezoFrame {
        let unit = self.unit;
        let dt = 1.0 / FRAME_RATE_HZ as f64;
        let blend = 1.0 - exp(-dt / unit.lag_s);
        let creep_blend = unit.creep.map(|(_, tau)| 1.0 - exp(-dt / tau));
        let mut ideal = [0.0; TAXELS];
        let (mut row_mean, mut col_mean) = ([0.0; TAXEL_ROWS], [0.0; TAXEL_COLS]);
        for row in 0..TAXEL_ROWS {
            let age = unit.scan_s * (TAXEL_ROWS - 1 - row) as f64 / TAXEL_ROWS as f64;
            let scale = force_back(age);
            for col in active_cols(row) {
                let cell = row * TAXEL_COLS + col;
                let p = map.kpa[cell] * scale;
                let follow = &mut self.follow[cell];
                *follow += blend * (p - *follow);
                let mut strained = *follow;
                for ((state, (weight, _)), b) in self.creep.iter_mut().zip(unit.creep).zip(creep_blend) {
                    let state = &mut state[cell];
                    *state += b * (*follow - *state);
                    strained += weight * *state;
                }
                // Below a milli-count there is nothing to see, and the power is the costly part.
                if strained > 1e-3 {
                    let bent = HALF_KPA * pow(strained / HALF_KPA, unit.exponent);
                    ideal[cell] = counts(bent * unit.gain[cell]);
                    row_mean[row] += ideal[cell] / TAXEL_COLS as f64;
                    col_mean[col] += ideal[cell] / TAXEL_ROWS as f64;
                }
            }
        }
        let hum = self.hum.0 * sin(self.hum.1 * frame as f64);
        let mut scan = [0; TAXELS];
        for row in 0..TAXEL_ROWS {
            for col in active_cols(row) {
                let cell = row * TAXEL_COLS + col;
                let leak = unit.crosstalk * (row_mean[row] + col_mean[col]);
                let noise = unit.noise_counts * self.rng.normal();
                let value = ideal[cell] + leak + unit.offset[cell] + hum + noise;
                scan[cell] = value.round().clamp(0.0, COUNT_MAX as f64) as u16;
            }
        }
        PiezoFrame::from_scan(scan)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transfer_is_steep_at_low_pressure_and_full_at_5_mpa() {
        assert!(counts(1.0) >= 5.0, "{} counts at 1 kPa", counts(1.0));
        assert!((counts(FULL_SCALE_KPA) - COUNT_MAX as f64).abs() < 1e-6);
        assert_eq!(counts(0.0), 0.0);
    }
}
