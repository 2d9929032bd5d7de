//! `cargo xtask retrain`: the shipped model from nothing.

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result};
use clap::Args;

use crate::process::{cargo, command, root, run, small_cli, target_dir};

/// Where the repository keeps the shipped model, and what is kept of its making.
const WEIGHTS: &str = "model/weights";
/// Names in the folder of a run, and in [`WEIGHTS`].
const FILES: [(&str, &str); 6] = [
    ("weights.safetensors", "slipsense.safetensors"),
    ("slipsense.slipnet", "slipsense.slipnet"),
    ("train.json", "train.json"),
    ("curves.csv", "curves.csv"),
    ("curves.svg", "curves.svg"),
    ("manifest.json", "manifest.json"),
];
/// What stays of the first training: its record, not its weights.
const FIRST_FILES: [&str; 3] = ["train.json", "curves.csv", "curves.svg"];
/// The picture of the README, drawn by the model.
const PICTURE: &str = "host-tools/cli/demo/timeline.svg";

#[derive(Args)]
#[command(after_help = "\
Three networks are trained, of --seed and the seeds beside it, one after the other;
the one of --seed then learns on from episodes of its own, from the labels and from
what the three say.

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

const SHIPPED_SEED: u64 = 2;
/// From the seed of a network's first training to that of its second, so that it meets other episodes.
const SECOND_SEED: u64 = 10;
/// The second training: half as many episodes, three tenths of the steps, a third of the learning rate.
const SECOND_SIZE: [&str; 4] = ["--episodes", "320", "--epochs", "6"];
const SECOND_RATE: [&str; 2] = ["--learning-rate", "1e-3"];
const REHEARSAL_SIZE: [&str; 4] = ["--episodes", "8", "--epochs", "1"];

/// Train, learn on, quantize, tune; what is not said here are the commands' own defaults.
pub fn retrain(options: &Options) -> Result<bool> {
    let out = std::path::absolute(&options.out)?;
    let started = Instant::now();
    let seed = options.seed;
    let first = |seed: u64| out.join(format!("first-{seed}"));
    let teachers = [seed - 1, seed, seed + 1];
    for seed in teachers {
        train(options, &first(seed), seed, &[], &[])?;
    }
    let weights = |folder: &Path| folder.join("weights.safetensors").into_os_string();
    let mut second = arguments(&SECOND_RATE);
    second.extend(["--start".into(), weights(&first(seed))]);
    second.extend(teachers.into_iter().flat_map(|seed| ["--teacher".into(), weights(&first(seed))]));
    train(options, &out, seed + SECOND_SEED, &SECOND_SIZE, &second)?;

    let at = |name: &str| out.join(name).into_os_string();
    let (untuned, tuned) = (at("untuned.slipnet"), at("slipsense.slipnet"));
    let mut quantize = arguments(&["quantize", "--seed", &seed.to_string()]);
    quantize.extend(["--weights".into(), weights(&out), "--out".into(), untuned.clone()]);
    quantize.extend(["--report".into(), at("manifest.json")]);
    let mut tune = vec!["tune".into(), untuned, "--out".into(), tuned];
    if options.rehearse {
        quantize.extend(arguments(&["--calibration-episodes", "1", "--val-episodes", "1"]));
        tune.extend(arguments(&["--hours", "0.05", "--episodes", "8", "--alarms-per-hour", "60"]));
    }
    slipsense(&quantize)?;
    slipsense(&tune)?;
    let minutes = started.elapsed().as_secs_f64() / 60.0;
    eprintln!("{} made in {minutes:.0} minutes", out.join("slipsense.slipnet").display());
    if options.install {
        let kept = root().join(WEIGHTS);
        for (made, name) in FILES {
            copy(&out.join(made), &kept.join(name))?;
        }
        for name in FIRST_FILES {
            copy(&first(seed).join(name), &kept.join(format!("first-{name}")))?;
        }
        let demo = target_dir().join("demo");
        run(command(small_cli()?).args(["demo", "--out"]).arg(&demo))?;
        copy(&demo.join("timeline.svg"), &root().join(PICTURE))?;
    }
    Ok(true)
}

/// One training of a size, the trainer's own if none is said, with what else differs from its defaults.
fn train(options: &Options, folder: &Path, seed: u64, size: &[&str], different: &[OsString]) -> Result<()> {
    let mut train = arguments(&["train", "--seed", &seed.to_string(), "--out"]);
    train.push(folder.into());
    train.extend(arguments(if options.rehearse { &REHEARSAL_SIZE } else { size }));
    train.extend_from_slice(different);
    if options.resume && folder.join("checkpoint").exists() {
        train.push("--resume".into());
    }
    slipsense(&train)
}

fn arguments(texts: &[&str]) -> Vec<OsString> {
    texts.iter().map(OsString::from).collect()
}

/// Run a command of `slipsense`, built with the trainer, and say how long it took.
fn slipsense(arguments: &[OsString]) -> Result<()> {
    let begun = Instant::now();
    let mut slipsense = cargo();
    slipsense.args(["run", "--release", "--quiet", "--features", "train", "--"]).args(arguments);
    run(&mut slipsense)?;
    eprintln!("{} took {:.0} s", arguments[0].display(), begun.elapsed().as_secs_f64());
    Ok(())
}

fn copy(from: &Path, to: &Path) -> Result<()> {
    fs::copy(from, to)
        .map(|_| ())
        .with_context(|| format!("cannot copy {} to {}", from.display(), to.display()))
}
