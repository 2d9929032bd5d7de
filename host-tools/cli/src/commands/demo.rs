//! `slipsense demo`: the bundled episode.

use std::path::PathBuf;

use anyhow::Result;

use super::Print;
use super::run::{Raw, run};
use crate::bundled;
use crate::output::OutputDir;

/// Detect a slip in the bundled synthetic episode
///
/// A gripper with instrumented fingertips holds an object, the object is pulled and slips. The episode
/// is generated, its recipe is host-tools/cli/demo/recipe.json. It goes through the same code and the same
/// model as on a module, bit for bit.
#[derive(clap::Args)]
#[command(after_help = "\
Writes timeline.svg, report.html, can.log, predictions.npz and summary.json; `slipsense run --help`
says what each holds.

Examples:
  slipsense demo
  slipsense demo --out /tmp/demo --json")]
pub struct Args {
    /// Folder to write; made if it does not exist
    #[arg(long, value_name = "DIR", default_value = "out/demo")]
    out: PathBuf,
    #[command(flatten)]
    print: Print,
}

impl Args {
    pub fn run(self) -> Result<()> {
        let out = OutputDir::prepare(&self.out)?;
        let (episode, model) = (bundled::episode()?, bundled::model(None)?);
        run((&episode, bundled::NAME), &model, Raw::Plain, &self.out, out, &self.print)
    }
}
