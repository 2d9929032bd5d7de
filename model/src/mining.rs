//! Hard examples: stretches of hours without slip that a trained network takes for slip, or nearly.
//!
//! Always-on detectors are trained on what they get wrong, as most of any hour teaches nothing more.

use anyhow::Result;
use burn::tensor::Device;
use indicatif::ProgressBar;
use slipsense::params::OUTPUTS;
use slipsense_synth::splits::EpisodeSet;
use slipsense_synth::{Recipe, Split, generate_set};

use crate::data::{DISTURBANCES_SECONDS, Features, disturbances};
use crate::evaluate::score_float;
use crate::float::FloatNetwork;
use crate::real_parts::Motion;
use crate::target::Target;
use crate::weights::Weights;

/// Frames of a stretch that is kept or not: two seconds.
const STRETCH_FRAMES: usize = 480;
/// A stretch is kept if the log-odds of a touched frame without slip are above this, nat.
const HARD_NAT: f32 = -1.0;
/// Added to the seed of a run, so that its other episodes do not occur here.
const SEED_OFFSET: u64 = 1_000;

/// Mine `hours` of disturbances, of the laboratory's physics and of other families in turn, some with recorded motion.
/// `bar` moves once an episode.
pub fn mine(
    weights: &Weights,
    seed: u64,
    hours: f64,
    motion: Option<&Motion>,
    bar: &ProgressBar,
) -> Result<Vec<Features>> {
    let count = (hours * 3600.0 / DISTURBANCES_SECONDS).ceil() as usize;
    bar.set_length(count as u64);
    let first = |split: Split| EpisodeSet::first(split, seed + SEED_OFFSET, count.div_ceil(2)).episodes;
    let pairs = first(Split::TrainAnywhere).into_iter().zip(first(Split::Train));
    let recipes: Vec<Recipe> =
        pairs.flat_map(|(a, b)| [a, b]).map(|episode| disturbances(episode.recipe)).take(count).collect();
    let device = Device::flex();
    let network = FloatNetwork::fixed(weights, &device);
    let kept = generate_set(&recipes, |_, mut episode| {
        if let Some(motion) = motion {
            motion.add(&mut episode);
        }
        let features = Features::from_episode(&episode)?;
        let (_, outputs) = score_float(&network, &weights.dims, &features, &device);
        bar.inc(1);
        anyhow::Ok(hard(&features, &outputs))
    })?;
    Ok(kept.into_iter().collect::<Result<Vec<_>>>()?.into_iter().flatten().collect())
}

/// The hard stretches of an episode.
fn hard(features: &Features, outputs: &[[f32; OUTPUTS]]) -> Vec<Features> {
    let is_hard = |frame: usize| {
        let touched = &features.touched[frame * features.sensors..][..features.sensors];
        let still = features.target[frame] == Target::Still;
        still && touched.contains(&true) && outputs[frame][OUTPUTS - 1] > HARD_NAT
    };
    let starts = (0..features.frames() / STRETCH_FRAMES).map(|index| index * STRETCH_FRAMES);
    starts
        .filter(|&start| (start..start + STRETCH_FRAMES).any(is_hard))
        .map(|start| features.cut(start..start + STRETCH_FRAMES).into_mined())
        .collect()
}
