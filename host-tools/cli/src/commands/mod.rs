//! One file per subcommand, each with its arguments and what they do. `full` has those of the full build.

pub mod model;
pub mod run;

#[cfg(feature = "full")]
pub mod full;

use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};

use anyhow::Result;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

use crate::bundled::{self, NamedModel};

/// `--json`, and how results are printed.
#[derive(clap::Args)]
pub struct Print {
    /// Print the result as JSON, nothing else
    #[arg(long)]
    json: bool,
}

impl Print {
    /// To standard output: the value as JSON, or else the text.
    fn show(&self, value: &impl Serialize, text: impl FnOnce() -> String) -> Result<()> {
        print(&if self.json { serde_json::to_string_pretty(value)? + "\n" } else { text() })
    }

    /// Work with a progress bar on standard error; hidden with `--json` and where standard error is no terminal.
    fn progress<R>(&self, length: usize, what: &'static str, work: impl FnOnce(&ProgressBar) -> R) -> R {
        let bar = if self.json || !std::io::stderr().is_terminal() {
            ProgressBar::hidden()
        } else {
            let style = ProgressStyle::with_template("{msg} [{bar:40}] {pos}/{len} {eta}");
            let style = style.unwrap_or_else(|_| ProgressStyle::default_bar());
            ProgressBar::new(length as u64).with_style(style).with_message(what)
        };
        let result = work(&bar);
        bar.finish_and_clear();
        result
    }
}

/// `--model`.
#[derive(clap::Args)]
pub struct ModelArg {
    /// Model file; the bundled one if not given
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
}

impl ModelArg {
    fn read(&self) -> Result<NamedModel> {
        bundled::model(self.model.as_deref())
    }
}

/// Print to standard output; a closed pipe is an error that `main` knows.
pub fn print(text: &str) -> Result<()> {
    let mut out = std::io::stdout().lock();
    out.write_all(text.as_bytes())?;
    out.flush()?;
    Ok(())
}

fn written(folder: &Path, files: &[(&str, &str)]) -> String {
    let line = |(what, file): &(&str, &str)| format!("  {what:<13} {}\n", folder.join(file).display());
    files.iter().map(line).collect()
}

/// The command line of a command that needs the feature `train`, in a build without.
#[cfg(not(feature = "train"))]
#[derive(clap::Args)]
#[command(after_help = "\
This build has no trainer, so that it compiles faster. The build that has it:
  cargo run --release --features train -- COMMAND --help")]
pub struct NotInBuild {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
    rest: Vec<String>,
}

#[cfg(not(feature = "train"))]
impl NotInBuild {
    pub fn refuse(&self, command: &str) -> Result<()> {
        let line = [&[command.to_owned()], &self.rest[..]].concat().join(" ");
        anyhow::bail!(
            "`{command}` is not in this build; get it with `cargo run --release --features train -- {line}`"
        )
    }
}
