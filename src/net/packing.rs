//! In which order weights lie in the model file: the order in which the kernels read them.
//!
//! Outputs go in blocks of four. A block holds, word after word of the input, four words: two neighbouring inputs'
//! weights of each output. So the loops read them from one end to the other. What a block, a word or the input
//! has too little is zeros.

use crate::simd::LANES;

/// Inputs that the dense kernel takes at once.
const DENSE_STEP: usize = 16;

/// What the inputs of a layer are, which decides where each of them lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Inputs {
    /// A vector, in order.
    Vector {
        /// Its values.
        count: usize,
    },
    /// A 3×3 patch; in a model's terms in row, column, channel order.
    Patch {
        /// Channels of the map.
        channels: usize,
        /// Words per cell of the map as it lies in memory.
        pairs: usize,
    },
    /// A whole map without border; in a model's terms in row, column, channel order.
    Map {
        /// Cells along one side.
        side: usize,
        /// Channels of the map.
        channels: usize,
        /// Words per cell of the map as it lies in memory.
        pairs: usize,
    },
}

impl Inputs {
    /// How many there are, zeros not counted.
    pub const fn count(self) -> usize {
        match self {
            Self::Vector { count } => count,
            Self::Patch { channels, .. } => 9 * channels,
            Self::Map { side, channels, .. } => side * side * channels,
        }
    }

    /// Words that they lie in, zeros counted.
    pub const fn words(self) -> usize {
        match self {
            Self::Vector { count } => count.next_multiple_of(DENSE_STEP) / 2,
            Self::Patch { pairs, .. } => 9 * pairs,
            Self::Map { side, pairs, .. } => side * side * pairs,
        }
    }

    /// Where input `index` lies: its word, and 0 for the low half or 1 for the high one.
    pub const fn place(self, index: usize) -> (usize, usize) {
        match self {
            Self::Vector { .. } => (index / 2, index % 2),
            Self::Patch { channels, pairs } => {
                let (cell, channel) = (index / channels, index % channels);
                ((cell / 3 * pairs + channel / 2) * 3 + cell % 3, channel % 2)
            }
            Self::Map { side, channels, pairs } => {
                let (cell, channel) = (index / channels, index % channels);
                ((cell / side * pairs + channel / 2) * side + cell % side, channel % 2)
            }
        }
    }
}

/// Outputs of a layer with what a block of four has too many.
pub const fn padded_outputs(outputs: usize) -> usize {
    outputs.next_multiple_of(LANES)
}

/// Words per cell of a map that a layer with so many outputs gives.
pub const fn pairs(outputs: usize) -> usize {
    padded_outputs(outputs) / 2
}

/// Where the weight of `output` for input `index` lies among a layer's 16-bit weights.
pub const fn place(inputs: Inputs, output: usize, index: usize) -> usize {
    let (word, half) = inputs.place(index);
    ((output / LANES * inputs.words() + word) * LANES + output % LANES) * 2 + half
}

/// 16-bit weights of a layer, zeros counted.
pub const fn len(inputs: Inputs, outputs: usize) -> usize {
    padded_outputs(outputs) * inputs.words() * 2
}
