//! `slipsense synth`: labelled synthetic episodes.

use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::{Args as ClapArgs, ValueEnum};
use slipsense_synth::{ObjectChoice, Recipe, generate, generate_set};

use crate::output_dir::{OutputDir, check_file};

/// Generate labelled synthetic episodes
///
/// Contact, grip changes, partial slip, finger vibration and sensor noise by a physical model. What it
/// makes is synthetic, says so in its metadata, and carries no claim about a real gripper. The same
/// recipe or seed makes the same episode.
#[derive(ClapArgs)]
#[command(after_help = "\
A recipe is JSON; only `seed` must be there:
  {\"seed\": 7, \"object\": \"held_out\", \"scenario\": \"six_step\", \"sensors\": 2, \"speed_mm_s\": 5}

Examples:
  slipsense synth --recipe recipe.json --out episode.npz
  slipsense synth --episodes 100 --objects train --seed 1 --sensors 2 --out out/train")]
pub struct Args {
    /// Recipe of one episode; --out is then a file
    #[arg(long, value_name = "FILE", conflicts_with_all = ["episodes", "objects", "seed", "sensors"])]
    recipe: Option<PathBuf>,
    /// How many episodes to draw; --out is then a folder
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    episodes: u32,
    /// Which objects of the catalogue to draw from
    #[arg(long, value_enum, default_value_t = Objects::Train)]
    objects: Objects,
    /// Seed of every draw
    #[arg(long, value_name = "K", default_value_t = 0)]
    seed: u64,
    /// Sensors of the gripper, 1 to 3
    #[arg(long, value_name = "S", default_value_t = 2)]
    sensors: usize,
    /// File (with --recipe) or folder (without) to write
    #[arg(long, value_name = "PATH")]
    out: PathBuf,
    /// Print what was written as JSON
    #[arg(long)]
    json: bool,
}

/// Groups of the object catalogue.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Objects {
    /// Objects that training may see
    Train,
    /// Objects that training must never see
    HeldOut,
}

impl Args {
    pub(crate) fn run(self) -> Result<()> {
        match &self.recipe {
            Some(recipe) => self.one(recipe),
            None => self.many(),
        }
    }

    fn one(&self, path: &PathBuf) -> Result<()> {
        check_file(&self.out)?;
        let text = fs::read_to_string(path).with_context(|| format!("{}: cannot read", path.display()))?;
        let recipe: Recipe =
            serde_json::from_str(&text).with_context(|| format!("{}: not a recipe", path.display()))?;
        let episode = generate(&recipe).with_context(|| path.display().to_string())?;
        episode.write(&self.out)?;
        self.done(1)
    }

    fn many(&self) -> Result<()> {
        let object = match self.objects {
            Objects::Train => ObjectChoice::Train,
            Objects::HeldOut => ObjectChoice::HeldOut,
        };
        let recipe = Recipe { object, sensors: self.sensors, ..Recipe::new(self.seed) };
        let recipes = recipe.series(self.episodes as usize);
        let out = OutputDir::prepare(&self.out)?;
        let progress = super::progress(recipes.len(), "episodes", self.json);
        let written = generate_set(&recipes, |i, episode| {
            let written = episode.write(out.path(&format!("episode-{i:05}.npz")));
            progress.inc(1);
            written
        })?;
        written.into_iter().collect::<Result<(), _>>()?;
        out.commit()?;
        progress.finish_and_clear();
        self.done(recipes.len())
    }

    fn done(&self, episodes: usize) -> Result<()> {
        let out = self.out.display().to_string();
        if self.json {
            return super::print_json(&serde_json::json!({"episodes": episodes, "out": out}));
        }
        let plural = if episodes == 1 { "" } else { "s" };
        super::print(&format!("{episodes} synthetic episode{plural}: {out}\n"))
    }
}
