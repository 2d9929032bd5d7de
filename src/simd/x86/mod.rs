//! The kernels in the vector registers of x86-64: `pmaddwd` does for four or eight lanes what `smlad` does for one.
//!
//! Attention runs in SSE2, which every such computer has. Convolution and dense layers run in AVX2, where there is none
//! in plain Rust. All of them give the bits of [`portable`].

mod attention;
mod avx2;

use super::layout::{LayerParams, Map, MapMut};
use super::portable;

pub use attention::{dots, weighted_sums};

// SSE2 is enabled for the whole target, or this module is not compiled. AVX2 is asked for once.
cpufeatures::new!(has_avx2, "avx2");

/// See [`portable::dense`].
#[inline]
pub fn dense(x: &[u32], layer: LayerParams<'_>, out: &mut [i32]) {
    if has_avx2::get() {
        // SAFETY: this computer has AVX2.
        unsafe { avx2::dense(x, layer, out) }
    } else {
        portable::dense(x, layer, out);
    }
}

/// See [`portable::conv_relu_pool`].
pub fn conv_relu_pool(layer: LayerParams<'_>, x: Map<'_>, out: MapMut<'_>, strip: &mut [u32]) {
    if has_avx2::get() && avx2::takes(x.shape, out.shape) {
        // SAFETY: this computer has AVX2.
        unsafe { avx2::conv_relu_pool(layer, x, out, strip) }
    } else {
        portable::conv_relu_pool(layer, x, out, strip);
    }
}
