//! `slipsense model`: what is in a model file, and its loss by integers.

#[cfg(feature = "train")]
mod compare;
mod info;

use anyhow::Result;
use clap::Subcommand;

/// Look into a model file: layers and cost, or float against integer
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
    /// Compare float and integer network layer by layer (needs the feature `train`)
    #[cfg(not(feature = "train"))]
    Compare(super::NotInBuild),
}

impl Args {
    pub fn run(self) -> Result<()> {
        match self.what {
            What::Info(args) => args.run(),
            #[cfg(feature = "train")]
            What::Compare(args) => args.run(),
            #[cfg(not(feature = "train"))]
            What::Compare(args) => args.refuse("model compare"),
        }
    }
}
