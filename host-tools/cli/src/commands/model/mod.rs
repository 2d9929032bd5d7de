//! `slipsense model`: what is in a model file, its loss by integers, the mean of several.

#[cfg(feature = "train")]
mod compare;
mod info;
#[cfg(feature = "train")]
mod mean;

use anyhow::Result;
use clap::Subcommand;

/// Look into a model file: layers and cost, or float against integer; or write the mean of several trainings
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  slipsense model info                            the bundled model
  slipsense model info other.slipnet --json | jq .totals
  slipsense model compare grasp.npz               the bundled model against its own float weights")]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Subcommand)]
enum What {
    Info(info::Args),
    #[cfg(feature = "train")]
    Compare(compare::Args),
    #[cfg(feature = "train")]
    Mean(mean::Args),
    /// Compare float and integer network layer by layer (needs the feature `train`)
    #[cfg(not(feature = "train"))]
    Compare(super::NotInBuild),
    /// Write the mean of the weights of several trainings (needs the feature `train`)
    #[cfg(not(feature = "train"))]
    Mean(super::NotInBuild),
}

impl Args {
    pub fn run(self) -> Result<()> {
        match self.what {
            What::Info(args) => args.run(),
            #[cfg(feature = "train")]
            What::Compare(args) => args.run(),
            #[cfg(feature = "train")]
            What::Mean(args) => args.run(),
            #[cfg(not(feature = "train"))]
            What::Compare(args) => args.refuse("model compare"),
            #[cfg(not(feature = "train"))]
            What::Mean(args) => args.refuse("model mean"),
        }
    }
}
