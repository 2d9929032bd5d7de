//! `slipsense reproduce`: train what is missing, score it, and put all rows side by side.

use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use anyhow::{Result, bail, ensure};
use clap::{Args, ValueEnum};
use indicatif::MultiProgress;
use serde::Serialize;

use super::orderings::Comparisons;
use super::results::{Budget, Finished};
use super::run::{Run, authors_ssast, kept_weights};
use super::sets::Sets;
use super::{ROWS, Row, example, jobs, picture, row_named};
use crate::device::DeviceName;
use crate::output;
use crate::progress::progress;

/// What the command prints, in the folder of results.
pub const REPORT_FILE: &str = "report.txt";

/// How much every row is trained and scored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum BudgetName {
    /// Hours on two cores; no row is trained to the end
    Small,
    /// Days: 640 episodes, 6,680 steps, all test episodes
    Full,
}

impl BudgetName {
    fn budget(self) -> Budget {
        match self {
            Self::Small => Budget::default(),
            Self::Full => Budget {
                episodes: 640,
                steps: 6680,
                batch: 12,
                encoder_steps: 6680,
                encoder_batch: 12,
                encoder_frames: 240,
                test_episodes: 88,
                encoder_test_episodes: 88,
                ..Budget::default()
            },
        }
    }
}

/// Run the paper's comparisons: networks beside the shipped one, and the paper's own
///
/// Trains every row on the same synthetic episodes, in float, and scores it on the first episodes of the frozen
/// splits: modality, fusion, memory, resolution, augmentation, integers; worlds, loss and hard examples; the paper's
/// network with each of its encoders; a network twice the size, and one taught by it. Without --rows the shipped network
/// is shown as well, by speed and object and in the closed loop. A row and seed that is finished stays in DIR: the
/// command, given again, goes on with what is missing.
#[derive(Args, Clone, Debug)]
#[command(after_help = rows_help())]
pub struct ReproduceArgs {
    /// Folder for the results; made if it is not there
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Rows to run, separated by commas; all if not given
    #[arg(long, value_name = "NAME,…", value_delimiter = ',')]
    pub rows: Vec<String>,
    /// Seeds of first weights and draws; each row is trained once per seed
    #[arg(long, value_name = "K,…", value_delimiter = ',', default_values_t = [1, 2, 3])]
    pub seeds: Vec<u64>,
    /// Episodes, steps and test episodes, which the options below change one by one
    #[arg(long, value_enum, value_name = "NAME", default_value = "small")]
    pub budget: BudgetName,
    /// Training episodes, the same for all rows and seeds
    #[arg(long, value_name = "N")]
    pub episodes: Option<usize>,
    /// Optimizer steps of every row with our encoders
    #[arg(long, value_name = "N")]
    pub steps: Option<usize>,
    /// Optimizer steps of every row with the paper's encoders, and of their pretraining
    #[arg(long, value_name = "N")]
    pub encoder_steps: Option<usize>,
    /// First episodes of each frozen split to score
    #[arg(long, value_name = "N")]
    pub test_episodes: Option<usize>,
    /// First episodes of each UMI split to score the rows with the paper's encoders on, which are slow
    #[arg(long, value_name = "N")]
    pub encoder_test_episodes: Option<usize>,
    /// Episodes of each validation split to judge the detector on, and as many without slip
    #[arg(long, value_name = "N")]
    pub detector_episodes: Option<usize>,
    /// Highest learning rate; it rises over the first steps and falls along a half cosine
    #[arg(long, value_name = "LR")]
    pub learning_rate: Option<f64>,
    /// The authors' SSAST-Tiny as safetensors, to begin with instead of pretraining on our log-mel
    #[arg(long, value_name = "FILE")]
    pub ssast: Option<PathBuf>,
    /// What trains and runs the rows; the report says which device made which row
    #[arg(long, value_enum, value_name = "NAME", default_value_t)]
    pub device: DeviceName,
    /// Rows that run at once, each on one core; if not given as many as there are cores, one on a GPU
    #[arg(long, value_name = "N")]
    pub jobs: Option<usize>,
    /// Print comparisons.json to standard output instead of the tables
    #[arg(long)]
    pub json: bool,
}

