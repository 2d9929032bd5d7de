//! `slipsense model mean`: several trainings become one network.

use std::path::PathBuf;

use anyhow::Result;
use slipsense_model::mean::mean_of;

/// Write the mean of the weights of several trainings
///
/// Trainings that continue one another end at different places around the same network; their mean is often better
/// than each. DIR gets weights.safetensors and train.json, which says what the mean is of.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  slipsense model mean out/third out/fourth --out out/mean
  slipsense quantize --weights out/mean/weights.safetensors --out new.slipnet")]
pub struct Args {
    /// Folders of `slipsense train`
    #[arg(value_name = "TRAINING", num_args = 2.., required = true)]
    trainings: Vec<PathBuf>,
    /// Folder for the result; made if it is not there
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

impl Args {
    pub fn run(self) -> Result<()> {
        println!("{}", mean_of(&self.trainings, &self.out)?.display());
        Ok(())
    }
}
