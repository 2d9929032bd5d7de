//! What each variant computes, of the shipped network's layers.

use std::borrow::Cow;

use burn::tensor::Tensor;
use slipsense::net::format::{Dims, Kind, TensorSpec};
use slipsense::params::{MEL_BINS, XL_FEATURES};

use super::{BASE, Fusion, Modality, Pool, Variant};
use crate::float::{Architecture, Band, Graph, Sequences};
use crate::weights::{Weights, dims_of_size, first_values, specs};

/// Of [`Pool::WithMean`]: shares of the mean, by channel; 0 before training.
const MEAN_LAYERS: [&str; 2] = ["piezo.mean", "xl.mean"];

/// Name of the accelerometers' own layer in late fusion.
fn late_name(layer: &str) -> &'static str {
    match layer {
        "temporal.query" => "temporal_xl.query",
        "temporal.key" => "temporal_xl.key",
        "temporal.value" => "temporal_xl.value",
        "temporal.out" => "temporal_xl.out",
        "temporal.score" => "temporal_xl.score",
        "temporal.norm" => "temporal_xl.norm",
        _ => "head_xl",
    }
}

impl Variant {
    /// Sizes, those of the shipped network but for the variant's own.
    pub const fn dims(&self) -> Dims {
        Dims { xl_kernel: self.xl_kernel, window: self.window, ..dims_of_size(self.size) }
    }

    /// Parameters before training.
    pub fn first_weights(&self, seed: u64) -> Weights {
        Weights { dims: self.dims(), tensors: first_values(&self.specs(), seed) }
    }

    /// Embeddings `[batch · sensor · frame, embed]` of the accelerometers; none if there are none.
    fn embed_xl(&self, graph: &Graph<'_>, input: &Sequences) -> Option<Tensor<2>> {
        if self.modality == Modality::Piezo {
            return None;
        }
        let mut values = Cow::Borrowed(&input.xl[..]);
        if !self.over_floor {
            values.to_mut().chunks_exact_mut(XL_FEATURES).for_each(|frame| frame[MEL_BINS..].fill(0.0));
        }
        Some(graph.xl(&values, input.frames))
    }

    /// Logits `[batch, frame, class]` of the embeddings `[batch · sensor · frame, embed]` that there are.
    pub(super) fn decide(
        &self,
        graph: &Graph<'_>,
        input: &Sequences,
        piezo: Option<Tensor<2>>,
        xl: Option<Tensor<2>>,
    ) -> Tensor<3> {
        let &Sequences { batch, sensors, frames, .. } = input;
        let band = Band::new(frames, self.window, &graph.device);
        let of_sensors = |x: Tensor<2>| {
            let [_, width] = x.dims();
            x.reshape([batch * sensors, frames, width])
        };
        let widest = |x: Tensor<3>| {
            let [_, _, width] = x.dims();
            x.reshape([batch, sensors, frames, width]).max_dim(1).reshape([batch, frames, width])
        };
        let with_mean = |layer: &str, x: Tensor<3>| {
            let [_, _, width] = x.dims();
            let mean = x.clone().reshape([batch, sensors, frames, width]).mean_dim(1);
            let share = graph.get(layer, "share").reshape([1, 1, width]);
            widest(x) + mean.reshape([batch, frames, width]) * share
        };
        // `late`: end of the names of layers that late fusion has twice.
        let alone = |first: &str, late: &str, x: Tensor<2>| {
            let x = widest(of_sensors(x));
            let x = graph.attention(first, x.clone(), x, &band);
            let x = graph.attention(&format!("temporal{late}"), x.clone(), x, &band);
            graph.head(&format!("head{late}"), x)
        };
        let (piezo, xl) = match (piezo, xl) {
            (Some(piezo), Some(xl)) if self.fusion == Fusion::Late => {
                return (alone("cross_piezo", "", piezo) + alone("cross_xl", "_xl", xl)).mul_scalar(0.5);
            }
            (Some(piezo), Some(xl)) => (of_sensors(piezo), of_sensors(xl)),
            (Some(piezo), None) => return alone("cross_piezo", "", piezo),
            (None, Some(xl)) => return alone("cross_xl", "", xl),
            (None, None) => unreachable!("every network has a modality"),
        };
        let fused = match self.pool {
            Pool::BeforeFusion => self.fuse(graph, widest(piezo), widest(xl), &band),
            Pool::AfterFusion => widest(self.fuse(graph, piezo, xl, &band)),
            Pool::WithMean => {
                self.fuse(graph, with_mean(MEAN_LAYERS[0], piezo), with_mean(MEAN_LAYERS[1], xl), &band)
            }
        };
        graph.head("head", graph.attention("temporal", fused.clone(), fused, &band))
    }

