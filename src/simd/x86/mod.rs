//! The kernels in the vector registers of x86-64: `pmaddwd` does for four or eight lanes what `smlad` does for one.
//!
//! [`sse2`] runs on every such computer; where there is AVX2, convolution and dense layers run in its registers
//! of eight lanes. All of them give the bits of [`portable`](super::portable).

mod avx2;
pub mod sse2;

use super::layout::{LayerParams, Map, MapMut};

pub use sse2::{dots, weighted_sums};

// SSE2 is enabled for the whole target, or this module is not compiled. AVX2 is asked for once.
cpufeatures::new!(has_avx2, "avx2");

/// See [`portable::dense`](super::portable::dense).
#[inline]
pub fn dense(x: &[u32], layer: LayerParams<'_>, out: &mut [i32]) {
    if has_avx2::get() {
        // SAFETY: this computer has AVX2.
        unsafe { avx2::dense(x, layer, out) }
    } else {
        sse2::dense(x, layer, out);
    }
}

/// See [`portable::conv_relu_pool`](super::portable::conv_relu_pool).
pub fn conv_relu_pool(layer: LayerParams<'_>, x: Map<'_>, out: MapMut<'_>, strip: &mut [u32]) {
    if has_avx2::get() && avx2::takes(x.shape, out.shape) {
        // SAFETY: this computer has AVX2.
        unsafe { avx2::conv_relu_pool(layer, x, out, strip) }
    } else {
        sse2::conv_relu_pool(layer, x, out, strip);
    }
}
