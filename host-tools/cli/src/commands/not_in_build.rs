//! Commands that need the feature `train`, in a build without.

use anyhow::{Result, bail};

/// The command line of a command that is not in this build.
#[derive(clap::Args)]
#[command(after_help = "\
This build has no trainer, so that it compiles faster. The build that has it:
  cargo run --release --features train -- COMMAND --help")]
pub struct NotInBuild {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
    rest: Vec<String>,
}

impl NotInBuild {
    pub fn refuse(&self, command: &str) -> Result<()> {
        let line = [&[command.to_owned()], &self.rest[..]].concat().join(" ");
        bail!(
            "`{command}` is not in this build; get it with `cargo run --release --features train -- {line}`"
        )
    }
}
