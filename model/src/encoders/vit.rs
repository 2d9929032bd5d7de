//! The vision transformer of a scan and its pretraining as a masked autoencoder: patches of 4×4 taxels, eight layers
//! of width 128, and for the pretraining a decoder of four layers of width 64.

use burn::module::{Module, Param};
use burn::nn::transformer::{TransformerEncoder, TransformerEncoderConfig, TransformerEncoderInput};
use burn::nn::{LayerNorm, LayerNormConfig, Linear, LinearConfig};
use burn::tensor::{Device, Int, Tensor};
use rand::Rng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use slipsense::params::{TAXEL_ROWS, TAXELS};

use super::{EMBED, NORM_EPSILON};
use crate::device::tensor;

/// Taxels along a side of a patch, patches along a side of a scan, numbers of each.
const SIDE: usize = 4;
const GRID: usize = TAXEL_ROWS / SIDE;
const PATCH: usize = SIDE * SIDE;
const PATCHES: usize = GRID * GRID;
/// Width of the decoder.
const DECODER: usize = 64;
/// Share of the patches that are masked, and of the scans that any are.
const MASKED: std::ops::Range<f64> = 0.6..0.8;
const SCANS_MASKED: f64 = 0.95;

/// Layers as in the authors' code: norm first, GELU, four times the width within.
pub(super) fn layers(width: usize, heads: usize, layers: usize, device: &Device) -> TransformerEncoder {
    TransformerEncoderConfig::new(width, 4 * width, heads, layers)
        .with_norm_first(true)
        .with_dropout(0.0)
        .with_layer_norm_eps(NORM_EPSILON)
        .init(device)
}

pub(super) fn norm(width: usize, device: &Device) -> LayerNorm {
    LayerNormConfig::new(width).with_epsilon(NORM_EPSILON).init(device)
}

/// Sines and cosines of column and row of every patch, `[patch, width]`; that of the class token is 0.
fn positions(width: usize, device: &Device) -> Tensor<2> {
    let quarter = width / 4;
    let of = |at: usize| {
        let angle = move |k: usize| at as f64 / 10_000f64.powf(k as f64 / quarter as f64);
        let sines = (0..quarter).map(move |k| angle(k).sin() as f32);
        sines.chain((0..quarter).map(move |k| angle(k).cos() as f32))
    };
    let all = (0..PATCHES).flat_map(|patch| of(patch % GRID).chain(of(patch / GRID)));
    tensor(all.collect(), [PATCHES, width], device)
}

/// Scans `[scan, taxel]` to patches `[scan, patch, taxel of it]`.
fn patches(scans: Tensor<2>) -> Tensor<3> {
    let [count, _] = scans.dims();
    scans.reshape([count, GRID, SIDE, GRID, SIDE]).swap_dims(2, 3).reshape([count, PATCHES, PATCH])
}

/// Rows `[row, width]` by their numbers, as `[scan, row of it, width]`.
fn rows(of: Tensor<2>, indices: Vec<i32>, scans: usize) -> Tensor<3> {
    let [_, width] = of.dims();
    let count = indices.len();
    let indices = Tensor::<1, Int>::from_data(&indices[..], &of.device());
    of.select(0, indices).reshape([scans, count / scans, width])
}

#[derive(Module, Debug)]
pub struct Vit {
    patch: Linear,
    class_token: Param<Tensor<3>>,
    encoder: TransformerEncoder,
    norm: LayerNorm,
}

impl Vit {
    pub fn new(device: &Device) -> Self {
        Self {
            patch: LinearConfig::new(PATCH, EMBED).init(device),
            class_token: Param::from_tensor(Tensor::zeros([1, 1, EMBED], device)),
            encoder: layers(EMBED, 8, 8, device),
            norm: norm(EMBED, device),
        }
    }

    /// Scans `[scan, taxel]` to the class token `[scan, embedding]`.
    pub fn forward(&self, scans: Tensor<2>) -> Tensor<2> {
        let patches = patches(scans);
        let [count, ..] = patches.dims();
        let all = (0..count).flat_map(|_| 0..PATCHES as i32).collect();
        self.encode(patches, all).narrow(1, 0, 1).reshape([count, EMBED])
    }

    /// Class token and tokens `[scan, 1 + patch, embedding]` of some patches `[scan, patch, taxel]` and where they
    /// lie, `[scan, patch]`.
    fn encode(&self, patches: Tensor<3>, places: Vec<i32>) -> Tensor<3> {
        let [count, ..] = patches.dims();
        let positions = rows(positions(EMBED, &patches.device()), places, count);
        let tokens = self.patch.forward(patches) + positions;
        let tokens = Tensor::cat(vec![self.class_token.val().repeat_dim(0, count), tokens], 1);
        self.norm.forward(self.encoder.forward(TransformerEncoderInput::new(tokens)))
    }
}

