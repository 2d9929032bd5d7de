//! The inner loops of the network: four outputs side by side, two products per instruction.
//!
//! A convolution gets by with two products for three ([`portable::conv_relu_pool`] says how).
//!
//! Everything that multiplies activations comes down to four functions, [`dense`], [`conv_relu_pool`], and for
//! attention [`dots`] and [`weighted_sums`]. Each has a portable form in [`portable`], which says what
//! it computes, and on a Cortex-M7 one in assembly (`simd::arm`): `smlad` multiplies two pairs of 16-bit numbers and adds
//! both products in one cycle, and which registers hold what decides how many loads it takes to feed it. On x86-64
//! vector registers do the same for four or eight lanes (`simd::x86`). All give the same bits for any input, wrapping
//! included: `cargo xtask test --only qemu-kernels` compares them on the emulated microcontroller, and
//! `cargo test -p slipsense-qemu --test vectors` on this computer.
//!
//! Numbers lie in words of two: the low half is the first. [`crate::net::packing`] says in which order.

#[cfg(arm_dsp)]
#[expect(unsafe_code, reason = "assembly: see the module")]
pub mod arm;
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

use crate::params::CONV_INPUT_MAX;

/// Outputs that a kernel computes side by side.
pub const LANES: usize = 4;

/// Two 16-bit numbers as one word.
#[inline]
pub const fn pair(low: i16, high: i16) -> u32 {
    low as u16 as u32 | (high as u16 as u32) << 16
}

/// The two numbers of a word.
#[inline]
pub const fn halves(word: u32) -> [i16; 2] {
    [word as i16, (word >> 16) as i16]
}

/// A square feature map: row after row, per row one plane per pair of channels, per plane one word per column.
/// Around it lies a border of zeros, `border` words and rows wide.
///
/// Neighbouring columns are neighbouring words, so a column that is loaded feeds two outputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MapShape {
    /// Cells along one side, border not counted.
    pub side: usize,
    /// Words per cell: half the channels.
    pub pairs: usize,
    /// 1 before a 3×3 convolution, else 0.
    pub border: usize,
}

impl MapShape {
    /// Words of one plane of one row.
    pub const fn plane(&self) -> usize {
        self.side + 2 * self.border
    }

    /// Words of one row.
    pub const fn row(&self) -> usize {
        self.pairs * self.plane()
    }

    /// Words of the map, border included.
    pub const fn len(&self) -> usize {
        (self.side + 2 * self.border) * self.row()
    }

    /// Largest number that a convolution writes into the map. With a border the map is for a convolution to take, whose
    /// sums of rows have to fit 16 bits; without, a dense layer takes it.
    pub const fn largest(&self) -> i16 {
        if self.border > 0 { CONV_INPUT_MAX as i16 } else { i16::MAX }
    }

    /// Words of what a convolution makes two rows of outputs of: as many as four rows.
    pub const fn strip(&self) -> usize {
        4 * self.row()
    }

    /// Has the map no cells?
    pub const fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Word of a cell; row and column count from the first cell inside the border.
    #[inline]
    pub const fn at(&self, row: usize, pair: usize, col: usize) -> usize {
        (row + self.border) * self.row() + pair * self.plane() + col + self.border
    }
}
