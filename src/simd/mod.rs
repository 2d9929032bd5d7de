//! The inner loops of the network: [`dense`], [`conv_relu_pool`], and for attention [`dots`] and [`weighted_sums`].
//!
//! [`portable`] defines what each computes. A Cortex-M7 has them in assembly (`simd::arm`): `smlad` multiplies two pairs
//! of 16-bit numbers and adds both products in one cycle, and the use of registers decides how many loads feed it. On
//! x86-64 vector registers do the same for four or eight lanes (`simd::x86`). All give the same bits for any input,
//! wrapping included: `cargo xtask test --only qemu-kernels` compares them on the emulated microcontroller,
//! `cargo test -p slipsense-qemu --test vectors` on this computer.
//!
//! Numbers lie in words of two, the first in the low half, in the order of [`crate::net::packing`].

#[cfg(arm_dsp)]
#[expect(unsafe_code, reason = "assembly: see the module")]
pub mod arm;
mod layout;
pub mod portable;
#[cfg(all(target_arch = "x86_64", target_feature = "sse2"))]
#[expect(unsafe_code, reason = "vector instructions: see the module")]
pub mod x86;

#[cfg(arm_dsp)]
pub use arm::{conv_relu_pool, dense, dots, weighted_sums};
#[cfg(not(any(arm_dsp, all(target_arch = "x86_64", target_feature = "sse2"))))]
pub use portable::{conv_relu_pool, dense, dots, weighted_sums};
#[cfg(all(target_arch = "x86_64", target_feature = "sse2"))]
pub use x86::{conv_relu_pool, dense, dots, weighted_sums};

pub use layout::{LANES, LayerParams, Map, MapMut, MapShape, halves, pair};
