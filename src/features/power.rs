//! Step 4: power, summed over the axes. The sum does not change when the accelerometer is rotated, and
//! it makes one mel bank and one logarithm do for three axes.

use super::fft::{Complex, SPECTRUM_FRAC_BITS};
use crate::params::FFT_BINS;

/// Fraction bits of the power, in LSB².
pub const POWER_FRAC_BITS: u32 = 2 * SPECTRUM_FRAC_BITS;

/// Add `|X|²` of one axis, in LSB², Q16, to each bin.
///
/// A bin is at most 64 · 79,500 LSB, so three axes stay below 2^62.2. By Parseval all of bins 1 to 63
/// together stay below 64 · Σ(x·w)² ≤ 64 · 48 · 79,500² LSB² per axis: 2^61.8 over three, Q16.
#[inline]
pub fn add_power(power: &mut [u64; FFT_BINS], spectrum: &[Complex; FFT_BINS]) {
    for (power, bin) in power.iter_mut().zip(spectrum) {
        let (re, im) = (bin.re as i64, bin.im as i64);
        *power += (re * re + im * im) as u64;
    }
}
