//! `slipsense families`: the physics of the synthetic world side by side, beside recordings.

use std::path::PathBuf;

use anyhow::{Context, Result};
use slipsense_eval::families::gallery;
use slipsense_recording::Episode;
use slipsense_synth::{FAMILIES, Stage};

use super::{Print, written};
use crate::output::OutputDir;
use crate::picture::families;

/// Show the synthetic world's families of physics side by side
///
/// Each stage of the world comes in several families. For each, a few episodes are made in which that stage alone
/// differs from the laboratory's, and their pressure, the pressure around a slip's onset and the accelerometer's
/// spectrum are drawn and compared in numbers. Recordings of your own, labelled, stand beside them: what lies outside
/// of all families is what training does not know.
#[derive(clap::Args)]
#[command(after_help = "\
Files written to the output folder:
  families.svg    one row a stage, one column a family
  families.json   the same in numbers; units are in the keys

Examples:
  slipsense families --out out/families
  slipsense label mine.npz --manual 3.2:3.9 --object cup --out labelled.npz
  slipsense families --real labelled.npz --out out/families")]
pub struct Args {
    /// Labelled recording to show beside the families, an .npz file; may be given several times
    #[arg(long, value_name = "EPISODE.npz")]
    real: Vec<PathBuf>,
    /// Episodes of each family
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u16).range(1..=1000))]
    episodes: u16,
    /// Seed of the first episode
    #[arg(long, value_name = "K", default_value_t = 1)]
    seed: u64,
    /// Folder to write to; made if it is not there
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    print: Print,
}

impl Args {
    pub fn run(self) -> Result<()> {
        let out = OutputDir::prepare(&self.out)?;
        let read = |path: &PathBuf| Episode::read(path).with_context(|| path.display().to_string());
        let recordings = self.real.iter().map(read).collect::<Result<Vec<_>>>()?;
        let gallery = self.print.progress(Stage::ALL.len() * FAMILIES, "families", |bar| {
            gallery(self.episodes.into(), self.seed, &recordings, &|| bar.inc(1))
        })?;
        let headline = format!(
            "{} episodes of each family; all stages but the named one are the laboratory's. First sensor.",
            self.episodes
        );
        out.write("families.svg", families(&gallery, &headline))?;
        out.write("families.json", serde_json::to_vec_pretty(&gallery)?)?;
        out.commit()?;
        let files = [("picture", "families.svg"), ("numbers", "families.json")];
        self.print.show(&gallery, || format!("{gallery}\n{}", written(&self.out, &files)))
    }
}
