//! Step 3 with the feature `cmsis-dsp`: the window, and the 128-point real FFT of Arm's CMSIS-DSP, `arm_rfft_q31`.
//! A Cortex-M runs the library itself, anything else [`port`], with the same bits (`cargo xtask test --only qemu-cmsis`).
//! For those whose firmware has CMSIS-DSP in it anyway: [`super::fft`] takes fewer instructions and is 10 dB more
//! accurate, and the library's initialisation refers to the tables of every length, 136 KB of flash.
//!
//! The library divides by 16, 4 and 1 before its three stages and by 2 after them, and it truncates where it divides
//! or multiplies by a twiddle factor. So accuracy depends on how much of Q31 its input fills:
//!
//! - One bit of the input is 79,500 LSB · 1.0096 / 2^31 for any signal. A scale that follows the signal would keep
//!   about 127 dB at every level, for another pass over the window; at 10 LSB, where the sensor's own rounding is at
//!   28 dB, 58 dB lose nothing.
//! - Σ|z| over the 64 pairs is at most √2 · 32 under the Hann window: after its stages the library's values stay
//!   below 0.71 of the range, as the real input stays below 0.991.
//! - The four bits that the first stage drops are rounded here, which keeps their mean out of bin 0.
//!
//! The bits are those of CMSIS-DSP 1.10.3 from its C source. The library of CMSIS 5.7.0 that the crate's build script
//! downloads has the same steps; its tables were not compared, and it has not been run.

#[cfg(target_arch = "arm")]
mod library;
pub mod port;
mod tables;

/// The spectrum of Q31 samples, over 128: 128 bins, real and imaginary part alternating. Overwrites the samples.
#[cfg(target_arch = "arm")]
pub use library::rfft;
/// The spectrum of Q31 samples, over 128: 128 bins, real and imaginary part alternating. Overwrites the samples.
#[cfg(not(target_arch = "arm"))]
pub use port::rfft;

use super::fft::Complex;
use super::highpass::FILTERED_FRAC_BITS;
use crate::fixed::scale_q32;
use crate::params::{FFT_BINS, XL_WINDOW};
use tables::HANN_GAIN_Q31;

/// Fraction bits of the spectrum, in √(3/2) LSB.
pub const SPECTRUM_FRAC_BITS: u32 = 8;
/// log2 of the square of that unit, 3/2, over that of [`super::power`], 3/4.
pub const POWER_SHIFT: u32 = 1;
/// Shift of the windowed signal, so that it fills the 32 bits.
const WINDOWED_SHIFT: u32 = 2;
/// Bits of its input that the library drops first.
const DROPPED: u32 = 4;
// The window's product has 32 fraction bits less 31, and the FFT divides by 128.
const _: () = assert!(FILTERED_FRAC_BITS + 31 - 32 + WINDOWED_SHIFT - 7 == SPECTRUM_FRAC_BITS);

/// Scratch.
#[derive(Clone, Debug)]
pub struct Work {
    samples: [i32; XL_WINDOW],
    spectrum: [i32; 2 * XL_WINDOW],
}

impl Default for Work {
    fn default() -> Self {
        Self { samples: [0; XL_WINDOW], spectrum: [0; 2 * XL_WINDOW] }
    }
}

/// As [`super::fft::windowed_fft`], in √(3/2) LSB, Q8; signal to noise 127, 91 and 58 dB at full scale, 500 and
/// 10 LSB.
#[inline]
pub fn windowed_fft(x: &[i32; XL_WINDOW], work: &mut Work, mut take: impl FnMut(usize, Complex)) {
    let Work { samples, spectrum } = work;
    window(x, samples);
    rfft(samples, spectrum);
    for (bin, &[re, im]) in spectrum.as_chunks().0.iter().take(FFT_BINS).enumerate() {
        take(bin, Complex { re, im });
    }
}

/// The windowed signal as the library takes it, Q31 of 79,500 LSB and a little more.
#[inline]
pub fn window(x: &[i32; XL_WINDOW], samples: &mut [i32; XL_WINDOW]) {
    // Half of what is dropped, which rounds.
    const HALF: i32 = 1 << (DROPPED - 1);
    for ((sample, &x), &weight) in samples.iter_mut().zip(x).zip(&HANN_GAIN_Q31) {
        *sample = (scale_q32(x, weight) << WINDOWED_SHIFT) + HALF;
    }
}
