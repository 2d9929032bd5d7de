//! Step 3: the Hann window and the 128-point real FFT, as a 64-point complex one (three radix-4 stages) and a
//! split.
//!
//! 32-bit data with all the fraction bits that each stage has room for: a quiet slip of 4 mg is some ten LSB beside
//! full-scale transients. As sums grow, bits are dropped in the product with a twiddle factor, at no cost: the
//! Cortex-M7 takes the rounded upper half of a product in one instruction, and the scale of the twiddle decides what
//! that is. With |x| ≤ 79,500 LSB under the Hann window, whose weights at a distance of 32 samples sum to 2:
//!
//! | after stage | values are sums of | largest magnitude, LSB | fraction bits | largest `i32` |
//! |---|---|---|---|---|
//! | 1 | 4 packed samples | √2 · 2 · 79,500 | 13 | 0.86 · 2^31 |
//! | 2 | 16 | 4 times that | 11 and the gain | 0.991 · 2^31 |
//! | 3 | 64 | 16 times that | 9 and the gain | 0.991 · 2^31 |
//! | split, even or odd half | 64 samples, weights summing to 32 | 32 · 79,500 | 9 and the gain | 0.70 · 2^31 |
//! | spectrum | both | 64 · 79,500 | 8 and the gain | 0.70 · 2^31 |
//!
//! The gain, √(4/3), uses the rest of the range, up to [`super::power`]. Rounding adds some tens of units, so nothing
//! leaves `i32`. The stages decimate in time, so the bins come out in order.
//!
//! The feature `cmsis-dsp` replaces it by the q31 FFT of CMSIS-DSP, with the same window and largest sample: two thirds
//! more instructions and 11 dB more noise. `cargo xtask bench --only kernels` counts ours, `tests/features.rs` prints the
//! noise.

use super::highpass::FILTERED_FRAC_BITS;
use super::tables::{COS_128_Q31, GAIN_TWIDDLE_16_Q30, HANN_Q31, TWIDDLE_64_Q30};
use crate::fixed::{mean, round_shift, scale_q32};
use crate::params::XL_WINDOW;

/// Fraction bits of the spectrum, in √(3/4) LSB.
pub const SPECTRUM_FRAC_BITS: u32 = 8;
/// The square of that unit is the unit of [`super::power`].
pub const POWER_SHIFT: u32 = 0;
/// Bits dropped before the second and before the third stage: 32 less the fraction bits of the twiddles.
const DROP: u32 = 32 - 30;
/// Fraction bits of the windowed signal: what the first stage has room for.
const WINDOWED_FRAC_BITS: u32 = FILTERED_FRAC_BITS + 31 - 32;
const _: () = assert!(WINDOWED_FRAC_BITS - 2 * DROP - 1 == SPECTRUM_FRAC_BITS);
const HALF: usize = XL_WINDOW / 2;

/// `exp(-2πi·k/128)` as cosine and sine, Q31, for k = 1 to 31.
static TWIDDLE_128_Q31: [[i32; 2]; HALF / 2 - 1] = {
    let mut twiddles = [[0; 2]; HALF / 2 - 1];
    let mut at = 0;
    while at < twiddles.len() {
        twiddles[at] = [COS_128_Q31[at], COS_128_Q31[twiddles.len() - 1 - at]];
        at += 1;
    }
    twiddles
};

/// A complex number; the scale depends on the stage.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[expect(missing_docs, reason = "the parts")]
pub struct Complex {
    pub re: i32,
    pub im: i32,
}

/// Scratch.
pub type Work = [[[Complex; 4]; 4]; 4];

impl Complex {
    #[inline]
    fn add(self, other: Self) -> Self {
        Self { re: self.re + other.re, im: self.im + other.im }
    }

    #[inline]
    fn sub(self, other: Self) -> Self {
        Self { re: self.re - other.re, im: self.im - other.im }
    }

    /// Times a twiddle factor `re − i·im`, less [`DROP`] fraction bits.
    #[inline]
    fn rotated(self, [re, im]: [i32; 2]) -> Self {
        let real = self.re as i64 * re as i64 + self.im as i64 * im as i64;
        let imaginary = self.im as i64 * re as i64 + -self.re as i64 * im as i64;
        Self { re: round_shift(real, 32) as i32, im: round_shift(imaginary, 32) as i32 }
    }

    /// As [`Self::rotated`], with half the work: each of the two products of a part rounds. For the second stage,
    /// whose last bit is a quarter of the third's.
    #[inline]
    fn rotated_fast(self, [re, im]: [i32; 2]) -> Self {
        Self {
            re: scale_q32(self.re, re) + scale_q32(self.im, im),
            im: scale_q32(self.im, re) - scale_q32(self.re, im),
        }
    }

    /// Times a real factor, less [`DROP`] fraction bits.
    #[inline]
    fn scaled(self, factor: i32) -> Self {
        Self { re: scale_q32(self.re, factor), im: scale_q32(self.im, factor) }
    }

    /// Less [`DROP`] fraction bits: what [`Self::rotated`] does for a twiddle factor of 1.
    #[inline]
    fn dropped(self) -> Self {
        const HALF: i32 = 1 << (DROP - 1);
        Self { re: (self.re + HALF) >> DROP, im: (self.im + HALF) >> DROP }
    }
}

