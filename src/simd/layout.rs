//! How words, layers and maps lie in memory.

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

/// The numbers of a layer, in blocks of four outputs; [`crate::net::packing`] has the order of the weights.
#[derive(Clone, Copy, Debug)]
pub struct LayerParams<'a> {
    /// Per block for every word of input one word per output.
    pub weights: &'a [u32],
    /// One per output.
    pub bias: &'a [i32],
    /// One per output, for [`scale_q32`](crate::fixed::scale_q32).
    pub multiplier: &'a [i32],
}

impl<'a> LayerParams<'a> {
    /// Biases and multipliers by block.
    pub(super) fn scales(self) -> impl Iterator<Item = (&'a [i32; LANES], &'a [i32; LANES])> {
        self.bias.as_chunks().0.iter().zip(self.multiplier.as_chunks().0)
    }
}

/// A feature map.
#[derive(Clone, Copy, Debug)]
pub struct Map<'a> {
    /// [`MapShape::len`] words.
    pub words: &'a [u32],
    /// How they lie.
    pub shape: MapShape,
}

/// A feature map to be written; its border is left as it is.
#[derive(Debug)]
#[expect(missing_docs, reason = "as in a [`Map`]")]
pub struct MapMut<'a> {
    pub words: &'a mut [u32],
    pub shape: MapShape,
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

    /// Largest number that a convolution writes into the map. With a border the next convolution takes it, whose sums of
    /// rows have to fit 16 bits; without, a dense layer.
    pub const fn largest(&self) -> i16 {
        if self.border > 0 { CONV_INPUT_MAX as i16 } else { i16::MAX }
    }

    /// Words of the strip from which a convolution computes two rows of outputs.
    pub const fn strip(&self) -> usize {
        4 * self.row()
    }

    /// Word of a cell; row and column count from the first cell inside the border.
    #[inline]
    pub const fn at(&self, row: usize, pair: usize, col: usize) -> usize {
        (row + self.border) * self.row() + pair * self.plane() + col + self.border
    }
}
