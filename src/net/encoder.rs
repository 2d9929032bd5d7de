//! One sensor's frame to one embedding per modality.

use super::activations::Activations;
use super::dense::dense;
use super::model::{Layer, Model};
use super::observer::Observer;
use super::packing::pairs;
use crate::features::XlFeatures;
use crate::features::piezo::PiezoFrontEnd;
use crate::fixed::{relu_i16, saturate_i16};
use crate::params::limits::{CONV_CHANNELS, EMBED, XL_CHANNELS, XL_KERNEL};
use crate::params::{PIEZO_CHANNELS, TAXEL_COLS, TAXEL_ROWS, XL_FEATURES};
use crate::sensor::PiezoFrame;
use crate::simd::{Map, MapMut, MapShape, conv_relu_pool};

/// An embedding; a model uses the first `dims.embed` values, the rest stay 0.
pub type Embedding = Activations<{ EMBED / 2 }>;

const SIDE: usize = TAXEL_ROWS;
const _: () = assert!(TAXEL_ROWS == TAXEL_COLS, "the maps are square");
const _: () = assert!(PIEZO_CHANNELS == 2, "a taxel's channels are one word");

/// Shape of the map that enters convolution block `block`, or leaves the last one (`block` 3).
const fn map(block: usize, pairs: usize) -> MapShape {
    MapShape { side: SIDE >> block, pairs, border: if block < 3 { 1 } else { 0 } }
}

const INPUT: MapShape = map(0, PIEZO_CHANNELS / 2);

/// Words of the largest strip.
const STRIP: usize = {
    let (strip1, strip2) = (map(1, pairs(CONV_CHANNELS[0])).strip(), map(2, pairs(CONV_CHANNELS[1])).strip());
    let most = if strip1 > strip2 { strip1 } else { strip2 };
    if INPUT.strip() > most { INPUT.strip() } else { most }
};

/// The feature maps between the convolution blocks. Their borders are zero and stay so.
#[derive(Clone, Debug)]
pub struct PiezoEncoder {
    input: [u32; INPUT.len()],
    block1: [u32; map(1, pairs(CONV_CHANNELS[0])).len()],
    block2: [u32; map(2, pairs(CONV_CHANNELS[1])).len()],
    block3: [u32; map(3, pairs(CONV_CHANNELS[2])).len()],
    /// Scratch of the convolutions.
    strip: [u32; STRIP],
    /// The embedding of an untouched pad, a constant of the model; computed at the first one.
    untouched: Option<Embedding>,
}

impl PiezoEncoder {
    /// Empty maps.
    pub const fn new() -> Self {
        Self {
            input: [0; INPUT.len()],
            block1: [0; map(1, pairs(CONV_CHANNELS[0])).len()],
            block2: [0; map(2, pairs(CONV_CHANNELS[1])).len()],
            block3: [0; map(3, pairs(CONV_CHANNELS[2])).len()],
            strip: [0; STRIP],
            untouched: None,
        }
    }

    /// Counts enter the first convolution as they are, each with its delta from `pad`, the front end of this sensor. The
    /// layout of the maps depends on the model, so one encoder serves one model only.
    pub fn embed<O: Observer>(
        &mut self,
        model: &Model<'_>,
        frame: &PiezoFrame,
        pad: &mut PiezoFrontEnd,
        observer: &mut O,
    ) -> Embedding {
        let rows = self.input.chunks_exact_mut(INPUT.row()).skip(INPUT.border);
        let cells = rows.filter_map(|row| row.get_mut(INPUT.border..)?.first_chunk_mut::<SIDE>());
        let touched = pad.push_rows(frame.counts(), frame.sum(), cells.map(bytemuck::must_cast_mut));
        if touched {
            return self.convolve(model, observer);
        }
        // An observer gets the layers of an untouched pad too.
        if let Some(embedding) = self.untouched.filter(|_| !O::ENABLED) {
            return embedding;
        }
        self.input = [0; INPUT.len()];
        let embedding = self.convolve(model, observer);
        self.untouched = Some(embedding);
        embedding
    }

