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
for slip in hours of disturbances: once for 12 passes, then in six rounds of 3. The result
is the mean of the last four rounds.

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
    /// Folder with motion.npz, recorded motion that some of the episodes get: see `slipsense train --help`
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

/// Seed of the shipped model.
const SHIPPED_SEED: u64 = 1;
/// From the seed of a network's first training to that of its second, so that it meets other episodes.
const SECOND_SEED: u64 = 10;
/// The first training.
const FIRST_SIZE: [&str; 4] = ["--episodes", "760", "--epochs", "9"];
/// The second training: half of the learning rate.
const SECOND_SIZE: [&str; 4] = ["--episodes", "480", "--epochs", "12"];
const SECOND_RATE: &str = "1.5e-3";
/// After the first training, what decides alarms counts more.
const EXTREME_WEIGHT: &str = "4";
/// Hours of disturbances that the second training picks from, and each round.
const MINE_HOURS: [&str; 2] = ["3", "2"];
/// The rounds: from the seed of the first training to theirs, and their learning rate.
const ROUND_SIZE: [&str; 4] = ["--episodes", "480", "--epochs", "3"];
const ROUNDS: [(u64, &str); 6] =
    [(50, "1.5e-3"), (51, "1.5e-3"), (52, "1.2e-3"), (60, "1.2e-3"), (61, "1e-3"), (62, "8e-4")];
/// Rounds in the mean, the last ones.
const MEAN_OF: usize = 4;
/// A training of a rehearsal.
const REHEARSAL_SIZE: [&str; 4] = ["--episodes", "8", "--epochs", "1"];

/// Train, train on, quantize, tune; what is not said here are the commands' own defaults.
pub fn retrain(options: &Options) -> Result<bool> {
    let out = std::path::absolute(&options.out)?;
    let started = Instant::now();
    let (seed, first) = (options.seed, out.join("first"));
    timed("train", &mut train(options, &first, seed, &FIRST_SIZE)?)?;
    let mut last = out.join("second");
    train_on(options, &first, &last, seed + SECOND_SEED, &SECOND_SIZE, SECOND_RATE, MINE_HOURS[0])?;
    let mut rounds = Vec::new();
    for (round, (from_seed, rate)) in ROUNDS.into_iter().enumerate() {
        let next = out.join(format!("round{}", round + 1));
        train_on(options, &last, &next, seed + from_seed, &ROUND_SIZE, rate, MINE_HOURS[1])?;
        rounds.push(next.clone());
        last = next;
    }
    let mut mean = slipsense("model", None::<u64>);
    mean.arg("mean").args(&rounds[ROUNDS.len() - MEAN_OF..]).arg("--out").arg(out.join("mean"));
    timed("mean", &mut mean)?;

    let at = |name: &str| out.join(name);
    let mut quantize = slipsense("quantize", None::<u64>);
    quantize
        .arg("--weights")
        .arg(at("mean").join("weights.safetensors"))
        .arg("--out")
        .arg(at("untuned.slipnet"));
    quantize.arg("--report").arg(at("manifest.json"));
    let mut tune = slipsense("tune", None::<u64>);
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
        for (made, name) in FILES {
            copy(&out.join(made), &kept.join(name))?;
        }
        let demo = target_dir().join("demo");
        run(command(small_cli()?).args(["demo", "--out"]).arg(&demo))?;
        copy(&demo.join("timeline.svg"), &root().join(PICTURE))?;
    }
    Ok(true)
}

/// One training of a size.
fn train(options: &Options, folder: &Path, seed: u64, size: &[&str]) -> Result<Command> {
    let mut train = slipsense("train", seed);
    let size = if options.rehearse { &REHEARSAL_SIZE[..] } else { size };
    train.arg("--out").arg(folder).args(size);
    if let Some(parts) = &options.real_parts {
        train.arg("--real-parts").arg(std::path::absolute(parts)?);
    }
    if options.resume && folder.join("checkpoint").exists() {
        train.arg("--resume");
    }
    Ok(train)
}

/// A training that continues the one in the folder `start`, with hard stretches of disturbances.
fn train_on(
    options: &Options,
    start: &Path,
    folder: &Path,
    seed: u64,
    size: &[&str],
    rate: &str,
    hours: &str,
) -> Result<()> {
    let mut train = train(options, folder, seed, size)?;
    train.arg("--start").arg(start.join("weights.safetensors")).args(["--learning-rate", rate]);
    train.args(["--extreme-weight", EXTREME_WEIGHT]);
    train.args(["--mine-hours", if options.rehearse { "0.05" } else { hours }]);
    timed("train", &mut train)
}

/// A command of `slipsense`, built with the trainer.
fn slipsense(name: &str, seed: impl Into<Option<u64>>) -> Command {
    let mut slipsense = cargo();
    slipsense.args(["run", "--release", "--quiet", "--features", "train", "--", name]);
    slipsense.args(seed.into().into_iter().flat_map(|seed| ["--seed".to_owned(), seed.to_string()]));
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
    fs::copy(from, to)
        .map(|_| ())
        .with_context(|| format!("cannot copy {} to {}", from.display(), to.display()))
}
