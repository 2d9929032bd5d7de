//! Creep: the conductance of a loaded film rises by some per cent per decade of time.
//!
//! Printed force sensors are specified at 3–5 % per decade. Five first-order terms, one per decade of time
//! constant, each of the same weight: their sum rises by that weight per decade from 0.01 to 100 s. A term falls more slowly than it rises. The terms are
//! contacts between film and electrode that a lasting load has added: they conduct as far as the load
//! presses them, and of those beyond the present load only the residual share still touches. A film that
//! is let go therefore returns to almost nothing at once, and to nothing over seconds to minutes.

use libm::exp;
use serde::Serialize;

pub const TERMS: usize = 5;
/// Time constants of the terms under load, seconds.
pub const TAU_S: [f64; TERMS] = [0.01, 0.1, 1.0, 10.0, 100.0];

#[derive(Clone, Copy, Debug, Serialize)]
pub struct Creep {
    /// Rise per decade of time, share of the pressure.
    pub per_decade: f64,
    /// Factor on the time constants while a term falls; above 1.
    pub slowdown: f64,
    /// Share of what exceeds the present load that still conducts.
    pub residual: f64,
}

/// What one step of `dt` leaves of the distance to the load, per term.
pub struct Blend {
    rise: [f64; TERMS],
    fall: [f64; TERMS],
}

impl Creep {
    pub fn blend(&self, dt: f64) -> Blend {
        Blend {
            rise: TAU_S.map(|tau| 1.0 - exp(-dt / tau)),
            fall: TAU_S.map(|tau| 1.0 - exp(-dt / (tau * self.slowdown))),
        }
    }

    /// One step of the terms under `kpa`; returns what creep adds to the pressure, kPa.
    #[inline]
    pub fn step(&self, terms: &mut [f64; TERMS], kpa: f64, blend: &Blend) -> f64 {
        let (mut sum, mut beyond) = (0.0, 0.0);
        for ((term, rise), fall) in terms.iter_mut().zip(blend.rise).zip(blend.fall) {
            let distance = kpa - *term;
            *term += if distance > 0.0 { rise } else { fall } * distance;
            sum += *term;
            beyond += if *term > kpa { *term - kpa } else { 0.0 };
        }
        self.per_decade * (sum - (1.0 - self.residual) * beyond)
    }
}
