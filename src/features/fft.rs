//! Step 3: the 128-point real FFT, as a 64-point complex one (three radix-4 stages) and a split.
//!
//! 32-bit data with the fraction bits that each stage has room for: a quiet slip of 4 mg is some ten LSB
//! beside full-scale transients, so a bit given away is a bit of slip. As sums grow, bits are dropped
//! where a twiddle factor rounds anyway. With |x| ≤ 79,500 LSB under the Hann window, whose weights at
//! a distance of 32 samples sum to 2:
//!
//! | after stage | values are sums of | largest magnitude, LSB | fraction bits | largest `i32` |
//! |---|---|---|---|---|
//! | 1, before the twiddle | 4 packed samples | √2 · 2 · 79,500 | 13 | 0.86 · 2^31 |
//! | 2, before the twiddle | 16 | 4 times that | 11 | 0.86 · 2^31 |
//! | 3 | 64 | 16 times that | 8 | 0.43 · 2^31 |
//! | split, twice the even or the odd half | 64 samples, weights summing to 32 | 64 · 79,500 | 8 | 0.61 · 2^31 |
//!
//! Rounding adds some tens of units, so nothing leaves `i32`.

use super::ring::WINDOWED_FRAC_BITS;
use super::tables::{TWIDDLE_64_Q30, TWIDDLE_128_Q30};
use crate::fixed::round_shift;
use crate::params::{FFT_BINS, XL_WINDOW};

/// Fraction bits of the spectrum, in LSB.
pub const SPECTRUM_FRAC_BITS: u32 = 8;
const TWIDDLE_FRAC_BITS: u32 = 30;
/// Bits dropped after the first and the second stage.
const DROP_1: u32 = 2;
const DROP_2: u32 = 3;
const _: () = assert!(WINDOWED_FRAC_BITS - DROP_1 - DROP_2 == SPECTRUM_FRAC_BITS);
const HALF: usize = XL_WINDOW / 2;

/// A complex number; the scale depends on the stage.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Complex {
    /// Real part.
    pub re: i32,
    /// Imaginary part.
    pub im: i32,
}

impl Complex {
    #[inline]
    fn add(self, other: Self) -> Self {
        Self { re: self.re + other.re, im: self.im + other.im }
    }

    #[inline]
    fn sub(self, other: Self) -> Self {
        Self { re: self.re - other.re, im: self.im - other.im }
    }

    /// Times −i, exact.
    #[inline]
    fn turned(self) -> Self {
        Self { re: self.im, im: -self.re }
    }

    /// Times a twiddle factor, less `DROP` fraction bits, rounded once.
    #[inline]
    fn rotated<const DROP: u32>(self, [re, im]: [i32; 2]) -> Self {
        let real = self.re as i64 * re as i64 - self.im as i64 * im as i64;
        let imaginary = self.re as i64 * im as i64 + self.im as i64 * re as i64;
        Self {
            re: round_shift(real, TWIDDLE_FRAC_BITS + DROP) as i32,
            im: round_shift(imaginary, TWIDDLE_FRAC_BITS + DROP) as i32,
        }
    }

    /// Less `DROP` fraction bits: what [`Self::rotated`] does for a twiddle factor of 1.
    #[inline]
    fn dropped<const DROP: u32>(self) -> Self {
        Self { re: round_shift(self.re as i64, DROP) as i32, im: round_shift(self.im as i64, DROP) as i32 }
    }
}

/// Four-point transform, decimation in frequency.
#[inline]
fn butterfly(a: Complex, b: Complex, c: Complex, d: Complex) -> [Complex; 4] {
    let (even, even_rest) = (a.add(c), a.sub(c));
    let (odd, odd_rest) = (b.add(d), b.sub(d).turned());
    [even.add(odd), even_rest.add(odd_rest), even.sub(odd), even_rest.sub(odd_rest)]
}

