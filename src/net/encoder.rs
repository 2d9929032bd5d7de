//! One sensor's frame to one embedding per modality.

use super::conv::{MapShape, conv3x3_relu_pool};
use super::dense::dense;
use super::model::{Layer, Model};
use super::observer::Observer;
use super::requantize;
use crate::features::pad_cells::PadCells;
use crate::params::limits::{CONV_CHANNELS, EMBED, XL_CHANNELS, XL_KERNEL};
use crate::params::{MEL_BINS, PIEZO_CHANNELS, TAXEL_COLS, TAXEL_ROWS};
use crate::sensor::PiezoFrame;

/// An embedding; a model uses the first `dims.embed` values, the rest stay 0.
pub type Embedding = [i16; EMBED];

const SIDE: usize = TAXEL_ROWS;
const _: () = assert!(TAXEL_ROWS == TAXEL_COLS, "the maps are square");

/// Shape of the map that enters convolution block `block`, or leaves the last one (`block` 3).
const fn map(block: usize, channels: usize) -> MapShape {
    MapShape { side: SIDE >> block, channels, border: if block < 3 { 1 } else { 0 } }
}

/// The feature maps between the convolution blocks. Their borders are zero and stay so.
#[derive(Clone, Debug)]
pub struct PiezoEncoder {
    input: [i16; map(0, PIEZO_CHANNELS).len()],
    block1: [i16; map(1, CONV_CHANNELS[0]).len()],
    block2: [i16; map(2, CONV_CHANNELS[1]).len()],
    block3: [i16; map(3, CONV_CHANNELS[2]).len()],
}

impl PiezoEncoder {
    /// Empty maps.
    pub const fn new() -> Self {
        Self {
            input: [0; map(0, PIEZO_CHANNELS).len()],
            block1: [0; map(1, CONV_CHANNELS[0]).len()],
            block2: [0; map(2, CONV_CHANNELS[1]).len()],
            block3: [0; map(3, CONV_CHANNELS[2]).len()],
        }
    }

    /// Counts enter the first convolution as they are: the lowest of the 12 bits is not lost. Beside each
    /// lies its change since the recent past, which `pad` keeps, of this sensor alone.
    ///
    /// The maps are laid out by the model's channels, so one encoder serves one model only.
    pub fn embed(
        &mut self,
        model: &Model<'_>,
        frame: &PiezoFrame,
        pad: &mut PadCells,
        observer: &mut impl Observer,
    ) -> Embedding {
        let [c1, c2, c3] = model.dims.conv_channels;
        let shape = map(0, PIEZO_CHANNELS);
        let (cells, _) = self.input.as_chunks_mut::<PIEZO_CHANNELS>();
        let rows = cells.chunks_exact_mut(shape.side + 2 * shape.border).skip(shape.border);
        pad.push_rows(frame.counts(), rows.filter_map(|row| row.get_mut(shape.border..)?.first_chunk_mut()));
        see_map("taxels", &self.input, map(0, PIEZO_CHANNELS), observer);
        let [conv1, conv2, conv3] = &model.conv;
        conv3x3_relu_pool(conv1, &self.input, map(0, PIEZO_CHANNELS), &mut self.block1, map(1, c1));
        see_map("piezo.conv1", &self.block1, map(1, c1), observer);
        conv3x3_relu_pool(conv2, &self.block1, map(1, c1), &mut self.block2, map(2, c2));
        see_map("piezo.conv2", &self.block2, map(2, c2), observer);
        conv3x3_relu_pool(conv3, &self.block2, map(2, c2), &mut self.block3, map(3, c3));
        let mut out = [0; EMBED];
        see_map("piezo.conv3", &self.block3, map(3, c3), observer);
        dense(&model.piezo_dense, &self.block3, &mut out, requantize::signed);
        see_outputs("piezo", &model.piezo_dense, &out, observer);
        out
    }
}

/// Show the cells of a map without its border.
fn see_map(layer: &'static str, cells: &[i16], shape: MapShape, observer: &mut impl Observer) {
    for row in 0..shape.side {
        let start = shape.at(row, 0);
        observer.see(layer, cells.get(start..start + shape.side * shape.channels).unwrap_or_default());
    }
}

/// Show as many values as the layer gives.
fn see_outputs(name: &'static str, layer: &Layer<'_>, values: &[i16], observer: &mut impl Observer) {
    observer.see(name, values.get(..layer.outputs).unwrap_or_default());
}

impl Default for PiezoEncoder {
    fn default() -> Self {
        Self::new()
    }
}

/// The standardised log-mel frames that the causal convolution still sees, zeros before the start.
#[derive(Clone, Debug)]
pub struct XlHistory {
    /// Oldest first; the newest is last.
    frames: [[i16; MEL_BINS]; XL_KERNEL],
}

impl XlHistory {
    /// Silence.
    pub const fn new() -> Self {
        Self { frames: [[0; MEL_BINS]; XL_KERNEL] }
    }

    /// Take the newest frame in.
    pub fn push(&mut self, log_mel: &[i16; MEL_BINS]) {
        self.frames.rotate_left(1);
        if let Some(newest) = self.frames.last_mut() {
            *newest = *log_mel;
        }
    }

    /// Embed the newest frame.
    pub fn embed(&self, model: &Model<'_>, observer: &mut impl Observer) -> Embedding {
        let [conv, mix1, mix2] = &model.xl;
        let seen = self.frames.as_flattened();
        let seen = seen.get(seen.len().saturating_sub(conv.inputs)..).unwrap_or_default();
        let mut hidden1 = [0; XL_CHANNELS];
        let mut hidden2 = [0; XL_CHANNELS];
        let mut out = [0; EMBED];
        observer.see("log_mel", seen);
        dense(conv, seen, &mut hidden1, requantize::relu);
        see_outputs("xl.conv", conv, &hidden1, observer);
        dense(mix1, &hidden1, &mut hidden2, requantize::relu);
        see_outputs("xl.mix1", mix1, &hidden2, observer);
        dense(mix2, &hidden2, &mut out, requantize::signed);
        see_outputs("xl", mix2, &out, observer);
        out
    }
}

impl Default for XlHistory {
    fn default() -> Self {
        Self::new()
    }
}
