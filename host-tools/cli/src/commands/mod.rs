//! One file per subcommand, each with its arguments and what they do. `full` has those of the full build.

pub mod demo;
pub mod model;
#[cfg(not(feature = "train"))]
mod not_in_build;
pub mod run;

#[cfg(feature = "full")]
pub mod full;

#[cfg(not(feature = "train"))]
pub use not_in_build::NotInBuild;

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
