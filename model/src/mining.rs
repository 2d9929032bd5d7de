//! Hard examples: stretches of hours without slip that a trained network takes for slip, or nearly.
//!
//! Always-on detectors are trained on what they get wrong, as most of any hour teaches nothing more.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use burn::tensor::Device;
use clap::Args;
use indicatif::ProgressBar;
use serde_json::{Value, json};
use slipsense::params::OUTPUTS;
use slipsense_synth::{Recipe, Shard, Split, generate_set, vary_two_of_three};

use crate::data::{DISTURBANCES_SECONDS, Features, disturbances, first, stretches_file};
use crate::float::FloatNetwork;
use crate::output;
use crate::progress::progress;
use crate::real_parts::RealParts;
use crate::target::Target;
use crate::weights::Weights;

/// Most hours to search: an episode's number in a file's name has five digits.
const MOST_HOURS: f64 = 555.0;
/// Frames of a stretch that is kept or not: two seconds.
const STRETCH_FRAMES: usize = 480;
/// A stretch is kept if the log-odds of a touched frame without slip are above this, nat.
const HARD_NAT: f32 = 1.0;
/// Added to the seed of a run, so that its other episodes do not occur here.
const SEED_OFFSET: u64 = 1_000;

/// File of a folder that says what it was mined with.
const SETTINGS: &str = "mine.json";

/// Find hard examples: generated disturbances that a trained network takes for slip, or nearly
///
/// Writes a file of stretches of two seconds for every 20 s of disturbances; `slipsense train --mined DIR`
/// trains on them, like `train --mine-hours` on those that it finds itself. Files that are there are not made
/// again. Several processes can share the work with --shard, as `python -m slipsense.ray` does.
#[derive(Args, Clone, Debug)]
pub struct MineArgs {
    /// Float weights of the network, from `slipsense train`
    #[arg(value_name = "WEIGHTS")]
    pub weights: PathBuf,
    /// Folder for the stretches; made if it is not there
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Hours of disturbances to search
    #[arg(long, value_name = "H", default_value_t = 1.0)]
    pub hours: f64,
    /// Seed of the run that will train on them: its other episodes do not occur here
    #[arg(long, value_name = "K", default_value_t = 1)]
    pub seed: u64,
    /// Folder with motion.npz and surfaces.npz, recorded motion and measured surfaces that some of the
    /// episodes get; docs/src/model/training.md says from which public sources they are made
    #[arg(long, value_name = "DIR")]
    pub real_parts: Option<PathBuf>,
    /// Search only part I of N: every N-th episode
    #[arg(long, value_name = "I/N", value_parser = Shard::parse)]
    pub shard: Option<Shard>,
}

pub fn run_mine(args: &MineArgs) -> Result<()> {
    ensure!(args.hours > 0.0 && args.hours <= MOST_HOURS, "--hours must be above 0 and at most {MOST_HOURS}");
    let weights = Weights::read(&args.weights)?;
    let real_parts = args.real_parts.as_deref().map(RealParts::read).transpose()?;
    output::folder(&args.out)?;
    let settings = json!({
        "weights_sha256": output::sha256_hex(&weights.to_bytes()?),
        "hours": args.hours,
        "seed": args.seed,
        "real_parts": real_parts.is_some(),
    });
    let (settings, file) = (settings.to_string(), args.out.join(SETTINGS));
    let same = !file.exists() || std::fs::read_to_string(&file).is_ok_and(|found| found == settings);
    ensure!(same, "{}: other weights, --hours, --seed or --real-parts; give another --out", file.display());
    output::write(&file, settings.as_bytes())?;
    let recipes = recipes(args.seed, args.hours)?;
    let shard = args.shard.unwrap_or(Shard::WHOLE);
    let path = |index: usize| args.out.join(stretches_name(index, recipes.len()));
    let wanted = (0..recipes.len()).filter(|&index| shard.has(index) && !path(index).exists());
    let (paths, wanted): (Vec<_>, Vec<_>) = wanted.map(|index| (path(index), recipes[index].clone())).unzip();
    let bar = progress("mine", 0);
    search(&weights, &wanted, real_parts.as_ref(), &bar, |index, stretches| {
        output::write(&paths[index], &stretches_file::to_bytes(&stretches)?)
    })?;
    bar.finish();
    println!("{}: {} of {} episodes searched", args.out.display(), wanted.len(), recipes.len());
    Ok(())
}

