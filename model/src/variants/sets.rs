//! The episodes of the comparisons, their features computed once for all rows.

use anyhow::Result;
use indicatif::ProgressBar;
use slipsense::params::OUTPUTS;
use slipsense_recording::score::SLIP;
use slipsense_synth::splits::FROZEN_SEED;
use slipsense_synth::{Recipe, Split};

use super::BASE;
use super::results::{Budget, SplitFigures};
use crate::data::{Features, disturbances, first, recipes};
use crate::evaluate::{DetectorFigures, Scores, VALIDATION_ALARMS_PER_HOUR, classes, detector_figures};
use crate::folder::Use;

/// Splits that every row is scored on.
pub const SPLITS: [Split; 6] =
    [Split::Val, Split::UmiId, Split::UmiOod, Split::Palm, Split::Tesollo2, Split::Tesollo3];

#[derive(Debug)]
pub struct Sets {
    pub train: Vec<Features>,
    /// In the order of [`SPLITS`].
    pub splits: Vec<(Split, Vec<Features>)>,
    /// What the detector is judged on: validation objects in the laboratory's physics and in families, half without slip.
    pub detector: Vec<Features>,
}

impl Sets {
    /// Make them all; a bar for each.
    pub fn generate(budget: &Budget) -> Result<Self> {
        let train = recipes(Use::Train, budget.data_seed, budget.episodes)?;
        let split = |split: Split| {
            let mut episodes = split.frozen()?.episodes;
            episodes.truncate(budget.test_episodes.max(budget.encoder_test_episodes));
            let recipes: Vec<Recipe> = episodes.into_iter().map(|episode| episode.recipe).collect();
            Ok((split, Features::of_recipes(split.name(), &recipes)?))
        };
        let train = Features::of_recipes("train", &train)?;
        let splits = SPLITS.into_iter().map(split).collect::<Result<_>>()?;
        let validation = [Split::Val, Split::ValAnywhere]
            .into_iter()
            .flat_map(|split| first(split, FROZEN_SEED, budget.detector_episodes))
            .flat_map(|recipe| [disturbances(recipe.clone()), recipe]);
        let detector = Features::of_recipes("detector", &validation.collect::<Vec<_>>())?;
        Ok(Self { train, splits, detector })
    }

    /// What a network with these outputs reaches on the first episodes of some splits; `bar` moves once an episode.
    pub fn score(
        &self,
        splits: &[Split],
        episodes: usize,
        pads_say_contact: bool,
        bar: &ProgressBar,
        outputs: impl Fn(&Features) -> Vec<[f32; OUTPUTS]>,
    ) -> Vec<SplitFigures> {
        let chosen = || self.splits.iter().filter(|(split, _)| splits.contains(split));
        let total: usize = chosen().map(|(_, all)| all.len().min(episodes)).sum();
        bar.set_length(total as u64);
        let one = |features: &Features| {
            bar.inc(1);
            let outputs = outputs(features);
            Scores::new(&features.label, &classes(features, &outputs, pads_say_contact))
        };
        let figures = |(split, all): &(Split, Vec<Features>)| {
            SplitFigures::new(*split, all.iter().take(episodes).map(one).collect())
        };
        chosen().map(figures).collect()
    }

    /// What the detector of a network with these outputs reaches on validation data; `bar` as in [`score`](Self::score).
    pub fn detector(
        &self,
        bar: &ProgressBar,
        outputs: impl Fn(&Features) -> Vec<[f32; OUTPUTS]>,
    ) -> DetectorFigures {
        bar.inc_length(self.detector.len() as u64);
        let one = |features| {
            bar.inc(1);
            (features, outputs(features))
        };
        let all: Vec<_> = self.detector.iter().map(one).collect();
        detector_figures(&all, VALIDATION_ALARMS_PER_HOUR)
    }

    /// A window that ends with the first frame of a slip.
    pub fn window(&self) -> Option<Features> {
        self.splits.iter().flat_map(|(_, episodes)| episodes).find_map(|features| {
            let end = features.label.iter().position(|&class| class == SLIP)? + 1;
            Some(features.cut(end.checked_sub(BASE.window)?..end))
        })
    }
}