/// Butterflies over four quarters of a block, element by element, each with its row of twiddles.
#[inline]
fn stage<'t, const DROP: u32>(
    quarters: [&mut [Complex]; 4],
    twiddles: impl Iterator<Item = &'t [[i32; 2]; 3]>,
) {
    let [a, b, c, d] = quarters;
    for ((((a, b), c), d), &[w1, w2, w3]) in a.iter_mut().zip(b).zip(c).zip(d).zip(twiddles) {
        let [first, second, third, fourth] = butterfly(*a, *b, *c, *d);
        *a = first.dropped::<DROP>();
        *b = second.rotated::<DROP>(w1);
        *c = third.rotated::<DROP>(w2);
        *d = fourth.rotated::<DROP>(w3);
    }
}

/// Bins 0 to 64 of the discrete Fourier transform `Σ x[n]·exp(−2πi·k·n/128)`, in LSB, Q8.
///
/// Input: a window of [`super::ring::Ring::windowed`], Q13. Signal to noise, window included: 130 dB or
/// more for a tone of full scale, 60 dB for one of 10 LSB.
pub fn real_fft(x: &[i32; XL_WINDOW]) -> [Complex; FFT_BINS] {
    // Sample n of the complex signal is (x[2n], x[2n+1]), at the base-4 digits of n.
    let mut z = [[[Complex::default(); 4]; 4]; 4];
    for (z, pair) in z.as_flattened_mut().as_flattened_mut().iter_mut().zip(x.as_chunks::<2>().0) {
        *z = Complex { re: pair[0], im: pair[1] };
    }

    let [a, b, c, d] = &mut z;
    stage::<DROP_1>(
        [a.as_flattened_mut(), b.as_flattened_mut(), c.as_flattened_mut(), d.as_flattened_mut()],
        TWIDDLE_64_Q30.iter(),
    );
    for [a, b, c, d] in &mut z {
        stage::<DROP_2>([a, b, c, d], TWIDDLE_64_Q30.iter().step_by(4));
    }
    for block in z.as_flattened_mut() {
        let [a, b, c, d] = *block;
        *block = butterfly(a, b, c, d);
    }

    // Decimation in frequency leaves the bins with their base-4 digits reversed.
    let bin = |k: usize| z[k % 4][(k / 4) % 4][(k / 16) % 4];
    let mut spectrum = [Complex::default(); FFT_BINS];
    let zero = bin(0);
    spectrum[0] = Complex { re: zero.re + zero.im, im: 0 };
    spectrum[HALF] = Complex { re: zero.re - zero.im, im: 0 };
    let middle = bin(HALF / 2);
    spectrum[HALF / 2] = Complex { re: middle.re, im: -middle.im };
    for (k, &twiddle) in (1..HALF / 2).zip(&TWIDDLE_128_Q30) {
        let (low, high) = split(bin(k), bin(HALF - k), twiddle);
        spectrum[k] = low;
        spectrum[HALF - k] = high;
    }
    spectrum
}

/// Bins k and 64−k of the real signal from bins k and 64−k of the packed one.
///
/// `even` and `odd` are twice the spectrum of the even samples and of the odd ones; the halving and the
/// twiddle round together.
#[inline]
fn split(z: Complex, mirror: Complex, [re, im]: [i32; 2]) -> (Complex, Complex) {
    let even = Complex { re: z.re + mirror.re, im: z.im - mirror.im };
    let odd = Complex { re: z.re - mirror.re, im: z.im + mirror.im }.turned();
    let real = odd.re as i64 * re as i64 - odd.im as i64 * im as i64;
    let imaginary = odd.re as i64 * im as i64 + odd.im as i64 * re as i64;
    let (even_re, even_im) = ((even.re as i64) << TWIDDLE_FRAC_BITS, (even.im as i64) << TWIDDLE_FRAC_BITS);
    let round = |x| round_shift(x, TWIDDLE_FRAC_BITS + 1) as i32;
    (
        Complex { re: round(even_re + real), im: round(even_im + imaginary) },
        Complex { re: round(even_re - real), im: round(imaginary - even_im) },
    )
}
