//! Step 4: power, summed over the axes. The sum does not change when the accelerometer is rotated, and
//! it makes one mel bank and one logarithm do for three axes.

/// The window and FFT in use.
#[cfg(feature = "cmsis-dsp")]
pub use super::cmsis as transform;
/// The window and FFT in use.
#[cfg(not(feature = "cmsis-dsp"))]
pub use super::fft as transform;

use crate::params::{FFT_BINS, XL_WINDOW};
use transform::{POWER_SHIFT, SPECTRUM_FRAC_BITS, Work, windowed_fft};

/// Fraction bits of the power, here in 3/4 LSB² for the gain of the FFT, behind the mel triangles in LSB².
pub const POWER_FRAC_BITS: u32 = 2 * SPECTRUM_FRAC_BITS;

/// Add the power spectrum of the latest samples of one axis, in 3/4 LSB², Q16, to each bin.
///
/// A bin is at most 64 · 79,500 · √(4/3) of these units, so three axes stay below 2^62.6. By Parseval all of bins 1
/// to 63 together stay below 64 · Σ(x·w)² · 4/3 ≤ 64 · 48 · 79,500² · 4/3 per axis: 2^62.3 over three, Q16.
#[inline]
pub fn add_power(power: &mut [u64; FFT_BINS], samples: &[i32; XL_WINDOW], work: &mut Work) {
    windowed_fft(samples, work, |bin, value| {
        let (re, im) = (value.re as i64, value.im as i64);
        power[bin] += ((re * re + im * im) as u64) << POWER_SHIFT;
    });
}
