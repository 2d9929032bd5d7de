//! The network as three tract graphs: one sensor's array, its accelerometer, and what follows the maximum over sensors.

use std::sync::Arc;

use anyhow::{Context, Result};
use slipsense::net::format::Dims;
use slipsense::params::{PIEZO_CHANNELS, TAXEL_COLS, TAXEL_ROWS, XL_FEATURES};
use tract_core::ops::array::{Slice, TypedConcat};
use tract_core::ops::change_axes::AxisOp;
use tract_core::ops::cnn::{Conv, KernelFormat, MaxPool, PaddingSpec, PoolSpec};
use tract_core::ops::einsum::EinSum;
use tract_core::ops::math::{add, max, mul, rsqrt, sub};
use tract_core::ops::nn::{DataFormat, Reduce, Reducer, Softmax, SoftmaxKind};
use tract_core::prelude::*;

use crate::float::NORM_EPSILON;
use crate::piezo;
use crate::trace::ACTIVATIONS;
use crate::weights::Weights;

/// The compiled graphs of one set of weights.
pub struct Graphs {
    pub(super) dims: Dims,
    /// Count and change `[1, 2, 32, 32]` to the embedding `[1, embed]`.
    pub(super) piezo: Compiled,
    /// Frames of the accelerometer `[1, xl_kernel · 32]`, oldest first, to the embedding `[1, embed]`.
    pub(super) xl: Compiled,
    /// Both embeddings, the mask `[1, window]` and six caches `[window, width]` to the outputs `[1, 4]` and the
    /// six caches of the next frame.
    pub(super) fuse: Compiled,
}

/// A compiled graph, and the [`ACTIVATIONS`] that it returns behind its outputs.
pub(super) struct Compiled {
    pub(super) model: Arc<TypedRunnableModel>,
    pub(super) traced: Vec<&'static str>,
}

impl Graphs {
    pub fn new(weights: &Weights) -> Result<Self> {
        Self::compile(weights, false)
    }

    /// The same with all activations as outputs, to measure ranges and to compare networks.
    pub fn traced(weights: &Weights) -> Result<Self> {
        Self::compile(weights, true)
    }

    fn compile(weights: &Weights, trace: bool) -> Result<Self> {
        let model = TypedModel::default;
        let graph = || Graph { model: model(), weights, trace, traced: Vec::new(), caches: Vec::new() };
        Ok(Self {
            dims: weights.dims,
            piezo: graph().piezo().context("tract graph of the array")?,
            xl: graph().xl().context("tract graph of the accelerometer")?,
            fuse: graph().fuse().context("tract graph of the fusion")?,
        })
    }
}

fn reshape(from: &[usize], to: &[usize]) -> AxisOp {
    let [from, to] = [from, to].map(|shape| shape.iter().map(|&size| TDim::from(size)).collect());
    AxisOp::Reshape(0, from, to)
}

struct Graph<'w> {
    model: TypedModel,
    weights: &'w Weights,
    trace: bool,
    traced: Vec<(&'static str, OutletId)>,
    /// Keys and values of the attention blocks so far, for the next frame.
    caches: Vec<OutletId>,
}

