//! `cargo xtask retrain`: the shipped model from nothing.

use std::fs;
use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context, Result};
use clap::Args;

use crate::process::{cargo, run, target_dir};
use crate::root;

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
/// The picture of the README, drawn by the model.
const PICTURE: &str = "host-tools/cli/demo/timeline.svg";

#[derive(Args)]
#[command(after_help = "\
Examples:
  cargo xtask retrain --out out/retrain                 the shipped model's recipe and seed
  cargo xtask retrain --out out/seed7 --seed 7          another seed
  cargo xtask retrain --out out/retrain --install       and make it the shipped one")]
pub struct Options {
    /// Folder for everything that is made
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Seed of episodes, first weights and draws
    #[arg(long, value_name = "K", default_value_t = SHIPPED_SEED)]
    seed: u64,
    /// Put the result in model/weights, and draw the README's picture with it
    #[arg(long)]
    install: bool,
}

/// Seed of the shipped model.
const SHIPPED_SEED: u64 = 2;

/// Train, quantize, tune; all with the commands' own defaults.
pub fn retrain(options: &Options) -> Result<bool> {
    let out = std::path::absolute(&options.out)?;
    let at = |name: &str| out.join(name).into_os_string();
    let seed = options.seed.to_string();
    let started = Instant::now();
    let step = |arguments: &[&std::ffi::OsStr]| {
        let begun = Instant::now();
        let mut slipsense = cargo();
        slipsense.args(["run", "--release", "--quiet", "--features", "train", "--"]).args(arguments);
        run(&mut slipsense)?;
        eprintln!("{} took {:.0} s", arguments[0].display(), begun.elapsed().as_secs_f64());
        anyhow::Ok(())
    };
    step(&["train".as_ref(), "--out".as_ref(), out.as_ref(), "--seed".as_ref(), seed.as_ref()])?;
    let (weights, untuned, tuned) =
        (at("weights.safetensors"), at("untuned.slipnet"), at("slipsense.slipnet"));
    let manifest = at("manifest.json");
    let quantize: [&std::ffi::OsStr; 9] = [
        "quantize".as_ref(),
        "--weights".as_ref(),
        &weights,
        "--out".as_ref(),
        &untuned,
        "--report".as_ref(),
        &manifest,
        "--seed".as_ref(),
        seed.as_ref(),
    ];
    step(&quantize)?;
    step(&["tune".as_ref(), &untuned, "--out".as_ref(), &tuned])?;
    eprintln!("{} made in {:.0} minutes", tuned.display(), started.elapsed().as_secs_f64() / 60.0);
    if options.install {
        for (made, kept) in FILES {
            copy(&out.join(made), &root().join(WEIGHTS).join(kept))?;
        }
        let demo = target_dir().join("demo");
        let mut slipsense = cargo();
        slipsense.args(["run", "--release", "--quiet", "--", "demo", "--out"]).arg(&demo);
        run(&mut slipsense)?;
        copy(&demo.join("timeline.svg"), &root().join(PICTURE))?;
    }
    Ok(true)
}

fn copy(from: &std::path::Path, to: &std::path::Path) -> Result<()> {
    fs::copy(from, to)
        .map(|_| ())
        .with_context(|| format!("cannot copy {} to {}", from.display(), to.display()))
}