/// File of the stretches of an episode, of all that are searched.
fn stretches_name(index: usize, all: usize) -> String {
    format!("{:05}-of-{all:05}.safetensors", index + 1)
}

/// What a folder was mined with, for the record of a training.
pub fn settings(folder: &Path) -> Result<Value> {
    let path = folder.join(SETTINGS);
    output::read_json(&path)?
        .with_context(|| format!("{} is missing: `slipsense mine` writes it", path.display()))
}

/// The stretches of a folder that [`run_mine`] filled, in the order of the episodes.
pub fn read(folder: &Path) -> Result<Vec<Features>> {
    let paths = output::files(folder, "safetensors")?;
    let all = paths.last().and_then(|path| path.file_name()?.to_str()?.get(9..14)?.parse::<usize>().ok());
    let all =
        all.with_context(|| format!("{} holds nothing that `slipsense mine` wrote", folder.display()))?;
    for (index, path) in paths.iter().enumerate() {
        let wanted = stretches_name(index, all);
        ensure!(path.ends_with(&wanted), "{}: {wanted} is missing", folder.display());
    }
    ensure!(paths.len() == all, "{}: {} of {all} files are missing", folder.display(), all - paths.len());
    let read = |path: &PathBuf| {
        stretches_file::from_bytes(&output::read(path)?).with_context(|| path.display().to_string())
    };
    Ok(paths.iter().map(read).collect::<Result<Vec<_>>>()?.into_iter().flatten().collect())
}

/// The hard stretches of `hours` of disturbances, for a training with this seed.
pub fn mine(
    weights: &Weights,
    seed: u64,
    hours: f64,
    real_parts: Option<&RealParts>,
    bar: &ProgressBar,
) -> Result<Vec<Features>> {
    let found = search(weights, &recipes(seed, hours)?, real_parts, bar, |_, stretches| Ok(stretches))?;
    Ok(found.into_iter().flatten().collect())
}

/// Disturbances of the laboratory's physics and of other families in turn.
fn recipes(seed: u64, hours: f64) -> Result<Vec<Recipe>> {
    let count = (hours * 3600.0 / DISTURBANCES_SECONDS).ceil() as usize;
    let [anywhere, laboratory] = [Split::TrainAnywhere, Split::Train]
        .map(|split| first(split, seed + SEED_OFFSET, count.div_ceil(2)).map(disturbances));
    let recipes = anywhere.zip(laboratory).flat_map(|(a, b)| [a, b]);
    Ok(vary_two_of_three(recipes.take(count))?)
}

/// Search the episodes of some recipes, some with real recordings; `each` gets the stretches of one and its position.
/// `bar` moves once an episode.
fn search<T: Send>(
    weights: &Weights,
    recipes: &[Recipe],
    real_parts: Option<&RealParts>,
    bar: &ProgressBar,
    each: impl Fn(usize, Vec<Features>) -> Result<T> + Sync,
) -> Result<Vec<T>> {
    bar.set_length(recipes.len() as u64);
    let network = FloatNetwork::new(weights, &Device::flex());
    let found = generate_set(recipes, |index, mut episode| {
        if let Some(parts) = real_parts {
            parts.add(&mut episode);
        }
        let features = Features::from_episode(&episode)?;
        let outputs = network.outputs(&weights.dims, &features.sequences());
        bar.inc(1);
        each(index, hard(&features, &outputs))
    })?;
    found.into_iter().collect()
}

fn hard(features: &Features, outputs: &[[f32; OUTPUTS]]) -> Vec<Features> {
    let contacts: Vec<bool> = features.contacts().collect();
    let is_hard = |frame: usize| {
        let still = features.target[frame] == Target::Still;
        still && contacts[frame] && outputs[frame][OUTPUTS - 1] > HARD_NAT
    };
    let starts = (0..features.frames() / STRETCH_FRAMES).map(|index| index * STRETCH_FRAMES);
    starts
        .filter(|&start| (start..start + STRETCH_FRAMES).any(is_hard))
        .map(|start| Features { mined: true, ..features.cut(start..start + STRETCH_FRAMES) })
        .collect()
}