    /// Both modalities side by side, `[sequence, frame, 2 · embed]`.
    fn fuse(&self, graph: &Graph<'_>, piezo: Tensor<3>, xl: Tensor<3>, band: &Band) -> Tensor<3> {
        let ask = |block: &str, x: &Tensor<3>, seen: &Tensor<3>| {
            graph.attention(block, x.clone(), seen.clone(), band)
        };
        let parts = match self.fusion {
            Fusion::CrossAttention => vec![ask("cross_piezo", &piezo, &xl), ask("cross_xl", &xl, &piezo)],
            Fusion::OwnAttention => vec![ask("cross_piezo", &piezo, &piezo), ask("cross_xl", &xl, &xl)],
            Fusion::Concatenation | Fusion::Late => vec![piezo, xl],
        };
        Tensor::cat(parts, 2)
    }
}

/// The layers of [`BASE`] in these sizes.
impl Architecture for Dims {
    fn specs(&self) -> Vec<TensorSpec> {
        specs(self)
    }

    fn forward(&self, graph: &Graph<'_>, input: &Sequences, features: Option<Tensor<2>>) -> Tensor<3> {
        Variant { window: self.window, ..BASE }.forward(graph, input, features)
    }
}

impl Architecture for Variant {
    fn specs(&self) -> Vec<TensorSpec> {
        let dims = self.dims();
        let deciding = |spec: &TensorSpec| spec.layer.starts_with("temporal.") || spec.layer == "head";
        let has = |spec: &TensorSpec| {
            let layer = spec.layer;
            let missing = match self.modality {
                Modality::Both => false,
                Modality::Piezo => layer.starts_with("xl.") || layer.starts_with("cross_xl."),
                Modality::Xl => layer.starts_with("piezo.") || layer.starts_with("cross_piezo."),
            };
            let skipped = self.modality == Modality::Both
                && self.fusion == Fusion::Concatenation
                && layer.starts_with("cross_");
            !missing && !skipped
        };
        let mut all: Vec<TensorSpec> = specs(&dims).into_iter().filter(has).collect();
        if self.modality != Modality::Both || self.fusion == Fusion::Late {
            // The modalities, or the one there is, reach the head in stacks of their own.
            // As wide as one modality: those of a network whose two embeddings are half as wide.
            all.retain(|spec| !deciding(spec));
            let half = specs(&Dims { embed: dims.embed / 2, ..dims });
            all.extend(half.iter().copied().filter(deciding));
            if self.modality == Modality::Both {
                let renamed = |spec: TensorSpec| TensorSpec { layer: late_name(spec.layer), ..spec };
                all.extend(half.iter().copied().filter(deciding).map(renamed));
            }
        }
        if self.pool == Pool::WithMean {
            let kind = Kind::I16;
            let share = |layer| TensorSpec { layer, part: "share", kind, rows: 1, cols: dims.embed };
            all.extend(MEAN_LAYERS.map(share));
        }
        all
    }

    fn forward(&self, graph: &Graph<'_>, input: &Sequences, features: Option<Tensor<2>>) -> Tensor<3> {
        let piezo = features.map(|features| graph.dense("piezo.dense", features));
        self.decide(graph, input, piezo, self.embed_xl(graph, input))
    }
}