impl Graph<'_> {
    fn piezo(mut self) -> Result<Compiled> {
        let mut map = self.input("image", &[1, PIEZO_CHANNELS, TAXEL_ROWS, TAXEL_COLS])?;
        self.trace_map("taxels", map)?;
        for layer in piezo::LAYERS {
            map = self.conv_relu_pool(layer, map)?;
            self.trace_map(layer, map)?;
        }
        let [.., channels] = self.weights.dims.conv_channels;
        let side = TAXEL_ROWS >> piezo::LAYERS.len();
        // The dense layer takes its inputs in row, column, channel order.
        let map = self.wire("rows_first", AxisOp::Move(1, 3), &[map])?;
        let flat = reshape(&[1, side, side, channels], &[1, side * side * channels]);
        let map = self.wire("flat", flat, &[map])?;
        let embedding = self.dense("piezo.dense", map)?;
        self.trace("piezo", embedding);
        self.compile(&[embedding])
    }

    fn xl(mut self) -> Result<Compiled> {
        let seen = self.input("log_mel", &[1, self.weights.dims.xl_kernel * XL_FEATURES])?;
        self.trace("log_mel", seen);
        let mut hidden = seen;
        for layer in ["xl.conv", "xl.mix1"] {
            hidden = self.dense(layer, hidden)?;
            hidden = self.relu(layer, hidden)?;
            self.trace(layer, hidden);
        }
        let embedding = self.dense("xl.mix2", hidden)?;
        self.trace("xl", embedding);
        self.compile(&[embedding])
    }

    fn fuse(mut self) -> Result<Compiled> {
        let Dims { embed, window, .. } = self.weights.dims;
        let piezo = self.input("piezo", &[1, embed])?;
        let xl = self.input("xl", &[1, embed])?;
        let mask = self.input("mask", &[1, window])?;
        let first = self.attend("cross_piezo", piezo, xl, mask)?;
        let second = self.attend("cross_xl", xl, piezo, mask)?;
        let fused = self.wire("fused", TypedConcat { axis: 1 }, &[first, second])?;
        self.trace("fused", fused);
        let hidden = self.attend("temporal", fused, fused, mask)?;
        self.trace("hidden", hidden);
        let logits = self.dense("head", hidden)?;
        self.trace("logits", logits);
        let outputs = [&[logits][..], &self.caches].concat();
        self.compile(&outputs)
    }

    fn compile(mut self, outputs: &[OutletId]) -> Result<Compiled> {
        let outlets = self.traced.iter().map(|&(_, outlet)| outlet);
        let outputs: Vec<OutletId> = outputs.iter().copied().chain(outlets).collect();
        self.model.select_output_outlets(&outputs)?;
        let traced = self.traced.iter().map(|&(activation, _)| activation).collect();
        Ok(Compiled { model: self.model.into_optimized()?.into_runnable()?, traced })
    }

    /// Return this activation behind the outputs, if the graph is traced.
    fn trace(&mut self, activation: &str, outlet: OutletId) {
        if self.trace {
            let listed = ACTIVATIONS.into_iter().find(|&listed| listed == activation);
            self.traced.push((listed.expect("activations are listed"), outlet));
        }
    }

    /// The same of a map `[1, channels, rows, columns]`, in row, column, channel order.
    fn trace_map(&mut self, activation: &str, map: OutletId) -> Result<()> {
        if self.trace {
            let map = self.wire(&format!("{activation}.traced"), AxisOp::Move(1, 3), &[map])?;
            self.trace(activation, map);
        }
        Ok(())
    }

    fn input(&mut self, name: &str, shape: &[usize]) -> Result<OutletId> {
        self.model.add_source(name, f32::fact(shape))
    }

    fn constant(&mut self, name: &str, shape: &[usize], values: &[f32]) -> Result<OutletId> {
        self.model.add_const(name, Tensor::from_shape(shape, values)?)
    }

    fn wire(&mut self, name: &str, op: impl Into<Box<dyn TypedOp>>, from: &[OutletId]) -> Result<OutletId> {
        let outlets = self.model.wire_node(name, op, from)?;
        outlets.first().copied().context("a node without output")
    }

    /// `[1, inputs]` to `[1, outputs]`.
    fn dense(&mut self, layer: &str, x: OutletId) -> Result<OutletId> {
        let bias = self.weights.get(layer, "bias");
        let weight = self.weights.get(layer, "weight");
        let (outputs, inputs) = (bias.len(), weight.len() / bias.len());
        let weight = self.constant(&format!("{layer}.weight"), &[outputs, inputs], weight)?;
        let bias = self.constant(&format!("{layer}.bias"), &[1, outputs], bias)?;
        let product = self.einsum(&format!("{layer}.product"), "bi,oi->bo", [x, weight])?;
        self.wire(layer, add(), &[product, bias])
    }

    fn einsum(&mut self, name: &str, formula: &str, from: [OutletId; 2]) -> Result<OutletId> {
        self.wire(name, EinSum::new(formula.parse()?, f32::datum_type()), &from)
    }

    fn relu(&mut self, layer: &str, x: OutletId) -> Result<OutletId> {
        let rank = self.model.outlet_fact(x)?.rank();
        let zero = self.constant(&format!("{layer}.zero"), &vec![1; rank], &[0.0])?;
        self.wire(&format!("{layer}.relu"), max(), &[x, zero])
    }

    /// `[1, inputs, side, side]` to `[1, outputs, side / 2, side / 2]`.
    fn conv_relu_pool(&mut self, layer: &str, x: OutletId) -> Result<OutletId> {
        let [weight, bias] = ["weight", "bias"].map(|part| self.weights.get(layer, part));
        let (inputs, outputs) = (weight.len() / bias.len() / 9, bias.len());
        let weight = self.constant(&format!("{layer}.weight"), &[outputs, 3, 3, inputs], weight)?;
        let bias = self.constant(&format!("{layer}.bias"), &[outputs], bias)?;
        let window = PoolSpec {
            data_format: DataFormat::NCHW,
            kernel_shape: tvec![3, 3],
            padding: PaddingSpec::Explicit(tvec![1, 1], tvec![1, 1]),
            dilations: None,
            strides: None,
            input_channels: inputs,
            output_channels: outputs,
        };
        let conv =
            Conv { pool_spec: window.clone(), kernel_fmt: KernelFormat::OHWI, group: 1, q_params: None };
        let map = self.wire(layer, conv, &[x, weight, bias])?;
        let map = self.relu(layer, map)?;
        let window = PoolSpec {
            kernel_shape: tvec![2, 2],
            padding: PaddingSpec::Valid,
            strides: Some(tvec![2, 2]),
            input_channels: outputs,
            ..window
        };
        let pool = MaxPool { pool_spec: window, with_index_outputs: None };
        self.wire(&format!("{layer}.pool"), pool, &[map])
    }

    /// The block's output `[1, width]`.
    fn attend(&mut self, block: &str, x: OutletId, seen: OutletId, mask: OutletId) -> Result<OutletId> {
        let dims = self.weights.dims;
        let name = |part: &str| format!("{block}.{part}");
        let width = self.weights.get(&name("query"), "bias").len();
        let head_width = width / dims.heads;
        let query = self.dense(&name("query"), x)?;
        self.trace(&name("query"), query);
        let keys = self.remember(&name("key"), seen, width)?;
        let values = self.remember(&name("value"), seen, width)?;

        let by_head = |rows: usize| reshape(&[rows, width], &[rows, dims.heads, head_width]);
        let query = self.wire(&name("query_by_head"), by_head(1), &[query])?;
        let keys_by_head = self.wire(&name("keys_by_head"), by_head(dims.window), &[keys])?;
        let values_by_head = self.wire(&name("values_by_head"), by_head(dims.window), &[values])?;
        let scores = self.einsum(&name("products"), "bhd,lhd->hl", [query, keys_by_head])?;
        let scale = self.constant(&name("scale"), &[1, 1], &[1.0 / (head_width as f32).sqrt()])?;
        let scores = self.wire(&name("scaled"), mul(), &[scores, scale])?;
        let by_lag = self.weights.get(&name("score"), "bias");
        let by_lag = self.constant(&name("score.bias"), &[dims.heads, dims.window], by_lag)?;
        let scores = self.wire(&name("score"), add(), &[scores, by_lag])?;
        let scores = self.wire(&name("masked"), add(), &[scores, mask])?;
        let softmax = Softmax { axes: tvec![1], quant_output_dt: None, kind: SoftmaxKind::Softmax };
        let weights = self.wire(&name("softmax"), softmax, &[scores])?;
        let context = self.einsum(&name("context_by_head"), "hl,lhd->hd", [weights, values_by_head])?;
        let flat = reshape(&[dims.heads, head_width], &[1, width]);
        let context = self.wire(&name("context"), flat, &[context])?;
        let projected = self.dense(&name("out"), context)?;
        let sum = self.wire(&name("residual"), add(), &[x, projected])?;
        self.trace(&name("residual"), sum);
        self.layer_norm(&name("norm"), sum)
    }

    /// Put the newest frame's projection in front of a cache `[window, width]`; its oldest frame drops out.
    fn remember(&mut self, layer: &str, seen: OutletId, width: usize) -> Result<OutletId> {
        let window = self.weights.dims.window;
        let old = self.input(&format!("{layer}.old"), &[window, width])?;
        let newest = self.dense(layer, seen)?;
        self.trace(layer, newest);
        let mut cache = newest;
        if window > 1 {
            let kept = self.wire(&format!("{layer}.kept"), Slice::new(0, 0, window - 1), &[old])?;
            cache = self.wire(&format!("{layer}.cache"), TypedConcat { axis: 0 }, &[newest, kept])?;
        }
        self.caches.push(cache);
        Ok(cache)
    }

    fn layer_norm(&mut self, norm: &str, x: OutletId) -> Result<OutletId> {
        let name = |part: &str| format!("{norm}.{part}");
        let gamma = self.weights.get(norm, "gamma");
        let width = gamma.len();
        let reduce = |reducer| Reduce { axes: tvec![1], reducer };
        let sum = self.wire(&name("sum"), reduce(Reducer::Sum), &[x])?;
        let share = self.constant(&name("share"), &[1, 1], &[1.0 / width as f32])?;
        let mean = self.wire(&name("mean"), mul(), &[sum, share])?;
        let centred = self.wire(&name("centred"), sub(), &[x, mean])?;
        let variance = self.wire(&name("variance"), reduce(Reducer::MeanOfSquares), &[centred])?;
        let epsilon = self.constant(&name("epsilon"), &[1, 1], &[NORM_EPSILON as f32])?;
        let variance = self.wire(&name("variance_and_epsilon"), add(), &[variance, epsilon])?;
        let scale = self.wire(&name("scale"), rsqrt(), &[variance])?;
        let standard = self.wire(&name("standard"), mul(), &[centred, scale])?;
        let gamma = self.constant(&name("gamma"), &[1, width], gamma)?;
        let beta = self.constant(&name("beta"), &[1, width], self.weights.get(norm, "beta"))?;
        let scaled = self.wire(&name("scaled"), mul(), &[standard, gamma])?;
        self.wire(norm, add(), &[scaled, beta])
    }
}
