//! `slipsense model compare` in a build without tensor libraries: says how to get it.

use anyhow::{Result, bail};
use clap::Args as ClapArgs;

/// Compare float and integer network layer by layer (needs the feature `train`)
///
/// This build has no float network, so that it compiles in a minute. The one that has it:
/// cargo run --release --features train -- model compare --help
#[derive(ClapArgs)]
pub struct Args {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
    rest: Vec<String>,
}

impl Args {
    pub(crate) fn run(self) -> Result<()> {
        let line: String = self.rest.iter().map(|argument| format!(" {argument}")).collect();
        bail!(
            "`model compare` is not in this build; get it with `cargo run --release --features train -- \
             model compare{line}`"
        )
    }
}