/// Which patches a step of the pretraining shows: of every scan the first ones of an order of its own.
#[derive(Clone, Debug)]
pub struct MaskedPatches {
    /// Patches of every scan, the shown ones first, `[scan][patch]`.
    pub order: Vec<Vec<usize>>,
    /// How many are shown.
    pub shown: usize,
}

impl MaskedPatches {
    /// One share for all scans of a step, orders of their own.
    pub fn draw(scans: usize, rng: &mut ChaCha8Rng) -> Self {
        let shown = (PATCHES as f64 * (1.0 - rng.random_range(MASKED))) as usize;
        let order = || {
            let mut order: Vec<usize> = (0..PATCHES).collect();
            order.shuffle(rng);
            order
        };
        Self { order: std::iter::repeat_with(order).take(scans).collect(), shown }
    }

    /// Is a scan masked at all; the loss counts masked patches only, so that any other adds nothing to it.
    pub fn has_any(rng: &mut ChaCha8Rng) -> bool {
        rng.random_bool(SCANS_MASKED)
    }

    /// Row of every shown patch, or of every masked one, among all patches of all scans.
    fn rows(&self, masked: bool) -> Vec<i32> {
        let of = |(scan, order): (usize, &Vec<usize>)| {
            let part = if masked { &order[self.shown..] } else { &order[..self.shown] };
            part.iter().map(|patch| (scan * PATCHES + patch) as i32).collect::<Vec<_>>()
        };
        self.order.iter().enumerate().flat_map(of).collect()
    }
}

/// The encoder with what its pretraining needs.
#[derive(Module, Debug)]
pub struct VitMae {
    pub vit: Vit,
    embed: Linear,
    mask_token: Param<Tensor<3>>,
    decoder: TransformerEncoder,
    norm: LayerNorm,
    pixels: Linear,
}

impl VitMae {
    pub fn new(device: &Device) -> Self {
        Self {
            vit: Vit::new(device),
            embed: LinearConfig::new(EMBED, DECODER).init(device),
            mask_token: Param::from_tensor(Tensor::zeros([1, 1, DECODER], device)),
            decoder: layers(DECODER, 4, 4, device),
            norm: norm(DECODER, device),
            pixels: LinearConfig::new(DECODER, PATCH).init(device),
        }
    }

    /// All patches `[scan, patch, taxel]`, made from the shown ones.
    pub fn reconstruct(&self, scans: Tensor<2>, masked: &MaskedPatches) -> Tensor<3> {
        let [count, taxels] = scans.dims();
        debug_assert_eq!((taxels, masked.order.len()), (TAXELS, count));
        let device = scans.device();
        let all = patches(scans).reshape([count * PATCHES, PATCH]);
        let places = masked.order.iter().flat_map(|order| &order[..masked.shown]).map(|&p| p as i32);
        let tokens = self.vit.encode(rows(all, masked.rows(false), count), places.collect());
        let tokens = self.embed.forward(tokens);
        let [_, shown, _] = tokens.dims();
        let class_token = tokens.clone().narrow(1, 0, 1);
        let hidden = self.mask_token.val().repeat_dim(0, count).repeat_dim(1, PATCHES + 1 - shown);
        let tokens = Tensor::cat(vec![tokens.narrow(1, 1, shown - 1), hidden], 1);
        let mut back = vec![0; count * PATCHES];
        for (scan, order) in masked.order.iter().enumerate() {
            for (at, patch) in order.iter().enumerate() {
                back[scan * PATCHES + patch] = (scan * PATCHES + at) as i32;
            }
        }
        let tokens = rows(tokens.reshape([count * PATCHES, DECODER]), back, count)
            + positions(DECODER, &device).reshape([1, PATCHES, DECODER]);
        let tokens = Tensor::cat(vec![class_token, tokens], 1);
        let tokens = self.norm.forward(self.decoder.forward(TransformerEncoderInput::new(tokens)));
        self.pixels.forward(tokens.narrow(1, 1, PATCHES))
    }

    /// Mean square error of the masked patches' taxels.
    pub fn loss(&self, scans: Tensor<2>, masked: &MaskedPatches) -> Tensor<1> {
        let [count, _] = scans.dims();
        let of_masked =
            |patches: Tensor<3>| rows(patches.reshape([count * PATCHES, PATCH]), masked.rows(true), count);
        let truth = of_masked(patches(scans.clone()));
        (of_masked(self.reconstruct(scans, masked)) - truth).powi_scalar(2).mean()
    }
}
