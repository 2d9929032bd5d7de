//! `cargo xtask retrain`: the shipped model from nothing.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use anyhow::{Context, Result};
use clap::Args;

use crate::process::{cargo, command, root, run, small_cli, target_dir};

/// Where the repository keeps the shipped model, and what is kept of its making.
const WEIGHTS: &str = "model/weights";
/// Names in the folder of a run, and in [`WEIGHTS`].
const FILES: [(&str, &str); 4] = [
    ("mean/weights.safetensors", "slipsense.safetensors"),
    ("slipsense.slipnet", "slipsense.slipnet"),
    ("manifest.json", "manifest.json"),
    (CURVE, CURVE),
];
/// Delay and misses of the flag against its false alarms.
const CURVE: &str = "operating-curve.svg";
/// The picture of the README, drawn by the model.
const PICTURE: &str = "host-tools/cli/demo/timeline.svg";

#[derive(Args)]
#[command(after_help = "\
The network is trained on generated episodes, then again on others and on what it takes
for slip in hours of disturbances: once for 12 passes, then in thirteen rounds of 3. The result
is the mean of the last three rounds.

Examples:
  cargo xtask retrain --out out/rehearsal --rehearse    every step on a handful of episodes: minutes
  cargo xtask retrain --out out/retrain                 the shipped model's recipe and seed
  cargo xtask retrain --out out/retrain --resume        go on where a run in that folder stopped
  cargo xtask retrain --out out/seed7 --seed 7          another seed
  cargo xtask retrain --out out/retrain --install       and make it the shipped one")]
pub struct Options {
    /// Folder for everything that is made
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Seed of episodes, first weights and draws
    #[arg(long, value_name = "K", default_value_t = SHIPPED_SEED, value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    seed: u64,
    /// Folder with motion.npz and surfaces.npz, recordings that some of the episodes get: see `slipsense train --help`
    #[arg(long, value_name = "DIR")]
    real_parts: Option<PathBuf>,
    /// Take every step on a handful of episodes; what comes out is worth nothing
    #[arg(long, conflicts_with = "install")]
    rehearse: bool,
    /// Keep the trainings that are done in DIR, and go on in one after its last finished epoch
    #[arg(long)]
    resume: bool,
    /// Put the result in model/weights, and draw the README's picture with it
    #[arg(long)]
    install: bool,
}

const SHIPPED_SEED: u64 = 1;
const FIRST_SIZE: [&str; 4] = ["--episodes", "760", "--epochs", "9"];
/// The second training, and a round after it.
const SECOND_SIZE: [&str; 4] = ["--episodes", "480", "--epochs", "12"];
const ROUND_SIZE: [&str; 4] = ["--episodes", "480", "--epochs", "3"];
/// The trainings after the first, each from the network of the one before: its folder, from the seed of the first to
/// its seed, so that it meets other episodes, its size, learning rate (the second: half of the first's), and the hours
/// of disturbances that it picks from.
const FURTHER: [(&str, u64, [&str; 4], &str, &str); 14] = [
    ("second", 10, SECOND_SIZE, "1.5e-3", "3"),
    ("round1", 50, ROUND_SIZE, "1.5e-3", "2"),
    ("round2", 51, ROUND_SIZE, "1.5e-3", "2"),
    ("round3", 52, ROUND_SIZE, "1.2e-3", "2"),
    ("round4", 60, ROUND_SIZE, "1.2e-3", "2"),
    ("round5", 61, ROUND_SIZE, "1e-3", "2"),
    ("round6", 62, ROUND_SIZE, "8e-4", "2"),
    ("round7", 83, ROUND_SIZE, "1.2e-3", "2"),
    ("round8", 84, ROUND_SIZE, "1.2e-3", "2"),
    ("round9", 85, ROUND_SIZE, "1e-3", "2"),
    ("round10", 90, ROUND_SIZE, "1.5e-3", "3"),
    ("round11", 91, ROUND_SIZE, "1.2e-3", "3"),
    ("round12", 92, ROUND_SIZE, "1e-3", "3"),
    ("round13", 93, ROUND_SIZE, "1e-3", "2"),
];
/// After the first training, what decides alarms counts more.
const EXTREME_WEIGHT: &str = "4";
/// Trainings in the mean, the last ones.
const MEAN_OF: usize = 3;
/// A training of a rehearsal.
const REHEARSAL_SIZE: [&str; 4] = ["--episodes", "8", "--epochs", "1"];

