//! `slipsense synth`: labelled synthetic episodes.

use std::cmp::Reverse;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, bail, ensure};
use clap::ArgGroup;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use rayon::prelude::*;
use serde_json::json;
use slipsense::params::FRAME_RATE_HZ;
use slipsense_synth::splits::{EpisodeSet, FROZEN_SEED, PAPER_FRAMES, paper_set};
use slipsense_synth::{Recipe, Shard, Split, content_hash, generate};

use super::Print;
use crate::output::{check_file, refuse_file};
use crate::set_dir::SetDir;
use crate::summary::counted;

/// Generate labelled synthetic episodes
///
/// Contact, grip changes, partial slip, finger vibration and sensor noise by a physical model. What it
/// makes is synthetic, says so in its metadata, and carries no claim about a real gripper. The same
/// recipe makes the same episode; the same split, seed and frames make the same set.
#[derive(clap::Args)]
#[command(group = ArgGroup::new("set").args(["split", "all"]))]
#[command(after_help = "\
Splits:
  train      objects for training, hand-held gripper with two fingers
  val        objects of its own, for choosing operating points
  umi_id     test: objects of training, new grasps
  umi_ood    test: objects never trained on
  umi_quiet  the episodes of umi_id and umi_ood without the sound of the crosshead's drive
  palm       test: objects never trained on, held towards the palm
  tesollo2   test: another hand, two fingers
  tesollo3   test: another hand, three fingers
  noslip     test: long episodes without slip, for false alarms per hour
  free       test: pulls by hand in all directions and twists, no rig; not part of --all
  train_anywhere, val_anywhere, transfer_known
             training, validation and test in other families of physics than the laboratory's: pulls
             on the rig and by hand, twists and carrying, on both hands; not part of --all
  transfer_contact, _friction, _film, _source, _path, _disturbance, _sensor, _all, _noslip
             test: the same, with the families of that stage, or of all, that training never sees

Written to --out: set.json (which set, every recipe), SPLIT-00000.npz and so on, and, when all
episodes are there, hashes.json (what they hold). The same command again goes on where a run was
cut off. Parts made by several processes or machines (--shard) belong into one folder; the last one
finishes the set. Test splits without --frames and --seed are the frozen test sets, and are
compared with them.

