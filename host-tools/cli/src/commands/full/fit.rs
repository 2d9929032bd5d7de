//! `slipsense fit`: thresholds and tables of the detectors that need some.

use std::path::PathBuf;

use anyhow::{Result, ensure};
use clap::ValueEnum;
use slipsense_eval::detector::ClassOrder;
use slipsense_eval::fit::{Plan, fit};
use slipsense_eval::source::{Handle, Input};
use slipsense_synth::Split;
use slipsense_synth::splits::EpisodeSet;

use super::Print;
use crate::output::{check_file, write_file};

/// What `--data` calls the generated training episodes.
const TRAIN: &str = "train";

/// Fit the benchmark's detectors on training episodes
///
/// Thresholds by the largest Youden index (hit rate less false-positive rate), class densities, logistic
/// regression, and how often each class comes at which time. The paper's baselines are fitted on the split
/// `train`; where it is generated, `clock`, `rig-only` and `idle-noise` on `train_anywhere`, too. Only
/// training episodes are taken: a file whose metadata says `split` must say `train`, one that does not must
/// not be of a held-out object. The same episodes give the same file.
#[derive(clap::Args)]
#[command(after_help = "\
The program carries one such file; `slipsense eval --fit FILE` takes another.

Examples:
  slipsense fit --data train --frames 200000 --out fitted.json
  slipsense fit --data out/train --out fitted.json")]
pub struct Args {
    /// Folder of .npz episodes, or `train` to generate the splits `train` and `train_anywhere`
    #[arg(long, value_name = "DIR|train")]
    data: PathBuf,
    /// How many frames of each split to generate, at least; of a folder all are taken
    #[arg(long, value_name = "N", default_value_t = 200_000, value_parser = clap::value_parser!(u64).range(1..=10_000_000))]
    frames: u64,
    /// Seed of the generated episodes
    #[arg(long, value_name = "K", default_value_t = 1)]
    seed: u64,
    /// Use one frame of this many; classes and clock count all
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u16).range(1..))]
    stride: u16,
    /// Which rule makes the analytic detectors' three classes first
    #[arg(long, value_enum, default_value_t = Order::SlipFirst)]
    order: Order,
    /// File to write
    #[arg(long, value_name = "F.json")]
    out: PathBuf,
    #[command(flatten)]
    print: Print,
}

/// Which rule is asked first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Order {
    /// Slip where the score says so, touched or not
    SlipFirst,
    /// No contact where no pad is touched, whatever the score
    ContactFirst,
}

impl Args {
    pub fn run(self) -> Result<()> {
        check_file(&self.out)?;
        let (laboratory, anywhere, source) = self.episodes()?;
        let class_order = match self.order {
            Order::SlipFirst => ClassOrder::SlipFirst,
            Order::ContactFirst => ClassOrder::ContactFirst,
        };
        let plan = Plan { stride: self.stride.into(), class_order };
        let fitted = self.print.progress(laboratory.len() + anywhere.len(), "episodes", |bar| {
            fit(&laboratory, &anywhere, &source, plan, || bar.inc(1))
        })?;
        write_file(&self.out, fitted.to_json()?)?;

        let (data, out) = (&fitted.data, self.out.display().to_string());
        self.print.show(&serde_json::json!({"out": out, "data": data}), || {
            let (episodes, frames, used) = (data.episodes, data.frames, data.frames_used);
            format!("fitted on {used} of {frames} frames, {episodes} episodes: {out}\n")
        })
    }

    /// The laboratory's episodes, the others', and where they come from, in words.
    fn episodes(&self) -> Result<(Vec<Handle>, Vec<Handle>, String)> {
        if self.data.as_os_str() != TRAIN || self.data.is_dir() {
            let folder = self.data.display().to_string();
            ensure!(self.data.is_dir(), "{folder}: no such folder; `{TRAIN}` generates training episodes");
            let name = self.data.file_name().map(|name| name.to_string_lossy().into_owned());
            let source = format!("episodes in {}", name.as_deref().unwrap_or("a folder"));
            return Ok((Input::folder(TRAIN, &self.data)?.episodes, Vec::new(), source));
        }
        let [laboratory, anywhere] = [Split::Train, Split::TrainAnywhere].map(|split| {
            let episodes = EpisodeSet::new(split, self.seed, self.frames as usize).episodes.into_iter();
            let named = episodes.map(|episode| (episode.name, episode.recipe)).collect();
            Input::recipes(split.name(), named).episodes
        });
        let (seed, frames) = (self.seed, self.frames);
        let source = format!("synthetic, train and train_anywhere, seed {seed}, {frames} frames each");
        Ok((laboratory, anywhere, source))
    }
}
