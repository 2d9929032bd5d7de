//! What the networks of a comparison reach, and what a family costs where it was left out.

use std::fmt;

use serde::{Deserialize, Serialize};
use slipsense_synth::{FAMILIES, Recipe, Stage};

use crate::variants::orderings::{Confusion, Difference, macro_f1};
use crate::variants::results::{Budget, Spread};

/// Families of a stage that training may see.
pub const KNOWN: usize = FAMILIES - 1;

pub fn lower(stage: Stage) -> String {
    format!("{stage:?}").to_lowercase()
}

/// A family of a stage, by its place among them.
pub type FamilyAt = (Stage, usize);

/// A network and seed that is done.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Finished {
    /// What it was trained without; null for the one that was trained on all.
    pub without: Option<FamilyAt>,
    pub seed: u64,
    /// All figures are of generated episodes.
    pub synthetic: bool,
    pub budget: Budget,
    /// Episodes that it was trained on.
    pub episodes: usize,
    /// Frames of every episode by truth and prediction, of the stages that it was scored on, `[family][episode]`.
    pub scores: Vec<(Stage, Vec<Vec<Confusion>>)>,
}

impl Finished {
    /// Was it scored on all that these stages ask of it.
    pub fn has(&self, stages: &[Stage]) -> bool {
        let scored = |stage: &Stage| self.scores.iter().any(|(scored, _)| scored == stage);
        self.without.is_some() || stages.iter().all(scored)
    }
}

/// What a family costs where it was left out, on one family of its stage.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Cost {
    pub macro_f1: Spread,
    /// The network without less the one with all.
    pub difference: Difference,
}

/// All networks on episodes of one family.
#[derive(Clone, Debug, Serialize)]
pub struct Tested {
    pub stage: Stage,
    pub family: String,
    /// No network was trained on it.
    pub is_held_out: bool,
    /// Of the network that was trained on all; null where it is missing.
    pub all_macro_f1: Option<Spread>,
    /// In the order of the stage's families; null where a network is missing.
    pub without: Vec<Option<Cost>>,
}

/// The root of `leave-out.json`.
#[derive(Clone, Debug, Serialize)]
pub struct Results {
    /// All figures are of generated episodes.
    pub synthetic: bool,
    pub budget: Budget,
    /// Episodes that each network was trained on.
    pub episodes: usize,
    pub seeds: Vec<u64>,
    pub tested: Vec<Tested>,
}

pub fn family((stage, place): FamilyAt) -> String {
    Recipe::new(0).with_family(stage, place).family(stage)
}

impl Results {
    pub fn new(budget: Budget, stages: &[Stage], seeds: &[u64], finished: &[Finished]) -> Self {
        // Of one network and seed on one family.
        let of = |without: Option<FamilyAt>, seed: u64, (stage, place): FamilyAt| {
            let done = finished.iter().find(|done| done.without == without && done.seed == seed)?;
            done.scores.iter().find(|(tested, _)| *tested == stage).map(|(_, families)| &families[place])
        };
        let spread = |without, at| {
            let of_seed = |&seed: &u64| macro_f1(of(without, seed, at)?.iter().copied());
            Spread::new(seeds.iter().map(of_seed))
        };
        let cost = |left_out: FamilyAt, at: FamilyAt| {
            let pair = |&seed: &u64| {
                Some([of(Some(left_out), seed, at)?, of(None, seed, at)?].map(|all| vec![all.clone()]))
            };
            let pairs: Vec<_> = seeds.iter().filter_map(pair).collect();
            Some(Cost { macro_f1: spread(Some(left_out), at)?, difference: Difference::of_pairs(&pairs)? })
        };
        let at = stages.iter().flat_map(|&stage| (0..FAMILIES).map(move |place| (stage, place)));
        let tested = at.map(|at| Tested {
            stage: at.0,
            family: family(at),
            is_held_out: at.1 == KNOWN,
            all_macro_f1: spread(None, at),
            without: (0..KNOWN).map(|place| cost((at.0, place), at)).collect(),
        });
        Self {
            synthetic: true,
            budget,
            episodes: finished.first().map_or(0, |done| done.episodes),
            seeds: seeds.to_vec(),
            tested: tested.collect(),
        }
    }

    /// Mean difference on the family that was left out, and on the others of its stage, points.
    fn mean_points(&self) -> [f64; 2] {
        let costs = self.tested.iter().enumerate().flat_map(|(at, tested)| {
            let costs = tested.without.iter().enumerate();
            costs.filter_map(move |(left_out, cost)| Some((left_out == at % FAMILIES, cost.as_ref()?)))
        });
        let costs: Vec<_> = costs.collect();
        [true, false].map(|own| {
            let points =
                costs.iter().filter(|(is_own, _)| *is_own == own).map(|(_, cost)| cost.difference.points);
            points.clone().sum::<f64>() / points.count() as f64
        })
    }
}

impl fmt::Display for Results {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (episodes, seeds) = (self.episodes, self.seeds.len());
        let Budget { steps, batch, frames, test_episodes, .. } = self.budget;
        writeln!(
            f,
            "Synthetic data, float networks; {episodes} training episodes and {steps} steps of {} frames each, \
             {test_episodes} episodes of each family, {seeds} seeds. Macro F1 in %; behind it by how many points the \
             network without a family differs (95 % interval over episodes and seeds)",
            batch * frames
        )?;
        for families in self.tested.chunks(FAMILIES) {
            write!(f, "\n{:14}{:>8}", lower(families[0].stage), "all")?;
            for left_out in &families[..KNOWN] {
                write!(f, "{:>26}", format!("without {}", left_out.family))?;
            }
            writeln!(f)?;
            for tested in families {
                let all = tested.all_macro_f1.map_or(f64::NAN, |spread| 100.0 * spread.mean);
                write!(f, "{:14}{all:>8.1}", tested.family)?;
                for cost in &tested.without {
                    let text = cost.map_or("–".to_owned(), |cost| cost.difference.to_string());
                    write!(f, "{text:>26}")?;
                }
                writeln!(f, "{}", if tested.is_held_out { "  held out" } else { "" })?;
            }
        }
        let [own, others] = self.mean_points();
        writeln!(f, "\nmean: {own:+.1} on the family left out, {others:+.1} on the others of its stage")
    }
}
