//! `slipsense train`, `quantize` and `compare-networks`, which need a tensor library and are built on request.

#[cfg(feature = "train")]
pub use with_trainer::{CompareArgs, QuantizeArgs, TrainArgs, compare, quantize, train};
#[cfg(not(feature = "train"))]
pub use without_trainer::{CompareArgs, QuantizeArgs, TrainArgs, compare, quantize, train};

#[cfg(feature = "train")]
mod with_trainer {
    use anyhow::Result;
    pub use slipsense_model::{CompareArgs, QuantizeArgs, TrainArgs};

    use crate::output_dir::check_file;

    /// Train the network.
    pub fn train(args: TrainArgs) -> Result<()> {
        slipsense_model::run_train(&args)
    }

    /// Turn a trained network into a model file.
    pub fn quantize(args: QuantizeArgs) -> Result<()> {
        // It works for minutes before it writes.
        [Some(&args.out), args.report.as_ref()]
            .into_iter()
            .flatten()
            .try_for_each(|path| check_file(path))?;
        slipsense_model::run_quantize(&args)
    }

    /// Compare networks.
    pub fn compare(args: CompareArgs) -> Result<()> {
        slipsense_model::run_compare(&args)
    }
}

#[cfg(not(feature = "train"))]
mod without_trainer {
    use anyhow::{Result, bail};
    use clap::Args;

    /// Train the network on synthetic episodes (needs the feature `train`)
    ///
    /// This build has no trainer, so that it compiles in a minute. The one that has it:
    /// cargo run --release --features train -- train --help
    #[derive(Args)]
    pub struct TrainArgs {
        #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
        rest: Vec<String>,
    }

    /// Turn a trained network into a model file (needs the feature `train`)
    ///
    /// This build has no quantizer, so that it compiles in a minute. The one that has it:
    /// cargo run --release --features train -- quantize --help
    #[derive(Args)]
    pub struct QuantizeArgs {
        #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
        rest: Vec<String>,
    }

    /// Compare the shipped network with others that differ in one thing each (needs the feature `train`)
    ///
    /// This build has no trainer, so that it compiles in a minute. The one that has it:
    /// cargo run --release --features train -- compare-networks --help
    #[derive(Args)]
    pub struct CompareArgs {
        #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
        rest: Vec<String>,
    }

    /// Say how to get the trainer.
    pub fn train(args: TrainArgs) -> Result<()> {
        refuse("train", &args.rest)
    }

    /// Say how to get the quantizer.
    pub fn quantize(args: QuantizeArgs) -> Result<()> {
        refuse("quantize", &args.rest)
    }

    /// Say how to get the comparisons.
    pub fn compare(args: CompareArgs) -> Result<()> {
        refuse("compare-networks", &args.rest)
    }

    fn refuse(command: &str, rest: &[String]) -> Result<()> {
        let mut line = vec![command.to_owned()];
        line.extend(rest.iter().cloned());
        let line = line.join(" ");
        bail!(
            "`{command}` is not in this build; get it with `cargo run --release --features train -- {line}`"
        )
    }
}
