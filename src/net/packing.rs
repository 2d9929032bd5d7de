//! Order of the weights in the model file: that in which the kernels read them.
//!
//! Outputs are in blocks of four. A block has, for each word of the input, four words: two neighbouring inputs' weights of
//! each output. Incomplete blocks and words are padded with zeros.
//!
//! A convolution multiplies sums and differences of rows
//! ([`conv_relu_pool`](crate::simd::portable::conv_relu_pool)). So for the three weights `g0`, `g1`, `g2` of a kernel's
//! column and channel the file has four *coefficients*, `g0 + g1 + g2`, `g0 − g1 + g2`, `2·g0` and `2·g2`; its sums, and
//! with them bias and multiplier, are of twice the weights, and its inputs have 14 bits and a sign ([`CONV_INPUT_MAX`]).
//! Other layers have one coefficient per weight.

use core::ops::{Add, Sub};

use crate::params::CONV_INPUT_MAX;
use crate::simd::LANES;

/// Inputs that the dense kernel takes at once.
const DENSE_STEP: usize = 16;

/// The inputs of a layer. Of a map: cells along one side, channels, words per cell as it lies in memory (`pairs`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the fields are named after what they are")]
pub enum Inputs {
    /// A vector, in order.
    Vector { count: usize },
    /// A 3×3 patch; in a model's terms in row, column, channel order.
    Patch { channels: usize, pairs: usize },
    /// A whole map without border; in a model's terms in row, column, channel order.
    Map { side: usize, channels: usize, pairs: usize },
}

impl Inputs {
    /// How many there are, padding not counted.
    pub const fn count(self) -> usize {
        match self {
            Self::Vector { count } => count,
            Self::Patch { channels, .. } => 9 * channels,
            Self::Map { side, channels, .. } => side * side * channels,
        }
    }

    /// Coefficients of one output, padding not counted.
    pub const fn coefficients(self) -> usize {
        match self {
            Self::Patch { channels, .. } => 4 * 3 * channels,
            _ => self.count(),
        }
    }

    /// Words of the coefficients of one output, with padding.
    pub const fn words(self) -> usize {
        match self {
            Self::Vector { count } => count.next_multiple_of(DENSE_STEP) / 2,
            Self::Patch { pairs, .. } => 4 * 3 * pairs,
            Self::Map { side, pairs, .. } => side * side * pairs,
        }
    }

    /// The accumulator over the sum of products.
    pub const fn gain(self) -> i32 {
        match self {
            Self::Patch { .. } => 2,
            _ => 1,
        }
    }

    /// Largest magnitude of an input.
    pub const fn magnitude(self) -> i32 {
        match self {
            Self::Patch { .. } => CONV_INPUT_MAX + 1,
            _ => 1 << 15,
        }
    }

    /// The coefficient at `index` of an output with these weights, which may not fit 16 bits.
    ///
    /// Of a patch come first `g0 + g1 + g2` by column and channel, then `g0 − g1 + g2`, `2·g0` and `2·g2`.
    pub fn coefficient<T>(self, index: usize, weight: impl Fn(usize) -> T) -> T
    where
        T: Copy + Add<Output = T> + Sub<Output = T>,
    {
        let Self::Patch { channels, .. } = self else { return weight(index) };
        let (kind, tap) = (index / (3 * channels), index % (3 * channels));
        let [g0, g1, g2] = [0, 1, 2].map(|row| weight(row * 3 * channels + tap));
        match kind {
            0 => g0 + g1 + g2,
            1 => g0 - g1 + g2,
            2 => g0 + g0,
            _ => g2 + g2,
        }
    }

    /// The weight for input `index` of an output with these coefficients.
    pub fn weight(self, index: usize, coefficient: impl Fn(usize) -> i32) -> i32 {
        let Self::Patch { channels, .. } = self else { return coefficient(index) };
        let (row, tap) = (index / (3 * channels), index % (3 * channels));
        let [sum, alternating, upper, lower] =
            [0, 1, 2, 3].map(|kind| coefficient(kind * 3 * channels + tap));
        match row {
            0 => upper / 2,
            1 => (sum - alternating) / 2,
            _ => lower / 2,
        }
    }

    /// Where a coefficient lies: its word, and 0 for the low half or 1 for the high one.
    const fn place(self, coefficient: usize) -> (usize, usize) {
        match self {
            Self::Vector { .. } => (coefficient / 2, coefficient % 2),
            Self::Patch { channels, pairs } => {
                let (kind, tap) = (coefficient / (3 * channels), coefficient % (3 * channels));
                let (col, channel) = (tap / channels, tap % channels);
                // As the planes of a strip: two kinds by turns for every pair of channels, then the other two.
                let plane = (kind / 2 * pairs + channel / 2) * 2 + kind % 2;
                (plane * 3 + col, channel % 2)
            }
            Self::Map { side, channels, pairs } => {
                let (cell, channel) = (coefficient / channels, coefficient % channels);
                ((cell / side * pairs + channel / 2) * side + cell % side, channel % 2)
            }
        }
    }
}

/// Outputs of a layer in whole blocks of four.
pub const fn padded_outputs(outputs: usize) -> usize {
    outputs.next_multiple_of(LANES)
}

/// Words per cell of the map that a layer with `outputs` outputs gives.
pub const fn pairs(outputs: usize) -> usize {
    padded_outputs(outputs) / 2
}

/// Where a coefficient of `output` lies among a layer's 16-bit numbers.
pub const fn place(inputs: Inputs, output: usize, coefficient: usize) -> usize {
    let (word, half) = inputs.place(coefficient);
    ((output / LANES * inputs.words() + word) * LANES + output % LANES) * 2 + half
}

/// 16-bit numbers of a layer, with padding.
pub const fn len(inputs: Inputs, outputs: usize) -> usize {
    padded_outputs(outputs) * inputs.words() * 2
}
