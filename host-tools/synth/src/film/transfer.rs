//! Conductance over pressure, and the counts a divider makes of it.
//!
//! The film conducts as `G = G₀ + k·pᵐ`. Each taxel is in series with a fixed resistor `1/G_ref`, so that
//! the reading is `x/(1+x)` of its asymptote with `x = G/G_ref`. Two demands meet in the choice of
//! numbers: at least 5 counts per kPa for light grips and 4095 counts at 5 MPa. A power below one with
//! its pivot at the pressure where the divider stands at half ([`HALF_KPA`]) gives both: below the pivot
//! the power only lifts the curve (`(p/pivot)ᵐ > p/pivot`), so the gain of the exponent 1 is the lowest
//! there is, and the divider's asymptote is set so that the nominal film ends at 4095. `G₀`, the leakage
//! of an untouched taxel, is under one count, where the divider is linear; it is added as counts
//! (`FilmUnit::offset`).

use libm::pow;
use slipsense::params::COUNT_MAX;

/// Pressure at which the divider stands at half of its asymptote: `x = 1`.
pub const HALF_KPA: f64 = 900.0;
/// Pressure of full scale (paper, section 3: 0–5 MPa).
pub const FULL_SCALE_KPA: f64 = 5_000.0;
/// Exponent of the nominal film; with ±0.05 from unit to unit within the 0.7–1.0 of printed piezoresistive films.
pub const EXPONENT: f64 = 0.92;

/// Conductance in units of the divider's reference.
pub fn conductance(kpa: f64, exponent: f64) -> f64 {
    pow(kpa / HALF_KPA, exponent)
}

/// Pressure that the nominal film takes for a count, kPa; counts of the linear range's end and above as 4095.
pub fn pressure_kpa(count: f64) -> f64 {
    let count = count.min(COUNT_MAX.into());
    HALF_KPA * pow(count / (asymptote_counts() - count), 1.0 / EXPONENT)
}

/// Counts at infinite conductance: the divider is dimensioned for the nominal film's full scale.
pub fn asymptote_counts() -> f64 {
    COUNT_MAX as f64 * (1.0 + 1.0 / conductance(FULL_SCALE_KPA, EXPONENT))
}

/// Counts of a taxel of gain 1 under a steady pressure, before ADC, noise and crosstalk.
#[cfg(test)]
pub fn counts(kpa: f64, exponent: f64) -> f64 {
    let x = conductance(kpa, exponent);
    asymptote_counts() * x / (1.0 + x)
}