A recipe is JSON; only `seed` must be there:
  {\"seed\": 7, \"object\": \"held_out\", \"scenario\": \"six_step\", \"sensors\": 2, \"speed_mm_s\": 5}
Grip force of one finger in newtons, and an object of its own:
  {\"seed\": 7, \"grip_n\": 2.5, \"object\": {\"own\": {
    \"name\": \"my-rod\", \"kind\": \"tool\", \"group\": \"train\",
    \"shape\": {\"cylinder\": {\"radius_mm\": 4, \"length_mm\": 90}}, \"surface\": \"hard\",
    \"mu_static\": 0.5, \"mu_kinetic\": 0.43, \"roughness_um\": 0.8, \"texture_mm\": [0.3],
    \"texture_share\": 0.2, \"stick_slip\": 0.3, \"ring_hz\": 1800, \"damping\": 0.02, \"mass_g\": 60}}}

Families of physics, in place of the laboratory's (all of them are in the book's page on the world):
  {\"seed\": 7, \"vibration\": \"grains\", \"families\": {\"friction\": \"mass\", \"path\": \"free_modes\"}}

Examples:
  slipsense synth --split umi_ood --out out/umi_ood
  slipsense synth --split train --frames 600000 --seed 1 --out out/train --shard 2/4
  slipsense synth --all --out out/data
  slipsense synth --verify --out out/data
  slipsense synth --recipe recipe.json --out episode.npz")]
pub struct Args {
    /// Split to make; --out is a folder
    #[arg(long, value_name = "NAME", value_parser = split_parser(), conflicts_with = "all")]
    #[arg(required_unless_present_any = ["all", "recipe", "verify"])]
    split: Option<Split>,
    /// Make the paper-sized set: 1.4 million frames of all splits, in folders inside --out
    #[arg(long)]
    all: bool,
    /// Frames to make at least; the last episode is whole. Test splits: those of the frozen set
    #[arg(long, value_name = "N", requires = "set", value_parser = clap::value_parser!(u64).range(1..=100_000_000))]
    frames: Option<u64>,
    /// Seed of the set
    #[arg(long, value_name = "K", requires = "set")]
    seed: Option<u64>,
    /// Make only part I of N of the episodes
    #[arg(long, value_name = "I/N", requires = "set", value_parser = Shard::parse, conflicts_with = "verify")]
    shard: Option<Shard>,
    /// Read all episodes again and compare them with hashes.json; alone, make none
    #[arg(long)]
    verify: bool,
    /// Recipe of one episode; --out is a file
    #[arg(long, value_name = "FILE", conflicts_with_all = ["set", "verify"])]
    recipe: Option<PathBuf>,
    /// Folder, or with --recipe file, to write
    #[arg(long, value_name = "PATH")]
    out: PathBuf,
    #[command(flatten)]
    print: Print,
}

fn split_parser() -> impl TypedValueParser<Value = Split> {
    PossibleValuesParser::new(Split::ALL.map(Split::name)).try_map(|name| name.parse::<Split>())
}

impl Args {
    pub fn run(self) -> Result<()> {
        if let Some(recipe) = &self.recipe {
            return self.one(recipe);
        }
        let start = Instant::now();
        let mut dirs = self.sets()?;
        let makes = self.split.is_some() || self.all;
        let made = if makes { self.make(&mut dirs)? } else { 0 };
        if self.verify {
            let frames = dirs.iter().map(|dir| dir.set.total_frames()).sum();
            self.print.progress(frames, "frames checked", |bar| {
                dirs.iter().try_for_each(|dir| dir.verify(|frames| bar.inc(frames as u64)))
            })?;
        }
        self.report(&dirs, made, start)
    }

    fn one(&self, path: &Path) -> Result<()> {
        check_file(&self.out)?;
        let text = fs::read_to_string(path).with_context(|| format!("{}: cannot read", path.display()))?;
        let recipe: Recipe =
            serde_json::from_str(&text).with_context(|| format!("{}: not a recipe", path.display()))?;
        let episode = generate(&recipe).with_context(|| path.display().to_string())?;
        episode.write(&self.out)?;
        let out = self.out.display().to_string();
        let frames = episode.frames();
        self.print.show(&json!({"episodes": 1, "frames": frames, "out": out}), || {
            format!("1 synthetic episode, {frames} frames: {out}\n")
        })
    }

    /// The sets to make or to check, and that their folders can hold them.
    fn sets(&self) -> Result<Vec<SetDir>> {
        let seed = self.seed.unwrap_or(FROZEN_SEED);
        let frames = self.frames.map(|frames| frames as usize);
        if self.all {
            refuse_file(&self.out)?;
            let sets = paper_set(seed, frames.unwrap_or(PAPER_FRAMES)).into_iter();
            return sets.map(|set| SetDir::check(&self.out.join(set.split.name()), set)).collect();
        }
        if let Some(split) = self.split {
            let is_sized = frames.is_some() || split != Split::Train;
            ensure!(is_sized, "--frames: split train has no size of its own, say one");
            let frames = frames.map_or_else(|| split.frozen().map(|frozen| frozen.frames), Ok)?;
            return Ok(vec![SetDir::check(&self.out, EpisodeSet::new(split, seed, frames))?]);
        }
        let inside = Split::ALL.map(|split| self.out.join(split.name()));
        let found = std::iter::once(&self.out).chain(&inside).map(|path| SetDir::open(path));
        let found: Vec<SetDir> = found.filter_map(Result::transpose).collect::<Result<_>>()?;
        if found.is_empty() {
            bail!("{}: holds no set (no set.json here or in a folder named as a split)", self.out.display());
        }
        Ok(found)
    }

    /// Make what is missing, the longest episodes first, so that all cores are busy to the end. Returns the frames made.
    fn make(&self, dirs: &mut [SetDir]) -> Result<usize> {
        let shard = self.shard.unwrap_or(Shard::WHOLE);
        dirs.iter().try_for_each(SetDir::begin)?;
        let mut jobs: Vec<(usize, usize)> = dirs
            .iter()
            .enumerate()
            .flat_map(|(at, dir)| dir.missing(shard).into_iter().map(move |index| (at, index)))
            .collect();
        let frames = |&(at, index): &(usize, usize)| dirs[at].set.episodes[index].frames;
        jobs.sort_by_key(|job| (Reverse(frames(job)), *job));
        let total = jobs.iter().map(frames).sum();
        let made = self.print.progress(total, "frames", |bar| {
            let make = |(at, index): (usize, usize)| {
                let planned = &dirs[at].set.episodes[index];
                let episode = generate(&planned.recipe).with_context(|| planned.name.clone())?;
                episode.write(dirs[at].file(index))?;
                bar.inc(planned.frames as u64);
                Ok((at, index, content_hash(&episode)))
            };
            jobs.into_iter().par_bridge().map(make).collect::<Result<Vec<_>>>()
        })?;
        made.into_iter().for_each(|(at, index, hash)| dirs[at].made[index] = Some(hash));
        for dir in dirs {
            self.print.progress(dir.set.total_frames(), "frames of earlier runs", |bar| {
                dir.finish(|frames| bar.inc(frames as u64))
            })?;
        }
        Ok(total)
    }

    fn report(&self, dirs: &[SetDir], made: usize, start: Instant) -> Result<()> {
        let elapsed_s = start.elapsed().as_secs_f64();
        let signal_s = made as f64 / FRAME_RATE_HZ as f64;
        let times = signal_s / elapsed_s;
        let set = |dir: &SetDir| {
            json!({
                "split": dir.set.split, "seed": dir.set.seed, "out": dir.path.display().to_string(),
                "episodes": dir.set.episodes.len(), "frames": dir.set.total_frames(),
                "episodes_made": dir.made.iter().flatten().count(), "complete": dir.is_complete,
                "hash": dir.hash(), "frozen": dir.is_frozen(),
            })
        };
        let result = json!({
            "sets": dirs.iter().map(set).collect::<Vec<_>>(), "frames_made": made, "signal_s": signal_s,
            "elapsed_s": elapsed_s, "x_real_time": times, "verified": self.verify,
        });
        self.print.show(&result, || {
            let mut text = String::new();
            for dir in dirs {
                let episodes = counted(dir.set.episodes.len(), "synthetic episode");
                let (split, frames, out) = (dir.set.split, dir.set.total_frames(), dir.path.display());
                let state = match dir.hash() {
                    Some(hash) if dir.is_frozen() => format!("the frozen test set, hash {}", &hash[..16]),
                    Some(hash) => format!("hash {}", &hash[..16]),
                    None => format!("part {} made, others missing", self.shard.unwrap_or(Shard::WHOLE)),
                };
                text += &format!("{split:<9} {episodes}, {frames} frames, {state}: {out}\n");
            }
            text + &match (made, self.verify) {
                (0, true) => format!("every episode is as hashes.json says; {elapsed_s:.1} s\n"),
                (0, false) => "nothing was missing\n".to_owned(),
                _ => format!("{signal_s:.0} s of signal in {elapsed_s:.1} s: {times:.1} x real time\n"),
            }
        })
    }
}