    /// The map of the pad to its embedding.
    fn convolve(&mut self, model: &Model<'_>, observer: &mut impl Observer) -> Embedding {
        let shape = |block: usize| map(block, pairs(model.conv[block - 1].outputs));
        let [shape1, shape2, shape3] = [shape(1), shape(2), shape(3)];
        let Self { input, block1, block2, block3, strip, .. } = self;
        let [conv1, conv2, conv3] = &model.conv;
        let x = Map { words: input, shape: INPUT };
        observer.record_map("taxels", PIEZO_CHANNELS, x);
        conv_relu_pool(conv1.params(), x, MapMut { words: block1, shape: shape1 }, strip);
        let x = Map { words: block1, shape: shape1 };
        observer.record_map("piezo.conv1", conv1.outputs, x);
        conv_relu_pool(conv2.params(), x, MapMut { words: block2, shape: shape2 }, strip);
        let x = Map { words: block2, shape: shape2 };
        observer.record_map("piezo.conv2", conv2.outputs, x);
        conv_relu_pool(conv3.params(), x, MapMut { words: block3, shape: shape3 }, strip);
        observer.record_map("piezo.conv3", conv3.outputs, Map { words: block3, shape: shape3 });
        let mut out = Embedding::new();
        dense(&model.piezo_dense, block3, out.values_mut(), saturate_i16);
        record_outputs("piezo", &model.piezo_dense, out.values(), observer);
        out
    }
}

/// Record as many values as the layer has outputs.
fn record_outputs(name: &'static str, layer: &Layer<'_>, values: &[i16], observer: &mut impl Observer) {
    observer.record(name, values.get(..layer.outputs).unwrap_or_default());
}

/// Words of the features of one frame.
const FRAME_WORDS: usize = XL_FEATURES / 2;

/// The accelerometer's frames of the causal convolution, zeros before the start.
#[derive(Clone, Debug)]
pub struct XlHistory {
    /// Oldest first; the newest is last.
    frames: [Activations<FRAME_WORDS>; XL_KERNEL],
}

impl XlHistory {
    /// Zeros.
    pub const fn new() -> Self {
        Self { frames: [Activations::new(); XL_KERNEL] }
    }

    /// Add the newest frame.
    pub fn push(&mut self, features: &XlFeatures) {
        self.frames.rotate_left(1);
        if let Some(newest) = self.frames.last_mut() {
            newest.values_mut().copy_from_slice(features);
        }
    }

    /// Embed the newest frame.
    pub fn embed(&self, model: &Model<'_>, observer: &mut impl Observer) -> Embedding {
        let [conv, mix1, mix2] = &model.xl;
        let mut seen = [0; FRAME_WORDS * XL_KERNEL];
        let from = XL_KERNEL.saturating_sub(model.dims.xl_kernel);
        let frames = self.frames.get(from..).unwrap_or_default();
        for (to, frame) in seen.as_chunks_mut::<FRAME_WORDS>().0.iter_mut().zip(frames) {
            *to = *frame.words();
            observer.record("log_mel", frame.values());
        }
        let mut hidden1 = Activations::<{ XL_CHANNELS / 2 }>::new();
        let mut hidden2 = Activations::<{ XL_CHANNELS / 2 }>::new();
        let mut out = Embedding::new();
        dense(conv, &seen, hidden1.values_mut(), relu_i16);
        record_outputs("xl.conv", conv, hidden1.values(), observer);
        dense(mix1, hidden1.words(), hidden2.values_mut(), relu_i16);
        record_outputs("xl.mix1", mix1, hidden2.values(), observer);
        dense(mix2, hidden2.words(), out.values_mut(), saturate_i16);
        record_outputs("xl", mix2, out.values(), observer);
        out
    }
}
