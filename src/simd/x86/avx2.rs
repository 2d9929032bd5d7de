//! Eight lanes: for a convolution eight neighbouring columns of one filter, for a dense layer four outputs of two words.

use core::arch::x86_64::{
    __m128i, __m256i, _mm_add_epi32, _mm_loadu_si128, _mm_storeu_si128, _mm256_add_epi32, _mm256_add_epi64,
    _mm256_broadcastsi128_si256, _mm256_castsi256_si128, _mm256_extracti128_si256, _mm256_loadu_si256,
    _mm256_madd_epi16, _mm256_max_epi32, _mm256_min_epi32, _mm256_mul_epi32, _mm256_or_si256,
    _mm256_permutevar8x32_epi32, _mm256_set1_epi32, _mm256_set1_epi64x, _mm256_setr_epi32,
    _mm256_setzero_si256, _mm256_shuffle_epi32, _mm256_slli_epi64, _mm256_srli_epi64, _mm256_sub_epi32,
};

use crate::fixed::scale_q32;
use crate::simd::layout::{LANES, LayerParams, Map, MapMut, MapShape};
use crate::simd::portable::{combine_rows, mla_pair};

/// Columns side by side.
const COLS: usize = 8;
/// Words of weights of one plane for a block of filters: three columns of the kernel.
const TAPS: usize = 3 * LANES;

/// Is this a convolution for [`conv_relu_pool`]? Its rows of outputs are made of whole registers, border included.
pub(super) const fn takes(from: MapShape, to: MapShape) -> bool {
    from.side.is_multiple_of(COLS) && from.border == 1 && to.side * 2 == from.side
}

/// See [`portable::conv_relu_pool`](crate::simd::portable::conv_relu_pool), of shapes that this [`takes`].
#[target_feature(enable = "avx2")]
pub(super) fn conv_relu_pool(layer: LayerParams<'_>, x: Map<'_>, out: MapMut<'_>, strip: &mut [u32]) {
    let (from, to) = (x.shape, out.shape);
    let planes = 4 * from.pairs;
    for row in 0..to.side {
        combine_rows(x.words.get(2 * row * from.row()..).unwrap_or_default(), from, strip);
        let filters = layer.weights.as_chunks::<TAPS>().0.chunks_exact(planes.max(1));
        for ((block, filters), (bias, multiplier)) in (0..to.pairs / 2).zip(filters).zip(layer.scales()) {
            for col in (0..from.side).step_by(COLS) {
                let sums = tile(strip.get(col..).unwrap_or_default(), from, filters);
                let words = requantize(sums, bias, multiplier, to.largest());
                for (half, words) in words.into_iter().enumerate() {
                    let at = to.at(row, 2 * block + half, col / 2);
                    if let Some(out) =
                        out.words.get_mut(at..).and_then(<[u32]>::first_chunk_mut::<{ COLS / 2 }>)
                    {
                        // SAFETY: `out` is as long as the register.
                        unsafe { _mm_storeu_si128(out.as_mut_ptr().cast(), words) };
                    }
                }
            }
        }
    }
}

/// For four filters the larger of the upper and lower outputs in eight columns; `strip` begins at the left column of
/// their window.
#[inline]
#[target_feature(enable = "avx2")]
fn tile(strip: &[u32], from: MapShape, filters: &[[u32; TAPS]]) -> [__m256i; LANES] {
    let (inner, outer) = filters.split_at(filters.len() / 2);
    let mut planes = strip.chunks(from.plane().max(1));
    let mut sums = [[_mm256_setzero_si256(); LANES]; 2];
    accumulate(&mut sums, &mut planes, inner);
    // From here on of the upper and of the lower outputs.
    let [mut upper, mut lower] = sums;
    for (upper, lower) in upper.iter_mut().zip(&mut lower) {
        let (sum, difference) = (*upper, *lower);
        *upper = _mm256_add_epi32(sum, difference);
        *lower = _mm256_sub_epi32(sum, difference);
    }
    sums = [upper, lower];
    accumulate(&mut sums, &mut planes, outer);
    let [mut best, lower] = sums;
    for (best, lower) in best.iter_mut().zip(lower) {
        *best = _mm256_max_epi32(*best, lower);
    }
    best
}

/// Add the products of planes by turns to the one four sums and to the other.
#[inline]
#[target_feature(enable = "avx2")]
fn accumulate(
    sums: &mut [[__m256i; LANES]; 2],
    planes: &mut core::slice::Chunks<'_, u32>,
    filters: &[[u32; TAPS]],
) {
    for taps in filters.as_chunks::<2>().0 {
        for (sums, taps) in sums.iter_mut().zip(taps) {
            let Some(plane) = planes.next().and_then(<[u32]>::first_chunk::<{ COLS + 2 }>) else { return };
            for (x, taps) in plane.windows(COLS).zip(taps.as_chunks::<LANES>().0) {
                // SAFETY: a window is as long as the register.
                let x = unsafe { _mm256_loadu_si256(x.as_ptr().cast()) };
                for (sum, &tap) in sums.iter_mut().zip(taps) {
                    *sum = _mm256_add_epi32(*sum, _mm256_madd_epi16(x, _mm256_set1_epi32(tap as i32)));
                }
            }
        }
    }
}