/// Train, train on, quantize, tune; what is not said here are the commands' own defaults.
pub fn retrain(options: &Options) -> Result<()> {
    let out = std::path::absolute(&options.out)?;
    let started = Instant::now();
    let at = |name: &str| out.join(name);
    let mut last = at("first");
    timed("train", &mut train(options, &last, options.seed, &FIRST_SIZE)?)?;
    for (name, from_seed, size, rate, hours) in FURTHER {
        let mut train = train(options, &at(name), options.seed + from_seed, &size)?;
        train.arg("--start").arg(last.join("weights.safetensors")).args(["--learning-rate", rate]);
        train.args(["--extreme-weight", EXTREME_WEIGHT]);
        train.args(["--mine-hours", if options.rehearse { "0.05" } else { hours }]);
        timed("train", &mut train)?;
        last = at(name);
    }
    let averaged = FURTHER[FURTHER.len() - MEAN_OF..].iter().map(|(name, ..)| at(name));
    let mut mean = slipsense("model");
    mean.arg("mean").args(averaged).arg("--out").arg(at("mean"));
    timed("mean", &mut mean)?;

    let mut quantize = slipsense("quantize");
    quantize.arg("--weights").arg(at("mean/weights.safetensors"));
    quantize.arg("--out").arg(at("untuned.slipnet")).arg("--report").arg(at("manifest.json"));
    let mut tune = slipsense("tune");
    tune.arg(at("untuned.slipnet")).arg("--out").arg(at("slipsense.slipnet")).arg("--curve").arg(at(CURVE));
    if options.rehearse {
        quantize.args(["--calibration-episodes", "1", "--val-episodes", "1"]);
        tune.args(["--hours", "0.05", "--episodes", "8", "--per-hour", "60"]);
    }
    timed("quantize", &mut quantize)?;
    timed("tune", &mut tune)?;
    let minutes = started.elapsed().as_secs_f64() / 60.0;
    eprintln!("{} made in {minutes:.0} minutes", out.join("slipsense.slipnet").display());
    if options.install {
        let kept = root().join(WEIGHTS);
        FILES.into_iter().try_for_each(|(made, name)| copy(&at(made), &kept.join(name)))?;
        let demo = target_dir().join("demo");
        run(command(small_cli()?).args(["demo", "--out"]).arg(&demo))?;
        copy(&demo.join("timeline.svg"), &root().join(PICTURE))?;
    }
    Ok(())
}

/// One training of a size.
fn train(options: &Options, folder: &Path, seed: u64, size: &[&str]) -> Result<Command> {
    let mut train = slipsense("train");
    let size = if options.rehearse { &REHEARSAL_SIZE[..] } else { size };
    train.args(["--seed", &seed.to_string(), "--out"]).arg(folder).args(size);
    if let Some(parts) = &options.real_parts {
        train.arg("--real-parts").arg(std::path::absolute(parts)?);
    }
    // The second: stopped before it was put in the place of the first.
    let begun = ["checkpoint", "checkpoint.new/state.json"].iter().any(|at| folder.join(at).exists());
    if options.resume && begun {
        train.arg("--resume");
    }
    Ok(train)
}

/// A command of `slipsense`, built with the trainer.
fn slipsense(name: &str) -> Command {
    let mut slipsense = cargo();
    slipsense.args(["run", "--release", "--quiet", "--features", "train", "--", name]);
    slipsense
}

/// Run it, and say how long it took.
fn timed(name: &str, command: &mut Command) -> Result<()> {
    let begun = Instant::now();
    run(command)?;
    eprintln!("{name} took {:.0} s", begun.elapsed().as_secs_f64());
    Ok(())
}

fn copy(from: &Path, to: &Path) -> Result<()> {
    fs::copy(from, to).with_context(|| format!("cannot copy {} to {}", from.display(), to.display()))?;
    Ok(())
}
