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
const FILES: [(&str, &str); 7] = [
    ("weights.safetensors", "slipsense.safetensors"),
    ("slipsense.slipnet", "slipsense.slipnet"),
    ("train.json", "train.json"),
    ("curves.csv", "curves.csv"),
    ("curves.svg", "curves.svg"),
    ("manifest.json", "manifest.json"),
    (CURVE, CURVE),
];
/// Delay and misses of the flag against its false alarms.
const CURVE: &str = "operating-curve.svg";
/// What stays of the first training: its record, not its weights.
const FIRST_FILES: [&str; 3] = ["train.json", "curves.csv", "curves.svg"];
/// The picture of the README, drawn by the model.
const PICTURE: &str = "host-tools/cli/demo/timeline.svg";

#[derive(Args)]
#[command(after_help = "\
The network is trained on generated episodes, then a second time on others and on
what it takes for slip in hours of disturbances.

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
/// The second training: half of the learning rate, more weight on what decides alarms.
const SECOND_SIZE: [&str; 4] = ["--episodes", "480", "--epochs", "12"];
const SECOND_RATE: [&str; 4] = ["--learning-rate", "1.5e-3", "--extreme-weight", "4"];
/// Hours of disturbances that the second training picks from.
const MINE_HOURS: &str = "3";
/// A training of a rehearsal.
const REHEARSAL_SIZE: [&str; 4] = ["--episodes", "8", "--epochs", "1"];

/// Train, train on, quantize, tune; what is not said here are the commands' own defaults.
pub fn retrain(options: &Options) -> Result<bool> {
    let out = std::path::absolute(&options.out)?;
    let started = Instant::now();
    let (seed, first) = (options.seed, out.join("first"));
    let second_seed = seed + SECOND_SEED;
    timed("train", &mut train(options, &first, seed, &FIRST_SIZE)?)?;
    let mut second = train(options, &out, second_seed, &SECOND_SIZE)?;
    second.args(SECOND_RATE).arg("--start").arg(first.join("weights.safetensors"));
    second.args(["--mine-hours", if options.rehearse { "0.05" } else { MINE_HOURS }]);
    timed("train", &mut second)?;

    let at = |name: &str| out.join(name);
    let mut quantize = slipsense("quantize", second_seed);
    quantize.arg("--weights").arg(at("weights.safetensors")).arg("--out").arg(at("untuned.slipnet"));
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
        for name in FIRST_FILES {
            copy(&first.join(name), &kept.join(format!("first-{name}")))?;
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
