//! `slipsense leave-out`, what each family of physics is good for: a network is trained without it, and judged on every
//! family of its stage beside one that was trained on all.

mod picture;
mod results;

use std::path::{Path, PathBuf};

use anyhow::{Result, ensure};
use burn::tensor::Device;
use clap::Args;
use indicatif::MultiProgress;
use slipsense_synth::splits::FROZEN_SEED;
use slipsense_synth::{FAMILIES, Recipe, Split, Stage};

use self::results::{FamilyAt, Finished, KNOWN, Results, family, lower};
use crate::batch::{Options, Sampler};
use crate::data::{Features, first};
use crate::evaluate::score_logits;
use crate::float::FloatNetwork;
use crate::output;
use crate::progress::progress;
use crate::variants::command::{check_seeds, report};
use crate::variants::results::Budget;
use crate::variants::train::Training;
use crate::variants::{BASE, jobs};

/// Train without one family of physics after the other
///
/// Trains the shipped network's layout on synthetic episodes in all families of physics that training may see, then
/// without one of them at a time, on as many episodes and steps. Each network is scored on episodes of validation
/// objects that differ in the family of that stage alone. What it loses on the family that it never saw is what the
/// family is good for; the last family of each stage is held out from all. A network that is finished stays in DIR:
/// the command, given again, goes on with what is missing.
#[derive(Args, Clone, Debug)]
#[command(after_help = "\
Files written to DIR:
  all-SEED.json, without-STAGE-FAMILY-SEED.json  figures of one network
  budget.json        what every network gets
  report.txt         what the command prints
  leave-out.json     the same in numbers; units are in the keys
  leave-out.svg      the same as a picture

A network takes about two minutes on one core; two jobs need 6 GB of memory.

Examples:
  slipsense leave-out --out out/leave-out
  slipsense leave-out --out out/try --seeds 1 --episodes 12 --steps 20 --test-episodes 2")]
pub struct LeaveOutArgs {
    /// Folder for the results; made if it is not there
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Stages of which families are left out, separated by commas: contact, friction, film, source, path, disturbance,
    /// sensor; all if not given
    #[arg(long, value_name = "STAGE,…", value_delimiter = ',', value_parser = stage_named)]
    pub stages: Vec<Stage>,
    /// Seeds of first weights and draws; each network is trained once per seed
    #[arg(long, value_name = "K,…", value_delimiter = ',', default_values_t = [1, 2, 3])]
    pub seeds: Vec<u64>,
    /// Training episodes in all families, of which a network gets those without one
    #[arg(long, value_name = "N", default_value_t = 360)]
    pub episodes: usize,
    /// Optimizer steps
    #[arg(long, value_name = "N", default_value_t = 240)]
    pub steps: usize,
    /// Episodes of each family to score
    #[arg(long, value_name = "N", default_value_t = 16)]
    pub test_episodes: usize,
    /// Networks that are trained at once, each on one core; as many as there are cores if not given
    #[arg(long, value_name = "N")]
    pub jobs: Option<usize>,
    /// Print leave-out.json to standard output instead of the tables
    #[arg(long)]
    pub json: bool,
}

fn stage_named(name: &str) -> Result<Stage, String> {
    let found = Stage::ALL.into_iter().find(|&stage| lower(stage) == name);
    found.ok_or_else(|| format!("not a stage ({})", Stage::ALL.map(lower).join(", ")))
}

fn file(out: &Path, without: Option<FamilyAt>, seed: u64) -> PathBuf {
    let name = without.map_or("all".to_owned(), |at| format!("without-{}-{}", lower(at.0), family(at)));
    out.join(format!("{name}-{seed}.json"))
}

/// Every network: that of all families, then without each of these stages'.
fn networks(stages: &[Stage]) -> impl Iterator<Item = Option<FamilyAt>> {
    let without = stages.iter().flat_map(|&stage| (0..KNOWN).map(move |place| Some((stage, place))));
    std::iter::once(None).chain(without)
}

