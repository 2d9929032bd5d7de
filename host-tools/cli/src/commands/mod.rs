//! One file per subcommand, each with its arguments and what they do.

pub mod busload;
mod live;
pub mod convert;
pub mod descriptions;
pub mod monitor;
pub mod record;
pub mod replay;
pub mod demo;
pub mod grasp;
pub mod run;
pub mod features;
pub mod fit;
pub mod label;
mod inputs;
pub mod eval;
pub mod eval_rotation;
pub mod synth;
pub mod train;
pub mod model;
pub mod tune;
pub mod view;
pub mod keygen;
pub mod sign;
pub mod image;
pub mod hil;

use std::io::{IsTerminal, Write};

use anyhow::Result;
use indicatif::{ProgressBar, ProgressStyle};

/// A progress bar on standard error; hidden for machines and where nobody watches.
fn progress(length: usize, what: &'static str, json: bool) -> ProgressBar {
    if json || !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("{msg} [{bar:40}] {pos}/{len} {eta}");
    let style = style.unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::new(length as u64).with_style(style).with_message(what)
}

/// Print to standard output; a closed pipe is an error that `main` knows.
fn print(text: &str) -> Result<()> {
    let mut out = std::io::stdout().lock();
    out.write_all(text.as_bytes())?;
    out.flush()?;
    Ok(())
}

fn print_json(value: &impl serde::Serialize) -> Result<()> {
    print(&format!("{}\n", serde_json::to_string_pretty(value)?))
}
