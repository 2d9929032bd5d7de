//! `slipsense model`: what is in a model file, and what the integers cost it.

mod info;
#[cfg(feature = "train")]
#[path = "model/compare.rs"]
mod compare;
#[cfg(not(feature = "train"))]
#[path = "model/compare_missing.rs"]
mod compare;

use anyhow::Result;
use clap::{Args as ClapArgs, Subcommand};

/// Look into a model file: layers and cost, or float against integer
#[derive(ClapArgs)]
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
    Compare(compare::Args),
}

impl Args {
    pub(crate) fn run(self) -> Result<()> {
        match self.what {
            What::Info(args) => args.run(),
            What::Compare(args) => args.run(),
        }
    }
}
