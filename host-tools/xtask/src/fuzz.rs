//! `cargo xtask fuzz`: mutated input for whatever reads bytes that others wrote, chosen by the branches that it reaches.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use anyhow::{Context as _, Result, ensure};
use clap::Args;

use crate::process::{answer, cargo, command, target_dir};
use crate::table::Table;

/// The tests of `host-tools/recording/tests/suite/fuzz/`.
const MODULE: &str = "fuzz::";
/// Counts each branch taken, as libFuzzer wants it.
const COVERAGE: &str = "-Ccodegen-units=1 -Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 \
    -Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table";

#[derive(Args)]
#[command(after_help = "\
Inputs that reach something new are kept in target/fuzz/inputs, and a later run begins with them. An input that fails
is printed and kept there as well.

Examples:
  cargo xtask fuzz --only npz --runs 100000
  cargo xtask fuzz --runs 10000000            every parser: a quarter of an hour on two cores")]
pub struct Options {
    /// Inputs for each parser
    #[arg(long, value_name = "N", default_value_t = 1_000_000)]
    runs: u64,
    /// Only this parser; may be given several times
    #[arg(long, value_name = "NAME")]
    only: Vec<String>,
}

/// Whether it passed, and its row of the table.
type Outcome = (bool, [String; 5]);

/// Fuzz them, as many at a time as there are cores; `false` if an input failed.
pub fn run(options: &Options) -> Result<bool> {
    let program = build()?;
    let list = answer(command(&program).args([MODULE, "--list"])).context("the tests cannot be listed")?;
    let names = list.lines().filter_map(|line| line.strip_prefix(MODULE)?.strip_suffix(": test"));
    let is_wanted = |name: &&str| options.only.is_empty() || options.only.iter().any(|only| only == name);
    let wanted: Vec<&str> = names.filter(is_wanted).collect();
    ensure!(!wanted.is_empty(), "no parser is called so; there are:\n{list}");
    let next = AtomicUsize::new(0);
    let work = || {
        let mut outcomes = Vec::new();
        while let Some(name) = wanted.get(next.fetch_add(1, Ordering::Relaxed)) {
            outcomes.extend(one(&program, name, options.runs)?);
        }
        anyhow::Ok(outcomes)
    };
    let results: Result<Vec<Vec<Outcome>>> = std::thread::scope(|scope| {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let workers: Vec<_> = (0..cores).map(|_| scope.spawn(work)).collect();
        workers.into_iter().map(|worker| worker.join().expect("no worker panics")).collect()
    });
    let mut outcomes = results?.concat();
    outcomes.sort_by(|(_, a), (_, b)| a[0].cmp(&b[0]));
    let mut table =
        Table::new("inputs by libFuzzer", &["parser", "inputs", "per second", "branches reached", "kept"]);
    let passed = outcomes.iter().all(|(passed, _)| *passed);
    outcomes.into_iter().for_each(|(_, row)| table.row(row));
    print!("{table}");
    Ok(passed)
}

/// The tests with counted branches, apart from other builds.
fn build() -> Result<PathBuf> {
    let host = answer(command("rustc").arg("-vV")).context("rustc does not answer")?;
    let host = host.lines().find_map(|line| line.strip_prefix("host: ")).context("rustc names no host")?;
    let mut build = cargo();
    // With a target named, build scripts and procedural macros are built without.
    build.args(["test", "--release", "--quiet", "--no-run", "--target", host]);
    build
        .args(["--message-format", "json-render-diagnostics", "--target-dir"])
        .arg(target_dir().join("fuzz"));
    build.args(["--package", "slipsense-recording", "--test", "suite", "--features", "fuzz"]);
    let built =
        build.env("RUSTFLAGS", COVERAGE).stderr(Stdio::inherit()).output().context("cannot start cargo")?;
    ensure!(built.status.success(), "the tests cannot be built for libFuzzer");
    let lines = String::from_utf8_lossy(&built.stdout);
    let program = lines.rsplit("\"executable\":\"").next().and_then(|rest| rest.split('"').next());
    Ok(program.context("cargo names no program")?.into())
}

/// `None`: a test without inputs.
fn one(program: &Path, name: &str, runs: u64) -> Result<Option<Outcome>> {
    let inputs = target_dir().join("fuzz/inputs").join(name);
    fs::create_dir_all(&inputs).with_context(|| inputs.display().to_string())?;
    let place = inputs.display();
    // Five changes take fewer random bytes.
    let arguments =
        format!("-runs={runs} -max_len=512 -rss_limit_mb=0 -artifact_prefix={place}/failed- {place}");
    let mut test = command(program);
    test.args(["--exact", &format!("{MODULE}{name}"), "--nocapture"]).env("SLIPSENSE_LIBFUZZER", arguments);
    let began = Instant::now();
    let output = test.output().context("cannot start the tests")?;
    let text = String::from_utf8_lossy(&output.stderr);
    // `#1000  DONE   cov: 812 ft: 2301 corp: 210/9Kb ...`
    let Some(last) = text.lines().rfind(|line| line.starts_with('#') && line.contains(" cov: ")) else {
        ensure!(output.status.success(), "{name}: {text}");
        return Ok(None);
    };
    let mut words = last.split_whitespace();
    let inputs: u64 = words.next().and_then(|word| word[1..].parse().ok()).unwrap_or(0);
    let mut value =
        |key| words.by_ref().skip_while(|word| *word != key).nth(1).unwrap_or_default().to_owned();
    let (branches, kept) = (value("cov:"), value("corp:"));
    let passed = output.status.success() && inputs >= runs;
    if !passed {
        eprintln!("{name}: {text}");
    }
    eprintln!("{name}: {inputs} inputs, {branches} branches");
    let per_second = inputs as f64 / began.elapsed().as_secs_f64();
    let name = if passed { name.to_owned() } else { format!("{name} FAILED") };
    Ok(Some((passed, [name, inputs.to_string(), format!("{per_second:.0}"), branches, kept])))
}
