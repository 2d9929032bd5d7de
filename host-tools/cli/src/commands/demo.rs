//! `slipsense demo`: the bundled episode.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args as ClapArgs;
use slipsense::net::Model;
use slipsense_recording::Episode;

use super::run::{Job, Raw, process};
use crate::bundled;
use crate::output_dir::OutputDir;

/// Detect a slip in the bundled synthetic episode
///
/// A gripper with instrumented fingertips holds an object, the object is pulled and slips. The episode
/// is generated, its recipe is host-tools/cli/demo/recipe.json. What happens to it is what a module
/// does: the same code, the same model, the same bits.
#[derive(ClapArgs)]
#[command(after_help = "\
Writes timeline.svg, report.html, can.log, predictions.npz and summary.json; `slipsense run --help`
says what each holds.

Examples:
  slipsense demo
  slipsense demo --out /tmp/demo --json")]
pub struct Args {
    /// Folder to write; made if it is not there
    #[arg(long, value_name = "DIR", default_value = "out/demo")]
    out: PathBuf,
    /// Print summary.json to standard output, nothing else
    #[arg(long)]
    json: bool,
}

impl Args {
    pub(crate) fn run(self) -> Result<()> {
        let out = OutputDir::prepare(&self.out)?;
        let episode = Episode::from_bytes(bundled::EPISODE, bundled::NAME)?;
        let model = Model::parse(bundled::MODEL).context("bundled model")?;
        let (name, model_name) = (bundled::NAME.to_owned(), bundled::NAME.to_owned());
        process(&Job { episode, name, model, model_name, raw: Raw::Plain, json: self.json }, out, &self.out)
    }
}
