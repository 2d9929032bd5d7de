//! `arm_rfft_q31` of length 128, forward, in Rust: the steps of CMSIS-DSP's C code for cores without vector
//! instructions, every shift and every rounding, so that the bits are the same.
//!
//! A 64-point complex FFT over pairs of samples, three radix-4 stages that decimate in frequency, and a split. Sums
//! wrap as the C code's do once compiled; below the bound in [`super::windowed_fft`] none does.

use super::tables::COS_64_Q31;
use crate::features::fft::Complex;
use crate::features::tables::HANN_Q31;
use crate::params::XL_WINDOW;

const HALF: usize = XL_WINDOW / 2;
/// Bits of the index of a bin of the complex FFT.
const INDEX_BITS: u32 = HALF.trailing_zeros();

/// The spectrum of Q31 samples, over 128: 128 bins, real and imaginary part alternating.
pub fn rfft(samples: &mut [i32; XL_WINDOW], spectrum: &mut [i32; 2 * XL_WINDOW]) {
    let z = complex_fft(samples);
    for k in 1..HALF {
        // With a = 2πk/128: (1 − sin a)/2, −cos a/2 and (1 + sin a)/2, from the window, which is (1 − cos a)/2.
        let hann = |n: usize| HANN_Q31[n % XL_WINDOW];
        let [a1, a2, b1] = [hann(k + 96), hann(k) - (1 << 30), hann(k + 32)];
        let (low, high) = (z[k], z[HALF - k]);
        let (mut re, mut im) = (add_product(0, low.re, a1), add_product(0, low.re, a2));
        re = subtract_product(re, low.im, a2);
        im = add_product(im, low.im, a1);
        re = subtract_product(re, high.im, a2);
        im = subtract_product(im, high.im, b1);
        re = add_product(re, high.re, b1);
        im = subtract_product(im, high.re, a2);
        put(spectrum, k, re, im);
        put(spectrum, XL_WINDOW - k, re, im.wrapping_neg());
    }
    put(spectrum, 0, z[0].re.wrapping_add(z[0].im) >> 1, 0);
    put(spectrum, HALF, z[0].re.wrapping_sub(z[0].im) >> 1, 0);
}

fn put(spectrum: &mut [i32; 2 * XL_WINDOW], bin: usize, re: i32, im: i32) {
    [spectrum[2 * bin], spectrum[2 * bin + 1]] = [re, im];
}

/// `arm_cfft_q31` of length 64: the spectrum over 64, in order.
fn complex_fft(samples: &[i32; XL_WINDOW]) -> [Complex; HALF] {
    let mut z: [Complex; HALF] =
        core::array::from_fn(|n| Complex { re: samples[2 * n], im: samples[2 * n + 1] });
    // With n = n1 + 16·n2: the sums are over n2, and each of the outer two stages divides by more than it adds.
    for n in 0..HALF / 4 {
        let place = |quarter: usize| n + HALF / 4 * quarter;
        let quarters = [0, 1, 2, 3].map(|quarter| each(z[place(quarter)], |x| x >> 4));
        for (quarter, (value, multiple)) in butterfly(quarters).into_iter().zip([0, 2, 1, 3]).enumerate() {
            z[place(quarter)] = match multiple {
                0 => value,
                m => each(half_rotated(value, twiddle(m * n)), |x| x << 1),
            };
        }
    }
    for block in z.as_chunks_mut::<{ HALF / 4 }>().0 {
        for n in 0..HALF / 16 {
            let place = |quarter: usize| n + HALF / 16 * quarter;
            let quarters = [0, 1, 2, 3].map(|quarter| block[place(quarter)]);
            for (quarter, (value, multiple)) in butterfly(quarters).into_iter().zip([0, 2, 1, 3]).enumerate()
            {
                block[place(quarter)] = match multiple {
                    0 => each(value, |x| x >> 2),
                    m => each(half_rotated(value, twiddle(4 * m * n)), |x| x >> 1),
                };
            }
        }
    }
    for block in z.as_chunks_mut::<4>().0 {
        *block = butterfly(*block);
    }
    // What `butterfly` puts where makes the order of three radix-4 stages the one of six radix-2 stages.
    core::array::from_fn(|k| z[k.reverse_bits() >> (usize::BITS - INDEX_BITS)])
}

/// `exp(−2πi·k/64)` as cosine and sine, Q31, for k up to 47.
fn twiddle(k: usize) -> [i32; 2] {
    let cos = |k: usize| COS_64_Q31[if k <= 32 { k } else { 64 - k }];
    [cos(k), cos(k.abs_diff(16))]
}

/// Four-point transform: bins 0, 2, 1 and 3.
fn butterfly([a, b, c, d]: [Complex; 4]) -> [Complex; 4] {
    let (even, even_rest) = (add(a, c), sub(a, c));
    let (odd, odd_rest) = (add(b, d), sub(b, d));
    // Times −i.
    let turned = Complex { re: odd_rest.im, im: odd_rest.re.wrapping_neg() };
    [add(even, odd), sub(even, odd), add(even_rest, turned), sub(even_rest, turned)]
}

fn add(a: Complex, b: Complex) -> Complex {
    Complex { re: a.re.wrapping_add(b.re), im: a.im.wrapping_add(b.im) }
}

fn sub(a: Complex, b: Complex) -> Complex {
    Complex { re: a.re.wrapping_sub(b.re), im: a.im.wrapping_sub(b.im) }
}

fn each(z: Complex, f: impl Fn(i32) -> i32) -> Complex {
    Complex { re: f(z.re), im: f(z.im) }
}

/// Half of z times a twiddle factor `cos − i·sin`. Each product is truncated, as in the C code.
fn half_rotated(z: Complex, [cos, sin]: [i32; 2]) -> Complex {
    let upper = |x: i32, y: i32| ((x as i64 * y as i64) >> 32) as i32;
    Complex {
        re: upper(z.re, cos).wrapping_add(upper(z.im, sin)),
        im: upper(z.im, cos).wrapping_sub(upper(z.re, sin)),
    }
}

/// `multAcc_32x32_keep32_R`, the instruction `smmlar`.
fn add_product(sum: i32, x: i32, y: i32) -> i32 {
    upper_rounded(((sum as i64) << 32).wrapping_add(x as i64 * y as i64))
}

/// `multSub_32x32_keep32_R`, the instruction `smmlsr`.
fn subtract_product(sum: i32, x: i32, y: i32) -> i32 {
    upper_rounded(((sum as i64) << 32).wrapping_sub(x as i64 * y as i64))
}

fn upper_rounded(x: i64) -> i32 {
    (x.wrapping_add(1 << 31) >> 32) as i32
}