pub fn run_leave_out(args: &LeaveOutArgs) -> Result<()> {
    let jobs = args.jobs.unwrap_or_else(jobs::cores);
    for (option, number) in [
        ("--episodes", args.episodes),
        ("--steps", args.steps),
        ("--test-episodes", args.test_episodes),
        ("--jobs", jobs),
    ] {
        ensure!(number > 0, "{option} must be at least 1");
    }
    check_seeds(&args.seeds)?;
    let stages = if args.stages.is_empty() { &Stage::ALL[..] } else { &args.stages };
    let budget = Budget {
        episodes: args.episodes,
        steps: args.steps,
        test_episodes: args.test_episodes,
        ..Budget::default()
    };
    output::folder(&args.out)?;
    budget.mark(&args.out)?;
    let (mut finished, mut missing) = (Vec::new(), Vec::new());
    for &seed in &args.seeds {
        for without in networks(stages) {
            match output::read_json::<Finished>(&file(&args.out, without, seed))? {
                Some(done) if done.has(stages) => finished.push(done),
                _ => missing.push(vec![(without, seed)]),
            }
        }
    }
    if !missing.is_empty() {
        let (bars, sets) = (MultiProgress::new(), Sets::generate(stages, &budget)?);
        let total = bars.add(progress("networks", missing.len() as u64));
        finished.extend(jobs::run(missing.into(), jobs, |(without, seed)| {
            let done = sets.run(without, seed, &budget, &bars)?;
            let text = serde_json::to_string(&done)? + "\n";
            output::write(&file(&args.out, without, seed), text.as_bytes())?;
            total.inc(1);
            Ok(done)
        })?);
        total.finish_and_clear();
    }
    let results = Results::new(budget, stages, &args.seeds, &finished);
    report(&args.out, "leave-out", &results, &picture::svg(&results)?, args.json)
}

/// Episodes of all networks, their features computed once.
struct Sets {
    recipes: Vec<Recipe>,
    train: Vec<Features>,
    /// Episodes of each training, as many as there are without the commonest family.
    count: usize,
    /// Of each stage asked for `[family][episode]`; they differ in that family alone.
    tests: Vec<(Stage, Vec<Vec<Features>>)>,
}

impl Sets {
    fn generate(stages: &[Stage], budget: &Budget) -> Result<Self> {
        let known: Vec<Recipe> = first(Split::TrainAnywhere, budget.data_seed, budget.episodes).collect();
        let test: Vec<Recipe> = first(Split::ValAnywhere, FROZEN_SEED, budget.test_episodes).collect();
        let of_stage = |&stage: &Stage| {
            let all = (0..FAMILIES)
                .flat_map(|place| test.iter().map(move |recipe| recipe.clone().with_family(stage, place)));
            let all = Features::of_recipes("test", &all.collect::<Vec<_>>())?;
            anyhow::Ok((stage, all.chunks(test.len()).map(<[Features]>::to_vec).collect()))
        };
        let count = networks(&Stage::ALL)
            .map(|without| known.iter().filter(|recipe| is_kept(recipe, without)).count())
            .min();
        Ok(Self {
            train: Features::of_recipes("train", &known)?,
            count: count.unwrap_or(0),
            tests: stages.iter().map(of_stage).collect::<Result<_>>()?,
            recipes: known,
        })
    }

    fn run(
        &self,
        without: Option<FamilyAt>,
        seed: u64,
        budget: &Budget,
        bars: &MultiProgress,
    ) -> Result<Finished> {
        let all = self.recipes.iter().zip(&self.train);
        let kept = all.filter(|(recipe, _)| is_kept(recipe, without)).map(|(_, episode)| episode);
        let sampler = Sampler::new(kept.take(self.count), budget.frames, Options::default())?;
        let name = without.map_or("all".to_owned(), |at| format!("without {}", family(at)));
        let bar = bars.add(progress(format!("{name} {seed}"), budget.steps as u64));
        let device = &Device::flex();
        let (weights, _) =
            Training { sampler: &sampler, budget, seed, device, bar: &bar }.ours(&BASE, None, None)?;
        bar.set_message("score");
        let network = FloatNetwork::new(&weights, device);
        let score = |features: &Features| {
            let outputs = network.outputs(&BASE, &features.sequences_of(BASE.pads));
            score_logits(features, &outputs).classes.confusion
        };
        let stages =
            self.tests.iter().filter(|(stage, _)| without.is_none_or(|(left_out, _)| left_out == *stage));
        let of_family = |episodes: &Vec<Features>| episodes.iter().map(score).collect();
        let scores = stages.map(|(stage, tests)| (*stage, tests.iter().map(of_family).collect())).collect();
        bar.finish_and_clear();
        Ok(Finished { without, seed, synthetic: true, budget: budget.clone(), episodes: self.count, scores })
    }
}

fn is_kept(recipe: &Recipe, without: Option<FamilyAt>) -> bool {
    without.is_none_or(|(stage, place)| recipe.clone().with_family(stage, place) != *recipe)
}
