//! The kernels in the vector registers of x86-64: `pmaddwd` does for four lanes what `smlad` does for one.
//!
//! The loops are those of [`portable`](super::portable), and so are the bits.

use core::arch::x86_64::{
    __m128i, _mm_add_epi32, _mm_cvtsi128_si32, _mm_madd_epi16, _mm_set1_epi32, _mm_setr_epi32,
    _mm_shuffle_epi32, _mm_sub_epi32,
};

use super::portable::{Lanes, conv_relu_pool_in, dense_in};
use super::{LANES, MapShape};

#[derive(Clone, Copy)]
struct Register(__m128i);

// SAFETY, of every block below: SSE2 is enabled for the whole target, or this file is not compiled.
impl Lanes for Register {
    #[inline]
    fn new([a, b, c, d]: [i32; LANES]) -> Self {
        // SAFETY: see above.
        Self(unsafe { _mm_setr_epi32(a, b, c, d) })
    }

    #[inline]
    fn mla(self, x: u32, &[a, b, c, d]: &[u32; LANES]) -> Self {
        // SAFETY: see above. Two products of −2^15 wrap as they do elsewhere.
        Self(unsafe {
            let w = _mm_setr_epi32(a as i32, b as i32, c as i32, d as i32);
            _mm_add_epi32(self.0, _mm_madd_epi16(_mm_set1_epi32(x as i32), w))
        })
    }

    #[inline]
    fn butterfly(self, other: Self) -> [Self; 2] {
        // SAFETY: see above.
        unsafe { [Self(_mm_add_epi32(self.0, other.0)), Self(_mm_sub_epi32(self.0, other.0))] }
    }

    #[inline]
    fn sums(self) -> [i32; LANES] {
        // SAFETY: see above.
        unsafe {
            [
                _mm_cvtsi128_si32(self.0),
                _mm_cvtsi128_si32(_mm_shuffle_epi32::<1>(self.0)),
                _mm_cvtsi128_si32(_mm_shuffle_epi32::<2>(self.0)),
                _mm_cvtsi128_si32(_mm_shuffle_epi32::<3>(self.0)),
            ]
        }
    }
}

/// See [`portable::dense`](super::portable::dense).
#[inline]
pub fn dense(x: &[u32], layer: (&[u32], &[i32], &[i32]), out: &mut [i32]) {
    dense_in::<Register>(x, layer, out);
}

/// See [`portable::conv_relu_pool`](super::portable::conv_relu_pool).
pub fn conv_relu_pool(
    layer: (&[u32], &[i32], &[i32]),
    x: (&[u32], MapShape),
    out: (&mut [u32], MapShape),
    strip: &mut [u32],
) {
    conv_relu_pool_in::<Register>(layer, x, out, strip);
}
