//! The episodes of the comparisons, their features computed once for all rows.

use anyhow::Result;
use burn::tensor::Device;
use slipsense_synth::{Recipe, Split, generate_set};

use super::results::{Budget, SplitFigures};
use super::{Making, Row, recomputed};
use crate::data::{Features, Source};
use crate::evaluate::{Scores, score_logits};
use crate::float::FloatNetwork;
use crate::folder::Use;
use crate::train::progress;
use crate::weights::Weights;

/// Splits that every row is scored on.
pub const SPLITS: [Split; 6] =
    [Split::Val, Split::UmiId, Split::UmiOod, Split::Palm, Split::Tesollo2, Split::Tesollo3];

#[derive(Debug)]
pub struct Sets {
    pub train: Vec<Features>,
    /// In the order of [`SPLITS`].
    pub splits: Vec<(Split, Vec<Features>)>,
}

impl Sets {
    /// Make them all; a bar for each.
    pub fn generate(budget: &Budget) -> Result<Self> {
        let bar = progress("train", budget.episodes as u64);
        let source = Source::new(None, budget.data_seed);
        let train =
            source.map(Use::Train, budget.episodes, &bar, |episode| Features::from_episode(&episode))?;
        bar.finish_and_clear();
        let split = |split: Split| {
            let mut episodes = split.frozen()?.episodes;
            episodes.truncate(budget.test_episodes);
            let recipes: Vec<Recipe> = episodes.into_iter().map(|episode| episode.recipe).collect();
            let bar = progress(split.name(), recipes.len() as u64);
            let features = generate_set(&recipes, |_, episode| {
                bar.inc(1);
                Features::from_episode(&episode)
            })?;
            bar.finish_and_clear();
            Ok((split, features.into_iter().collect::<Result<_>>()?))
        };
        Ok(Self { train, splits: SPLITS.into_iter().map(split).collect::<Result<_>>()? })
    }

    /// What a row's weights reach on every split.
    pub fn score(&self, row: &Row, weights: &Weights) -> Vec<SplitFigures> {
        let device = Device::flex();
        let network = FloatNetwork::fixed(weights, &device);
        let total: usize = self.splits.iter().map(|(_, episodes)| episodes.len()).sum();
        let bar = progress("score", total as u64);
        bar.set_prefix(format!("score {}", row.name));
        let one = |features: &Features| {
            let input = features.sequences_of(row.variant.pads);
            let logits = if row.making == Making::Recomputed {
                recomputed::logits(&network, &row.variant, &input, &device)
            } else {
                network.outputs(&row.variant, &input, &device)
            };
            bar.inc(1);
            // As the paper's row with accelerometers alone must have had it, the pads say what contact is in every row.
            score_logits(features, &logits)
        };
        let figures = |(split, episodes): &(Split, Vec<Features>)| {
            let mut scores = Scores::default();
            episodes.iter().for_each(|features| scores.add(one(features)));
            SplitFigures::new(*split, episodes.len(), &scores)
        };
        let all = self.splits.iter().map(figures).collect();
        bar.finish_and_clear();
        all
    }
}