/// The larger of each two neighbouring columns to activations of 0 to `largest`, for two filters in one word.
#[inline]
#[target_feature(enable = "avx2")]
fn requantize(
    sums: [__m256i; LANES],
    bias: &[i32; LANES],
    multiplier: &[i32; LANES],
    largest: i16,
) -> [__m128i; LANES / 2] {
    let mut cells = sums;
    for (cell, (&bias, &multiplier)) in cells.iter_mut().zip(bias.iter().zip(multiplier)) {
        // Every second lane is what both columns have; what `scale_q32` does goes on in twice its width.
        let pooled = _mm256_max_epi32(*cell, _mm256_shuffle_epi32::<0b10_11_00_01>(*cell));
        let sum = _mm256_add_epi32(pooled, _mm256_set1_epi32(bias));
        let product = _mm256_mul_epi32(sum, _mm256_set1_epi32(multiplier));
        let scaled = _mm256_srli_epi64::<32>(_mm256_add_epi64(product, _mm256_set1_epi64x(1 << 31)));
        let positive = _mm256_max_epi32(scaled, _mm256_setzero_si256());
        *cell = _mm256_min_epi32(positive, _mm256_set1_epi32(largest.into()));
    }
    let [a, b, c, d] = cells;
    let together = _mm256_setr_epi32(0, 2, 4, 6, 0, 2, 4, 6);
    let mut words = [_mm256_castsi256_si128(a); LANES / 2];
    for (words, (low, high)) in words.iter_mut().zip([(a, b), (c, d)]) {
        let pairs = _mm256_or_si256(low, _mm256_slli_epi64::<16>(high));
        *words = _mm256_castsi256_si128(_mm256_permutevar8x32_epi32(pairs, together));
    }
    words
}

/// See [`portable::dense`](crate::simd::portable::dense).
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn dense(x: &[u32], layer: LayerParams<'_>, out: &mut [i32]) {
    let blocks = layer.weights.as_chunks::<LANES>().0.chunks_exact(x.len().max(1)).zip(layer.scales());
    for (out, (weights, (bias, multiplier))) in out.as_chunks_mut::<LANES>().0.iter_mut().zip(blocks) {
        let sums = products(x, weights, bias);
        for ((out, sum), &multiplier) in out.iter_mut().zip(sums).zip(multiplier) {
            *out = scale_q32(sum, multiplier);
        }
    }
}

/// `bias + Σ x·w` of four outputs.
#[inline]
#[target_feature(enable = "avx2")]
fn products(x: &[u32], weights: &[[u32; LANES]], bias: &[i32; LANES]) -> [i32; LANES] {
    let (fours, rest) = x.as_chunks::<4>();
    let (weights, weights_of_rest) = weights.as_chunks::<4>();
    let [mut even, mut odd] = [_mm256_setzero_si256(); 2];
    for (x, weights) in fours.iter().zip(weights) {
        // SAFETY: four words are as long as half a register, and four words' weights as long as two.
        let (x, w01, w23) = unsafe {
            let from: *const __m256i = weights.as_ptr().cast();
            (
                _mm_loadu_si128(x.as_ptr().cast()),
                _mm256_loadu_si256(from),
                _mm256_loadu_si256(from.wrapping_add(1)),
            )
        };
        // Words 0 0 0 0 and 1 1 1 1, then 2 2 2 2 and 3 3 3 3.
        let x = _mm256_broadcastsi128_si256(x);
        let x01 = _mm256_permutevar8x32_epi32(x, _mm256_setr_epi32(0, 0, 0, 0, 1, 1, 1, 1));
        let x23 = _mm256_permutevar8x32_epi32(x, _mm256_setr_epi32(2, 2, 2, 2, 3, 3, 3, 3));
        even = _mm256_add_epi32(even, _mm256_madd_epi16(x01, w01));
        odd = _mm256_add_epi32(odd, _mm256_madd_epi16(x23, w23));
    }
    let sum = _mm256_add_epi32(even, odd);
    let folded = _mm_add_epi32(_mm256_castsi256_si128(sum), _mm256_extracti128_si256::<1>(sum));
    let mut sums = *bias;
    // SAFETY: four sums are as long as the register.
    unsafe {
        let to: *mut __m128i = sums.as_mut_ptr().cast();
        _mm_storeu_si128(to, _mm_add_epi32(folded, _mm_loadu_si128(to)));
    }
    for (&x, weights) in rest.iter().zip(weights_of_rest) {
        for (sum, &w) in sums.iter_mut().zip(weights) {
            *sum = mla_pair(*sum, x, w);
        }
    }
    sums
}
