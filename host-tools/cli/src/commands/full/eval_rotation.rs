//! `slipsense eval-rotation`: whether it matters how the accelerometers are mounted.

use std::path::PathBuf;

use anyhow::{Context, Result};
use slipsense_eval::detectors::{NETWORK, Setup, by_name};
use slipsense_eval::fitted::Fitted;
use slipsense_eval::rotation;

use super::inputs::inputs;
use super::{ModelArg, Print};

/// Turn the accelerometers' axes and compare decisions
///
/// Runs the firmware's pipeline over every episode as it is and with its accelerometer samples turned:
/// by random rotations, another for each sensor, by every exchange of axes, and with every choice of axes
/// reversed. Prints the share of the frames whose class stays the same, lowest and mean over the turns, and
/// the target for random rotations.
#[derive(clap::Args)]
#[command(after_help = "\
Each episode runs once as it is, once for each random rotation and 12 times for the exact turns, so
--episodes keeps the time in bounds; with the values that are set it is a minute or two.

Examples:
  slipsense eval-rotation
  slipsense eval-rotation umi_id tesollo3 --episodes 8 --rotations 20
  slipsense eval-rotation out/episodes --model mine.slipnet --episodes 1000 --seed 2 --json")]
pub struct Args {
    /// Folders of .npz episodes, or names of splits, whose frozen sets are then generated
    #[arg(value_name = "SPLIT_OR_DIR", default_value = "umi_ood")]
    inputs: Vec<String>,
    /// Folder in which splits are looked for first, one folder each, as `synth --all` makes them
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    #[command(flatten)]
    model: ModelArg,
    /// Random rotations
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u16).range(1..=10_000))]
    rotations: u16,
    /// Seed of the random rotations
    #[arg(long, value_name = "K", default_value_t = 1)]
    seed: u64,
    /// Episodes of each input at most, evenly spread over it
    #[arg(long, value_name = "N", default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..))]
    episodes: u32,
    #[command(flatten)]
    print: Print,
}

impl Args {
    pub fn run(self) -> Result<()> {
        let model = self.model.read()?;
        let fitted = Fitted::bundled()?;
        let setup = Setup { fitted: &fitted, model: &model.bytes, float_weights: None, dead: None };
        let make = || by_name(NETWORK, &setup);
        // What is wrong with the model shows before any work is done.
        drop(make().with_context(|| format!("model {}", model.name))?);
        let mut inputs = inputs(&self.inputs, self.data.as_deref(), &[])?;
        for input in &mut inputs {
            input.thin_out(self.episodes as usize);
        }
        let episodes = inputs.iter().map(|input| input.episodes.len()).sum();
        let results = self.print.progress(episodes, "episodes", |bar| {
            rotation::run(&inputs, &make, self.rotations.into(), self.seed, &|| bar.inc(1))
        })?;
        self.print.show(&results, || results.to_string())
    }
}