/// The end of `--help`.
fn rows_help() -> String {
    let rows: Vec<String> =
        ROWS.iter().map(|row| format!("  {:19} {:13} {}", row.name, row.group, row.about)).collect();
    format!(
        "Rows:\n{}\n\n\
         Files written to DIR:\n  \
         ROW-SEED.json          figures of one row and seed, as soon as it is finished\n  \
         base-SEED.safetensors  weights of the base, which other rows quantize or train on\n  \
         wide-SEED.safetensors  weights of the larger network, which teaches the row `distilled`\n  \
         vit-mae-SEED.safetensors, ssast-SEED.safetensors  pretrained encoders\n  \
         budget.json            what every row gets\n  \
         report.txt             what the command prints\n  \
         comparisons.json       all rows, and which of the paper's orderings hold\n  \
         comparisons.svg        macro F1 of every row and split\n  \
         example.svg            one episode as pads alone, accelerometers alone and both see it\n  \
         shipped/               with all rows: the shipped network by speed and object, and in the closed loop\n\n\
         At the small budget a row and seed with our encoders takes about six minutes on one core, `wide`\n\
         and vision transformers longer. The figures do not depend on --jobs. Commands with other --rows\n\
         or --seeds may run at once in the same DIR; one with all of them collects what they leave. Each holds the\n\
         features of all episodes: 7 GB of memory with two jobs, more with vision transformers.\n\n\
         Examples:\n  \
         slipsense reproduce --out out/paper\n  \
         slipsense reproduce --out out/fusion --rows base,late,concatenation --seeds 1\n  \
         slipsense reproduce --out out/try --rows base,paper-cnn --seeds 1 --episodes 8 --steps 20 \\\n      \
         --encoder-steps 4 --test-episodes 2",
        rows.join("\n")
    )
}

pub fn run_reproduce(args: &ReproduceArgs) -> Result<()> {
    let rows = args.chosen()?;
    let budget = args.budget()?;
    let mut finished = Vec::new();
    let mut missing = Vec::new();
    for &seed in &args.seeds {
        for &row in &rows {
            match Finished::read(&args.out, row.name, seed, &budget)? {
                Some(done) => finished.push(done),
                None => missing.push((row, seed)),
            }
        }
    }
    for &(row, seed) in &missing {
        let Some(needed) = row.needs() else { continue };
        let comes = missing.iter().any(|&(other, of)| other.name == needed && of == seed);
        let path = kept_weights(&args.out, needed, seed);
        if comes || path.exists() {
            continue;
        }
        // Trained again it would be another network than the one its figures are of.
        let figures = Finished::path(&args.out, needed, seed);
        let remedy = if figures.exists() {
            format!("delete {} and add {needed} to --rows, to train it again", figures.display())
        } else {
            format!("add {needed} to --rows")
        };
        bail!("{} is missing, which row {} needs: {remedy}", path.display(), row.name);
    }
    let device = args.device.open()?;
    output::folder(&args.out)?;
    // Pretrained encoders there are of this budget as well.
    budget.mark(&args.out)?;
    if !missing.is_empty() {
        let (sets, bars) = (Sets::generate(&budget)?, MultiProgress::new());
        let total = bars.add(progress("rows", missing.len() as u64));
        let run = Run {
            out: &args.out,
            budget: &budget,
            sets: &sets,
            device_name: args.device,
            device,
            ssast: args.ssast.as_deref(),
            bars: &bars,
            pretraining: args.seeds.iter().map(|&seed| (seed, Mutex::default())).collect(),
        };
        finished.extend(jobs::run(jobs::chains(&missing), args.jobs(), |(row, seed)| {
            let done = if row.encoders.is_some() { run.paper(row, seed)? } else { run.ours(row, seed)? };
            done.write(&args.out)?;
            total.inc(1);
            Ok(done)
        })?);
        total.finish_and_clear();
    }
    let results = Comparisons::new(args.command_line(&budget), budget, &finished);
    if let Some(svg) = example::svg(&results.rows)? {
        output::write(&args.out.join("example.svg"), svg.as_bytes())?;
    }
    report(&args.out, "comparisons", &results, &picture::svg(&results)?, args.json)
}

