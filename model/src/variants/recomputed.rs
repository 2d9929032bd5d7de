//! The network without its memory: every frame from its own window of frames, as the paper runs its own.
//!
//! The shipped network keeps keys and values of the last frames. Those were made when still older frames were
//! in view, so through two attentions, one behind the other, a frame reaches back nearly two windows. Here the
//! cache is built anew for every frame, and nothing from before the window is seen. The front end is not the
//! network: log-mel and the taxels' change keep their own short past.

use burn::tensor::{Device, Tensor, TensorData};
use rayon::prelude::*;
use slipsense::params::{OUTPUTS, XL_FEATURES};

use super::Variant;
use super::network::Extent;
use crate::float::{FloatNetwork, Sequences, plain};

/// Windows that are run at once.
const BATCH: usize = 64;

/// Logits of every frame of one sequence, each from the frames of its window alone. `device` is a plain one.
///
/// # Panics
/// If `input` is not one sequence of one frame or more.
pub fn logits(
    network: &FloatNetwork,
    variant: &Variant,
    input: &Sequences,
    device: &Device,
) -> Vec<[f32; OUTPUTS]> {
    assert!(input.batch == 1 && input.frames > 0, "one sequence");
    let graph = network.graph(variant);
    let piezo = graph.features(&input.piezo, device).map(|features| graph.dense("piezo.dense", features));
    let frames = input.frames.min(variant.window);
    let starts: Vec<usize> = (0..=input.frames - frames).collect();
    let of_windows = |starts: &[usize]| {
        let extent = Extent { batch: starts.len(), sensors: input.sensors, frames };
        let rows = rows(input, starts, frames);
        let bins = rows.iter().flat_map(|row| &input.xl[row * XL_FEATURES..][..XL_FEATURES]);
        let sequences = Sequences {
            batch: extent.batch,
            sensors: extent.sensors,
            frames,
            xl: bins.copied().collect(),
            ..Default::default()
        };
        let indices: Vec<i32> = rows.iter().map(|&row| row as i32).collect();
        let indices = TensorData::new(indices, [rows.len()]);
        let seen = piezo.clone().map(|x| x.select(0, Tensor::from_data(indices, device)));
        let xl = variant.embed_xl(&graph, &sequences, device);
        plain(variant.decide(&graph, extent, seen, xl, device))
    };
    let all: Vec<Vec<[f32; OUTPUTS]>> = starts.par_chunks(BATCH).map(of_windows).collect();
    let mut windows = all.iter().flat_map(|logits| logits.chunks_exact(frames));
    // The first window is all there is for its frames, any other is for its last one.
    let first = windows.next().unwrap_or_default().iter();
    first.chain(windows.filter_map(|window| window.last())).copied().collect()
}

/// Where each frame of each sensor of each window lies in the sequence.
fn rows(input: &Sequences, starts: &[usize], frames: usize) -> Vec<usize> {
    let sensors = |start: usize| (0..input.sensors).map(move |sensor| sensor * input.frames + start);
    starts.iter().flat_map(|&start| sensors(start)).flat_map(|from| from..from + frames).collect()
}
