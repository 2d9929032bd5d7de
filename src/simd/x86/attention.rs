//! Four lanes, which every x86-64 has: four keys or two values at once.

use core::arch::x86_64::{
    __m128i, _mm_add_epi32, _mm_loadu_si128, _mm_madd_epi16, _mm_set1_epi32, _mm_setzero_si128,
    _mm_storeu_si128, _mm_unpackhi_epi16, _mm_unpackhi_epi32, _mm_unpackhi_epi64, _mm_unpacklo_epi16,
    _mm_unpacklo_epi32, _mm_unpacklo_epi64,
};

use crate::simd::layout::pair;
use crate::simd::portable;

/// Words of a vector register.
const WORDS: usize = 4;
/// Keys at once.
const KEYS: usize = 4;

/// See [`portable::dots`].
pub fn dots(query: &[u32], rows: &[u32], stride: usize, out: &mut [i32]) {
    let stride = stride.max(1);
    let mut done = 0;
    if let (parts @ [_, ..], []) = query.as_chunks::<WORDS>()
        && query.len() <= stride
    {
        for out in out.as_chunks_mut::<KEYS>().0 {
            let Some(sums) = rows.get(done * stride..).and_then(|rows| dots_of_four(parts, rows, stride))
            else {
                break;
            };
            // SAFETY: four sums are as long as the register.
            unsafe { _mm_storeu_si128(out.as_mut_ptr().cast(), sums) };
            done += KEYS;
        }
    }
    let rows = rows.get(done * stride..).unwrap_or_default();
    portable::dots(query, rows, stride, out.get_mut(done..).unwrap_or_default());
}

/// Of the first four rows, if they are there.
#[inline]
fn dots_of_four(query: &[[u32; WORDS]], rows: &[u32], stride: usize) -> Option<__m128i> {
    let words = query.len() * WORDS;
    let [a, b, c, d] = [0, 1, 2, 3].map(|row| rows.get(row * stride..row * stride + words));
    let (a, b, c, d) = (a?, b?, c?, d?);
    let [a, b, c, d] = [a, b, c, d].map(|row| row.as_chunks::<WORDS>().0);
    // SAFETY: SSE2 is enabled for the whole target.
    unsafe {
        let mut sums = [_mm_setzero_si128(); KEYS];
        for ((((query, a), b), c), d) in query.iter().zip(a).zip(b).zip(c).zip(d) {
            let query = load(query);
            for (sum, key) in sums.iter_mut().zip([a, b, c, d]) {
                *sum = _mm_add_epi32(*sum, _mm_madd_epi16(query, load(key)));
            }
        }
        let [a, b, c, d] = sums;
        let ab = _mm_add_epi32(_mm_unpacklo_epi32(a, b), _mm_unpackhi_epi32(a, b));
        let cd = _mm_add_epi32(_mm_unpacklo_epi32(c, d), _mm_unpackhi_epi32(c, d));
        Some(_mm_add_epi32(_mm_unpacklo_epi64(ab, cd), _mm_unpackhi_epi64(ab, cd)))
    }
}

/// See [`portable::weighted_sums`].
pub fn weighted_sums(weights: &[i32], rows: &[u32], stride: usize) -> [i32; 8] {
    let stride = stride.max(1);
    let row = |index: usize| rows.get(index * stride..)?.first_chunk::<WORDS>();
    let mut done = 0;
    let mut sums = [[0i32; 4]; 2];
    // SAFETY: SSE2 is enabled for the whole target, and four sums are as long as a register.
    unsafe {
        let [mut low, mut high] = [_mm_setzero_si128(); 2];
        for &[first, second] in weights.as_chunks::<2>().0 {
            // A row that overlaps the next one is left to the portable form.
            let (Some(a), Some(b)) = (row(done).filter(|_| stride >= WORDS), row(done + 1)) else { break };
            let weights = _mm_set1_epi32(pair(first as i16, second as i16) as i32);
            let (a, b) = (load(a), load(b));
            low = _mm_add_epi32(low, _mm_madd_epi16(weights, _mm_unpacklo_epi16(a, b)));
            high = _mm_add_epi32(high, _mm_madd_epi16(weights, _mm_unpackhi_epi16(a, b)));
            done += 2;
        }
        _mm_storeu_si128(sums[0].as_mut_ptr().cast(), low);
        _mm_storeu_si128(sums[1].as_mut_ptr().cast(), high);
    }
    let rest = weights.get(done..).unwrap_or_default();
    let mut all = portable::weighted_sums(rest, rows.get(done * stride..).unwrap_or_default(), stride);
    for (all, sum) in all.iter_mut().zip(sums.as_flattened()) {
        *all = all.wrapping_add(*sum);
    }
    all
}

#[inline]
fn load(words: &[u32; WORDS]) -> __m128i {
    // SAFETY: SSE2 is enabled for the whole target, and four words are as long as the register.
    unsafe { _mm_loadu_si128(words.as_ptr().cast()) }
}
