//! The end of `slipsense reproduce`: what the paper shows of its whole method, by the shipped network.

use std::fmt::Write;
use std::path::Path;

use anyhow::{Context, Result};

use super::{eval, grasp};

/// Evaluate the shipped network on the paper's splits and in the closed loop with each hand; files go to `out`.
pub fn report(out: &Path) -> Result<String> {
    let folder = out.to_str().with_context(|| format!("{}: not UTF-8", out.display()))?;
    let splits = ["umi_id", "umi_ood", "palm", "tesollo2", "tesollo3"];
    let evaluation: eval::Args =
        parsed(&[&splits[..], &["--detector", "network", "--out", folder]].concat())?;
    let results = evaluation.evaluate()?.context("an evaluation without --shard is whole")?;
    let mut text = format!("The shipped network, integers, all frozen episodes\n\n{results}\n");
    for hand in ["umi", "tesollo2", "tesollo3"] {
        let loops: grasp::Args = parsed(&["--hand", hand, "--out", &format!("{folder}/{hand}")])?;
        writeln!(text, "Closed loop: {}", loops.close_loop()?.1)?;
    }
    writeln!(text, "By object, by grip, distributions of the delays: {folder}/report.html")?;
    Ok(text)
}

/// Arguments as on the command line, with the defaults that they have there.
fn parsed<T: clap::Args>(words: &[&str]) -> Result<T> {
    let command = T::augment_args(clap::Command::new("slipsense").no_binary_name(true));
    Ok(T::from_arg_matches(&command.try_get_matches_from(words)?)?)
}
