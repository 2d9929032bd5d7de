//! Conductance over pressure of the nominal film, and the count that the firmware's law makes of it.
//!
//! The film conducts as `G = k·pᵐ`, and the front end's reading is linear in it. The law from codes to counts
//! (`slipsense::transfer`) bends as `x/(1+x)`, `x` being 1 at [`HALF_KPA`]: a light grip gets at least 5 counts per
//! kPa, and 5 MPa is 4095.

use std::sync::LazyLock;

use libm::pow;
use slipsense::params::COUNT_MAX;

/// Pressure at which the law from codes to counts stands at half of its asymptote: `x = 1`.
pub const HALF_KPA: f64 = 900.0;
/// Pressure of full scale (paper, section 3: 0–5 MPa).
pub const FULL_SCALE_KPA: f64 = 5_000.0;
/// Exponent of the nominal film; with ±0.05 from unit to unit within the 0.7–1.0 of printed piezoresistive films.
pub const EXPONENT: f64 = 0.92;

/// Conductance in units of that at [`HALF_KPA`].
pub fn conductance(kpa: f64, exponent: f64) -> f64 {
    pow(kpa / HALF_KPA, exponent)
}

/// The same, share of the nominal film's at full scale.
pub fn share(kpa: f64, exponent: f64) -> f64 {
    conductance(kpa, exponent) / conductance(FULL_SCALE_KPA, EXPONENT)
}

/// Pressure that the nominal film takes for each count, 0 to 4095, kPa.
pub static PRESSURE_KPA: LazyLock<Vec<f32>> =
    LazyLock::new(|| (0..=COUNT_MAX).map(|count| pressure_kpa(count.into()) as f32).collect());

/// Pressure that the nominal film takes for a count, kPa; counts above 4095 as 4095.
pub fn pressure_kpa(count: f64) -> f64 {
    let count = count.min(COUNT_MAX.into());
    HALF_KPA * pow(count / (asymptote_counts() - count), 1.0 / EXPONENT)
}

/// Counts at infinite conductance, so that the nominal film has 4095 at full scale.
pub fn asymptote_counts() -> f64 {
    COUNT_MAX as f64 * (1.0 + 1.0 / conductance(FULL_SCALE_KPA, EXPONENT))
}

/// Counts of a taxel of gain 1 under a steady pressure, without noise and crosstalk.
pub fn counts(kpa: f64, exponent: f64) -> f64 {
    let x = conductance(kpa, exponent);
    asymptote_counts() * x / (1.0 + x)
}