/// Four-point transform.
#[inline]
fn butterfly([a, b, c, d]: [Complex; 4]) -> [Complex; 4] {
    let (even, even_rest) = (a.add(c), a.sub(c));
    let (odd, odd_rest) = (b.add(d), b.sub(d));
    // Times −i, exact.
    let turned = Complex { re: odd_rest.im, im: -odd_rest.re };
    [even.add(odd), even_rest.add(turned), even.sub(odd), even_rest.sub(turned)]
}

/// Butterflies over four quarters of a block, element by element, after `rotate` with its row of `twiddles`.
#[inline]
fn stage<'t, Row: 't>(
    quarters: [&mut [Complex]; 4],
    twiddles: &'t [Row],
    rotate: impl Fn([Complex; 4], &'t Row) -> [Complex; 4],
) {
    let [a, b, c, d] = quarters;
    for ((((a, b), c), d), row) in a.iter_mut().zip(b).zip(c).zip(d).zip(twiddles) {
        [*a, *b, *c, *d] = butterfly(rotate([*a, *b, *c, *d], row));
    }
}

/// The discrete Fourier transform `Σ w[n]·x[n]·exp(−2πi·k·n/128)` under a periodic Hann window, in √(3/4) LSB, Q8:
/// hands each of the bins 0 to 64 to `take` once, in no order.
///
/// Input: LSB in Q14, at most [`super::highpass::FILTERED_MAX`] in magnitude. Signal to noise, window included,
/// over tones in steps of a tenth of a bin: 138 dB or more at full scale, 102 dB at 500 LSB, 69 dB at 10 LSB.
#[inline]
pub fn windowed_fft(x: &[i32; XL_WINDOW], work: &mut Work, mut take: impl FnMut(usize, Complex)) {
    packed_fft(x, work);
    let z = work.as_flattened().as_flattened();
    let [zero, middle] = [z[0], z[HALF / 2]];
    take(0, Complex { re: mean(zero.re, zero.im), im: 0 });
    take(HALF / 2, Complex { re: mean(middle.re, 0), im: mean(-middle.im, 0) });
    take(HALF, Complex { re: mean(zero.re, -zero.im), im: 0 });
    for (k, &twiddle) in (1..HALF / 2).zip(&TWIDDLE_128_Q31) {
        let (low, high) = split(z[k], z[HALF - k], twiddle);
        take(k, low);
        take(HALF - k, high);
    }
}

/// The transform of the complex signal (w·x[2n], w·x[2n+1]), Q9; bin k0 + 4·k1 + 16·k2 comes to [k2][k1][k0].
fn packed_fft(x: &[i32; XL_WINDOW], z: &mut Work) {
    let windowed = |n: usize| scale_q32(x[n], HANN_Q31[n]);
    let sample = |n: usize| Complex { re: windowed(2 * n), im: windowed(2 * n + 1) };
    // With n = n0 + 4·n1 + 16·n2 the place is [n0][n1][k0] after stage 1 and [n0][k1][k0] after 2.
    for (n0, block) in z.iter_mut().enumerate() {
        for (n1, place) in block.iter_mut().enumerate() {
            let n = n0 + 4 * n1;
            *place = butterfly([sample(n), sample(n + 16), sample(n + 32), sample(n + 48)]);
        }
    }
    for [a, b, c, d] in z.iter_mut() {
        stage([a, b, c, d], &GAIN_TWIDDLE_16_Q30, |[a, b, c, d], &(gain, [w1, w2, w3])| {
            [a.scaled(gain), b.rotated_fast(w1), c.rotated_fast(w2), d.rotated_fast(w3)]
        });
    }
    let [a, b, c, d] = z.each_mut().map(|block| block.as_flattened_mut());
    stage([a, b, c, d], &TWIDDLE_64_Q30, |[a, b, c, d], &[w1, w2, w3]| {
        [a.dropped(), b.rotated(w1), c.rotated(w2), d.rotated(w3)]
    });
}

/// Bins k and 64−k of the real signal, Q8, from bins k and 64−k of the packed one, Q9.
///
/// `even` and `odd` are the spectrum of the even samples and of the odd ones. The last bit is dropped behind their
/// sum, with the twiddle; of bin 64−k it is the conjugate that rounds.
#[inline]
fn split(z: Complex, mirror: Complex, [re, im]: [i32; 2]) -> (Complex, Complex) {
    // Times −i.
    let odd = Complex { re: mean(z.im, mirror.im), im: mean(mirror.re, -z.re) };
    let real = odd.re as i64 * re as i64 + odd.im as i64 * im as i64;
    let imaginary = odd.im as i64 * re as i64 - odd.re as i64 * im as i64;
    // Twice the even part, so over 2^31, and the half that rounds.
    let even_re = ((z.re as i64 + mirror.re as i64) << 30) + (1 << 31);
    let even_im = ((z.im as i64 - mirror.im as i64) << 30) + (1 << 31);
    let upper = |x: i64| (x >> 32) as i32;
    (
        Complex { re: upper(even_re + real), im: upper(even_im + imaginary) },
        Complex { re: upper(even_re - real), im: -upper(even_im - imaginary) },
    )
}
