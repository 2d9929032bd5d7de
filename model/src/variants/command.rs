//! `slipsense compare-networks`: train what is missing, score it, and put all rows side by side.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, bail, ensure};
use clap::Args;

use super::orderings::Comparisons;
use super::results::{Budget, Finished};
use super::sets::Sets;
use super::train::{TrainedNetwork, train};
use super::{Making, ROWS, Row, Variant, picture, row_named};
use crate::batch::{Options, Sampler};
use crate::output;
use crate::train::progress;
use crate::weights::Weights;

/// Compare the shipped network with others that differ in one thing each
///
/// Trains every row on the same synthetic episodes with the same number of steps, in float, and scores it on
/// the first episodes of the frozen splits: modality, fusion, accelerometer encoder, memory, resolution,
/// augmentation, and what else the paper compares; besides, a network twice the size, and one taught by it. A
/// row and seed that is finished stays in DIR: the command, given again, goes on with what is missing.
#[derive(Args, Clone, Debug)]
#[command(after_help = rows_help())]
pub struct CompareArgs {
    /// Folder for the results; made if it is not there
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Rows to run, separated by commas; all if not given
    #[arg(long, value_name = "NAME,…", value_delimiter = ',')]
    pub rows: Vec<String>,
    /// Seeds of first weights and draws; each row is trained once per seed
    #[arg(long, value_name = "K,…", value_delimiter = ',', default_values_t = [1, 2, 3])]
    pub seeds: Vec<u64>,
    /// Training episodes, the same for all rows and seeds
    #[arg(long, value_name = "N", default_value_t = 240)]
    pub episodes: usize,
    /// Optimizer steps of every row, 12 sequences of 240 frames each
    #[arg(long, value_name = "N", default_value_t = 700)]
    pub steps: usize,
    /// First episodes of each frozen split to score
    #[arg(long, value_name = "N", default_value_t = 32)]
    pub test_episodes: usize,
    /// Highest learning rate; it rises over the first steps and falls along a half cosine
    #[arg(long, value_name = "LR", default_value_t = 3e-3)]
    pub learning_rate: f64,
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
         base-SEED.safetensors  weights of the base, which the row `recomputed` runs again\n  \
         wide-SEED.safetensors  weights of the larger network, which teaches the row `distilled`\n  \
         comparisons.json       all rows, and which of the paper's orderings hold\n  \
         comparisons.svg        macro F1 of every row and split\n\n\
         On two cores a row and seed is trained in about three minutes and scored in one, `recomputed` in several;\n\
         `wide` takes four times as long. The features of all episodes are held in memory, about 6 GB.\n\n\
         Examples:\n  \
         slipsense compare-networks --out out/compare\n  \
         slipsense compare-networks --out out/fusion --rows base,late,concatenation --seeds 1\n  \
         slipsense compare-networks --out out/try --rows base,xl --seeds 1 --episodes 8 --steps 20 \\\n      \
         --test-episodes 2",
        rows.join("\n")
    )
}

pub fn run_compare(args: &CompareArgs) -> Result<()> {
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
    output::folder(&args.out)?;
    if !missing.is_empty() {
        let sets = Sets::generate(&budget)?;
        for (number, &(row, seed)) in missing.iter().enumerate() {
            let place = format!("{}/{} {} {seed}", number + 1, missing.len(), row.name);
            let done = run_row(&args.out, row, seed, &budget, &sets, place)?;
            done.write(&args.out)?;
            finished.push(done);
        }
    }
    let results = Comparisons::new(args.command_line(), budget, &finished);
    let json = serde_json::to_string_pretty(&results)? + "\n";
    output::write(&args.out.join("comparisons.svg"), picture::svg(&results)?.as_bytes())?;
    output::write(&args.out.join("comparisons.json"), json.as_bytes())?;
    if args.json {
        print!("{json}");
    } else {
        println!("{results}\n{}", args.out.join("comparisons.svg").display());
    }
    Ok(())
}

