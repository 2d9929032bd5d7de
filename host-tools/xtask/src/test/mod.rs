//! `cargo xtask test`: the one test command, as a list of steps.

use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use clap::Args;

mod steps;

pub use steps::{DEMO_EPISODE, demo_files};
use steps::{STEPS, Step};

/// Which steps to run.
#[derive(Args, Clone, Debug)]
#[command(after_help = "\
Without options all steps run, also after one has failed. What a step needs and is missing is installed \
where that is possible (rustup target, Debian packages as root, Python packages into target/venv); where \
it is not, the step fails and says what to install. Nothing is skipped silently.

Environment: SLIPSENSE_TOOLCHAIN=debian builds for the Cortex-M7 with Debian's compiler.

The daily loop:
  cargo xtask test --only fmt --only clippy --only host")]
pub struct Options {
    /// Only these steps; may be given several times
    #[arg(long, value_name = "STEP")]
    pub only: Vec<String>,
    /// Print the steps and stop
    #[arg(long)]
    pub list: bool,
}

/// Run the steps; `false` if one failed.
pub fn run(options: &Options) -> Result<bool> {
    if let Some(name) = options.only.iter().find(|name| !STEPS.iter().any(|step| step.name == **name)) {
        let names: Vec<_> = STEPS.iter().map(|step| step.name).collect();
        bail!("no step is called `{name}`; there are: {}", names.join(", "));
    }
    if options.list {
        for Step { name, what, .. } in STEPS {
            println!("{name:<15} {what}");
        }
        return Ok(true);
    }
    let wanted = |step: &&Step| options.only.is_empty() || options.only.iter().any(|name| name == step.name);
    let steps: Vec<&Step> = STEPS.iter().filter(wanted).collect();
    let mut done = Vec::new();
    for (number, step) in (1..).zip(&steps) {
        eprintln!("\n[{number}/{}] {}: {}", steps.len(), step.name, step.what);
        let start = Instant::now();
        let result = (step.run)();
        let time = start.elapsed();
        match &result {
            Ok(()) => eprintln!("[{number}/{}] {}: passed in {}", steps.len(), step.name, seconds(time)),
            Err(error) => {
                eprintln!("[{number}/{}] {}: FAILED in {}: {error:#}", steps.len(), step.name, seconds(time));
            }
        }
        done.push((step.name, time, result.is_ok()));
    }
    println!();
    for (name, time, passed) in &done {
        println!("{:<6} {:>8}  {name}", if *passed { "passed" } else { "FAILED" }, seconds(*time));
    }
    let failed = done.iter().filter(|(_, _, passed)| !passed).count();
    println!("{} passed, {failed} failed", done.len() - failed);
    Ok(failed == 0)
}

fn seconds(time: Duration) -> String {
    format!("{:.1} s", time.as_secs_f64())
}