/// Write results to `NAME.json`, `NAME.svg` and [`REPORT_FILE`], and print the tables or the JSON.
pub(super) fn report(
    out: &Path,
    name: &str,
    results: &(impl Serialize + Display),
    svg: &str,
    as_json: bool,
) -> Result<()> {
    let picture = out.join(name).with_extension("svg");
    output::write(&picture, svg.as_bytes())?;
    output::write_json(&out.join(name).with_extension("json"), results)?;
    output::write(&out.join(REPORT_FILE), results.to_string().as_bytes())?;
    if as_json {
        println!("{}", serde_json::to_string_pretty(results)?);
    } else {
        println!("{results}\n{}", picture.display());
    }
    Ok(())
}

/// Refuses none, and one that is there twice.
pub(super) fn check_seeds(seeds: &[u64]) -> Result<()> {
    ensure!(!seeds.is_empty(), "--seeds must name at least one");
    for (index, seed) in seeds.iter().enumerate() {
        ensure!(!seeds[..index].contains(seed), "--seeds: {seed} is there twice");
    }
    Ok(())
}

impl ReproduceArgs {
    /// The rows asked for, in the order of [`ROWS`]: the base comes before what runs its weights.
    fn chosen(&self) -> Result<Vec<&'static Row>> {
        for name in &self.rows {
            let names = || ROWS.map(|row| row.name).join(", ");
            ensure!(row_named(name).is_some(), "--rows: {name} is not a row ({})", names());
        }
        let wanted = |row: &&Row| self.rows.is_empty() || self.rows.iter().any(|name| name == row.name);
        Ok(ROWS.iter().filter(wanted).collect())
    }

    fn jobs(&self) -> usize {
        self.jobs.unwrap_or_else(|| match self.device {
            DeviceName::Cpu => jobs::cores(),
            DeviceName::Gpu => 1,
        })
    }

    fn budget(&self) -> Result<Budget> {
        ensure!(self.jobs() > 0, "--jobs must be at least 1");
        check_seeds(&self.seeds)?;
        let mut budget = self.budget.budget();
        for (option, given, number) in [
            ("--episodes", self.episodes, &mut budget.episodes),
            ("--steps", self.steps, &mut budget.steps),
            ("--encoder-steps", self.encoder_steps, &mut budget.encoder_steps),
            ("--test-episodes", self.test_episodes, &mut budget.test_episodes),
            ("--encoder-test-episodes", self.encoder_test_episodes, &mut budget.encoder_test_episodes),
            ("--detector-episodes", self.detector_episodes, &mut budget.detector_episodes),
        ] {
            *number = given.unwrap_or(*number);
            ensure!(*number > 0, "{option} must be at least 1");
        }
        budget.learning_rate = self.learning_rate.unwrap_or(budget.learning_rate);
        ensure!(
            budget.learning_rate > 0.0 && budget.learning_rate <= 1.0,
            "--learning-rate must be above 0 and at most 1"
        );
        if let Some(path) = &self.ssast {
            // Refused before an hour of other rows.
            authors_ssast(path)?;
            budget.ssast_sha256 = Some(output::sha256_hex(&std::fs::read(path)?));
        }
        Ok(budget)
    }

    fn command_line(&self, budget: &Budget) -> String {
        let seeds: Vec<String> = self.seeds.iter().map(u64::to_string).collect();
        let rows =
            if self.rows.is_empty() { String::new() } else { format!(" --rows {}", self.rows.join(",")) };
        let ssast = self.ssast.as_ref().map_or(String::new(), |path| format!(" --ssast {}", path.display()));
        let full = if self.budget == BudgetName::Full { " --budget full" } else { "" };
        let gpu = if self.device == DeviceName::Gpu { " --device gpu" } else { "" };
        let &Budget { episodes, steps, encoder_steps, learning_rate, .. } = budget;
        let &Budget { test_episodes, encoder_test_episodes, detector_episodes, .. } = budget;
        format!(
            "slipsense reproduce --out {}{rows}{ssast} --seeds {} --episodes {episodes} --steps {steps} \
             --encoder-steps {encoder_steps} --test-episodes {test_episodes} \
             --encoder-test-episodes {encoder_test_episodes} --detector-episodes {detector_episodes} \
             --learning-rate {learning_rate}{full}{gpu}",
            self.out.display(),
            seeds.join(",")
        )
    }
}