/// Train, where the row is trained, and score.
fn run_row(
    out: &Path,
    row: &Row,
    seed: u64,
    budget: &Budget,
    sets: &Sets,
    place: String,
) -> Result<Finished> {
    let started = Instant::now();
    let needed = row.needs().and_then(row_named).map(|needed| read_kept(out, needed, seed)).transpose()?;
    let (weights, loss) = if let (Making::Recomputed, Some(base)) = (row.making, &needed) {
        (base.weights.clone(), None)
    } else {
        let Variant { pads, xl_augmentation, .. } = row.variant;
        let options = Options { pads, xl_augmentation, ..Options::default() };
        let sampler = Sampler::new(&sets.train, budget.frames)?.with_options(options);
        let bar = progress("", budget.steps as u64).with_prefix(place);
        let trained = train(&row.variant, &sampler, needed.as_ref(), budget, seed, &bar)
            .with_context(|| format!("row {}, seed {seed}", row.name))?;
        bar.finish_and_clear();
        if row.is_needed() {
            trained.weights.write(&kept_weights(out, row.name, seed))?;
        }
        (trained.weights, Some(trained.loss))
    };
    let splits = sets.score(row, &weights);
    Ok(Finished {
        row: row.name.to_owned(),
        seed,
        synthetic: true,
        budget: budget.clone(),
        parameters: weights.count(),
        loss,
        wall_s: started.elapsed().as_secs_f64(),
        splits,
    })
}

/// Where the weights of a row are kept that others need.
fn kept_weights(out: &Path, row: &str, seed: u64) -> PathBuf {
    out.join(format!("{row}-{seed}.safetensors"))
}

fn read_kept(out: &Path, row: &Row, seed: u64) -> Result<TrainedNetwork> {
    let path = kept_weights(out, row.name, seed);
    let weights = Weights::read(&path)?;
    ensure!(weights.dims == row.variant.dims(), "{}: not the dimensions of row {}", path.display(), row.name);
    Ok(TrainedNetwork { variant: row.variant, weights })
}

impl CompareArgs {
    /// The rows asked for, in the order of [`ROWS`]: the base comes before what runs its weights.
    fn chosen(&self) -> Result<Vec<&'static Row>> {
        for name in &self.rows {
            let names = || ROWS.map(|row| row.name).join(", ");
            ensure!(row_named(name).is_some(), "--rows: {name} is not a row ({})", names());
        }
        let wanted = |row: &&Row| self.rows.is_empty() || self.rows.iter().any(|name| name == row.name);
        Ok(ROWS.iter().filter(wanted).collect())
    }

    fn budget(&self) -> Result<Budget> {
        ensure!(!self.seeds.is_empty(), "--seeds must name at least one");
        for (index, seed) in self.seeds.iter().enumerate() {
            ensure!(!self.seeds[..index].contains(seed), "--seeds: {seed} is there twice");
        }
        ensure!(self.episodes > 0, "--episodes must be at least 1");
        ensure!(self.steps > 0, "--steps must be at least 1");
        ensure!(self.test_episodes > 0, "--test-episodes must be at least 1");
        ensure!(
            self.learning_rate > 0.0 && self.learning_rate <= 1.0,
            "--learning-rate must be above 0 and at most 1"
        );
        Ok(Budget::new(self.episodes, self.steps, self.learning_rate, self.test_episodes))
    }

    fn command_line(&self) -> String {
        let seeds: Vec<String> = self.seeds.iter().map(u64::to_string).collect();
        let rows =
            if self.rows.is_empty() { String::new() } else { format!(" --rows {}", self.rows.join(",")) };
        format!(
            "slipsense compare-networks --out {}{rows} --seeds {} --episodes {} --steps {} --test-episodes {} \
             --learning-rate {}",
            self.out.display(),
            seeds.join(","),
            self.episodes,
            self.steps,
            self.test_episodes,
            self.learning_rate
        )
    }
}
