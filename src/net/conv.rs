//! 3×3 convolution, ReLU and 2×2 max-pool as one kernel.
//!
//! The pool runs on the accumulators: requantization is monotonic, so pooling first gives the same
//! bits with a quarter of the requantizations.

use super::dense::dot;
use super::model::Layer;
use super::requantize;
use crate::params::PIEZO_CHANNELS;
use crate::params::limits::CONV_CHANNELS;

/// Most inputs of one 3×3 patch that a model may have.
const PATCH_MAX: usize = 9 * CONV_CHANNELS[1];
const _: () = assert!(CONV_CHANNELS[0] <= CONV_CHANNELS[1] && PIEZO_CHANNELS <= CONV_CHANNELS[1]);

/// A square feature map in row, column, channel order, with a border of `border` cells of zeros on
/// every side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MapShape {
    /// Cells along one side, border not counted.
    pub side: usize,
    /// Channels per cell.
    pub channels: usize,
    /// Cells of zeros around: 1 before a 3×3 convolution, else 0.
    pub border: usize,
}

impl MapShape {
    /// Activations the map takes, border included.
    pub const fn len(&self) -> usize {
        let padded = self.side + 2 * self.border;
        padded * padded * self.channels
    }

    /// Has the map no cells?
    pub const fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Index of a cell's first channel; row and column count from the first cell inside the border.
    #[inline]
    pub(super) const fn at(&self, row: usize, col: usize) -> usize {
        ((row + self.border) * (self.side + 2 * self.border) + col + self.border) * self.channels
    }
}

/// One block: `x` (shape `from`, border 1) to `out` (half the side, `layer.outputs` channels, its own
/// border, whose zeros are left as they are).
///
/// Weights are in output, row, column, input order, so a patch and a filter are the same run of numbers.
pub fn conv3x3_relu_pool(layer: &Layer<'_>, x: &[i16], from: MapShape, out: &mut [i16], to: MapShape) {
    let inputs = (9 * from.channels).min(PATCH_MAX);
    let mut patches = [[0i16; PATCH_MAX]; 4];
    for row in 0..to.side {
        for col in 0..to.side {
            for (corner, patch) in patches.iter_mut().enumerate() {
                gather(x, from, 2 * row + corner / 2, 2 * col + corner % 2, patch);
            }
            let cell = out.get_mut(to.at(row, col)..).unwrap_or_default();
            let filters = layer.weights.chunks_exact(inputs.max(1));
            let scales = layer.bias.iter().zip(layer.multiplier.iter());
            for ((out, filter), (bias, multiplier)) in cell.iter_mut().zip(filters).zip(scales) {
                let best = patches.iter().map(|patch| dot(patch, filter)).fold(i32::MIN, i32::max);
                *out = requantize::relu(bias.wrapping_add(best), multiplier);
            }
        }
    }
}

/// Copy the 3×3 neighbourhood of a cell; the border makes every neighbour exist.
#[inline]
fn gather(x: &[i16], shape: MapShape, row: usize, col: usize, patch: &mut [i16; PATCH_MAX]) {
    let run = 3 * shape.channels;
    for (ky, patch_row) in patch.chunks_exact_mut(run.max(1)).take(3).enumerate() {
        // Row −1 and column −1 are border cells: at() adds the border, so subtract it back first.
        let start = shape.at(row, col) + ky * (shape.side + 2) * shape.channels;
        let start = start - (shape.side + 2 + 1) * shape.channels;
        if let Some(cells) = x.get(start..start + run) {
            patch_row.copy_from_slice(cells);
        }
    }
}
