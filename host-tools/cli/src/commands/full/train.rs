//! `slipsense quantize` and `reproduce`: what they do beside the trainer's part.

use std::fmt::Write;
use std::path::Path;

use anyhow::{Context, Result};
use slipsense_model::{QuantizeArgs, REPORT_FILE, ReproduceArgs, run_quantize, run_reproduce};

use super::{eval, grasp, print};
use crate::output::{check_file, write_file};

/// Turn a trained network into a model file.
pub fn quantize(args: &QuantizeArgs) -> Result<()> {
    // It works for minutes before it writes.
    for path in [Some(&args.out), args.report.as_ref()].into_iter().flatten() {
        check_file(path)?;
    }
    run_quantize(args)
}

/// Run the paper's comparisons; with all rows, show what the shipped network does as well.
pub fn reproduce(args: &ReproduceArgs) -> Result<()> {
    run_reproduce(args)?;
    if args.rows.is_empty() {
        let text = shipped(&args.out.join("shipped"))?;
        let path = args.out.join(REPORT_FILE);
        let rows = std::fs::read_to_string(&path).with_context(|| path.display().to_string())?;
        write_file(&path, format!("{rows}\n{text}"))?;
        if !args.json {
            print(&text)?;
        }
    }
    Ok(())
}

/// What the paper shows of its whole method, by the shipped network: its splits, and the closed loop with each hand.
fn shipped(out: &Path) -> Result<String> {
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
