//! What a network costs: multiplications per frame, bytes, and how much of its accumulators it can use.

use slipsense::fixed::QUERY_KEY_MAX;
use slipsense::net::Model;
use slipsense::net::format::{Dims, TensorSpec, layout};
use slipsense::net::softmax::WEIGHTED_SUM_MAX;
use slipsense::params::TAXEL_ROWS;

/// Most multiply-accumulates per frame of the shipped network with one sensor.
pub const MACS_MAX_ONE_SENSOR: usize = 750_000;
/// The same with three sensors.
pub const MACS_MAX_THREE_SENSORS: usize = 1_950_000;

/// One layer of the file, in file order: a dense layer or convolution, the scores of an attention block, or a
/// norm.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LayerCost {
    /// As in [`layout`].
    pub name: &'static str,
    /// Outputs and inputs of one output; heads and lags of the scores; 1 and channels of a norm.
    pub shape: [usize; 2],
    /// Bytes of its tensors in the file, padding included.
    pub bytes: usize,
    /// Multiply-accumulates of one pass.
    pub macs: usize,
    /// Is there a pass per sensor? Else there is one per frame.
    pub per_sensor: bool,
    /// The activation that it gives, by the name under which the provenance holds its scale; none for scores.
    pub gives: Option<&'static str>,
    /// Largest magnitude that any of its accumulators can reach for any input, as
    /// [`Model::parse`] proves it; at most 2^31 − 1.
    pub bound: i64,
}

impl LayerCost {
    /// Multiply-accumulates per frame with this many sensors.
    pub fn macs_per_frame(&self, sensors: usize) -> usize {
        if self.per_sensor { sensors * self.macs } else { self.macs }
    }

    /// Bits of the accumulator that no input can reach: `31 − log2(bound)`, 0 to 31.
    pub fn head_room_bits(&self) -> f64 {
        31.0 - (self.bound.max(1) as f64).log2()
    }
}

/// The layers of a model with their cost.
///
/// Counted are the products of activations with weights and with each other, at full contact: every taxel, and
/// attention over the full window, where each lag takes one product per column for its score and one for its
/// value. A convolution counts as what it is, though its kernel does two products for three. Not counted are norms,
/// softmax, requantization, residual sums and the front end: a few operations per activation.
pub fn layers(model: &Model<'_>) -> Vec<LayerCost> {
    let specs = layout(&model.dims);
    specs.chunk_by(|a, b| a.layer == b.layer).map(|parts| layer(model, parts)).collect()
}

/// Sum over the layers, multiply-accumulates per frame.
pub fn macs_per_frame(layers: &[LayerCost], sensors: usize) -> usize {
    layers.iter().map(|layer| layer.macs_per_frame(sensors)).sum()
}

/// `parts`: the tensors of one layer. Its weights give its shape, the scores' bias theirs, the gain a norm's.
fn layer(model: &Model<'_>, parts: &[TensorSpec]) -> LayerCost {
    let dims = &model.dims;
    let name = parts.first().map_or("", |part| part.layer);
    let find = |wanted: &str| parts.iter().find(|part| part.part == wanted);
    let shape =
        find("weight").or(find("gamma")).or(find("bias")).map_or([0, 0], |part| [part.rows, part.cols]);
    let (block, part) = name.split_once('.').unwrap_or(("", name));
    let per_sensor = matches!(block, "piezo" | "xl");
    let [outputs, inputs] = shape;
    let macs = match (block, part) {
        ("piezo", "conv1" | "conv2" | "conv3") => positions(part) * outputs * inputs,
        (_, "score") => 2 * width(dims, block) * dims.window,
        (_, "norm") => 0,
        _ => outputs * inputs,
    };
    let bytes = parts.iter().map(TensorSpec::padded_bytes).sum();
    LayerCost { name, shape, bytes, macs, per_sensor, gives: gives(name), bound: bound(model, block, part) }
}

/// Places of the map that a convolution is computed at, before its pool.
fn positions(conv: &str) -> usize {
    let side = match conv {
        "conv1" => TAXEL_ROWS,
        "conv2" => TAXEL_ROWS / 2,
        _ => TAXEL_ROWS / 4,
    };
    side * side
}

/// A residual sum is what an attention block's last projection gives; other layers give what they are called,
/// but for those with a shorter name.
fn gives(layer: &'static str) -> Option<&'static str> {
    Some(match layer {
        "piezo.dense" => "piezo",
        "xl.mix2" => "xl",
        "cross_piezo.out" => "cross_piezo.residual",
        "cross_xl.out" => "cross_xl.residual",
        "temporal.out" => "temporal.residual",
        "cross_piezo.norm" | "cross_xl.norm" => "fused",
        "temporal.norm" => "hidden",
        "head" => "logits",
        score if score.ends_with(".score") => return None,
        other => other,
    })
}

fn width(dims: &Dims, block: &str) -> usize {
    if block == "temporal" { dims.fused() } else { dims.embed }
}

/// Largest magnitude of an accumulator of this layer, norm or score.
fn bound(model: &Model<'_>, block: &str, part: &str) -> i64 {
    let [conv1, conv2, conv3] = &model.conv;
    let [xl_conv, mix1, mix2] = &model.xl;
    let attention = match block {
        "cross_piezo" => Some(&model.cross_piezo),
        "cross_xl" => Some(&model.cross_xl),
        "temporal" => Some(&model.temporal),
        _ => None,
    };
    let layer = match (attention, block, part) {
        (Some(block), _, "query") => &block.query,
        (Some(block), _, "key") => &block.key,
        (Some(block), _, "value") => &block.value,
        (Some(block), _, "out") => &block.out,
        (Some(block), _, "norm") => return block.norm.accumulator_bounds().max().unwrap_or(0),
        (Some(block), ..) => {
            let head_width = (block.query.outputs / block.heads) as i64;
            let scores = head_width * i64::from(QUERY_KEY_MAX) * i64::from(QUERY_KEY_MAX);
            return scores.max(WEIGHTED_SUM_MAX);
        }
        (None, "piezo", "conv1") => conv1,
        (None, "piezo", "conv2") => conv2,
        (None, "piezo", "conv3") => conv3,
        (None, "piezo", _) => &model.piezo_dense,
        (None, "xl", "conv") => xl_conv,
        (None, "xl", "mix1") => mix1,
        (None, "xl", _) => mix2,
        _ => &model.head,
    };
    layer.accumulator_bounds().max().unwrap_or(0)
}
