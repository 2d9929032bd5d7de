//! All rows together, and the orders that the paper found, each compared with the result here.

use std::fmt;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use slipsense::params::CLASSES;
use slipsense_recording::score::ClassScores;
use slipsense_synth::Split;

use super::published::PaperComparison;
use super::results::{Budget, Finished, RowResults, Spread};
use super::{BASE_ROW, BOTH_ROW, INTEGERS_ROW, PAPER_ROW, ROWS};

/// Both UMI splits: where the paper compares modalities, fusions, resolutions and windows.
pub(super) const UMI: [Split; 2] = [Split::UmiId, Split::UmiOod];
/// The other hand: where the paper compares augmentations.
const TESOLLO: [Split; 2] = [Split::Tesollo2, Split::Tesollo3];
/// Frames by truth and prediction.
pub(super) type Confusion = [[u64; CLASSES]; CLASSES];

/// Least difference of both modalities from one alone, points.
const BOTH_POINTS: f64 = 10.0;

/// Fewest seeds, and episodes of each split, that anything is told from.
const LEAST_SEEDS: usize = 3;
const LEAST_EPISODES: usize = 4;
/// Resamples of an interval.
const RESAMPLES: usize = 1000;

/// Whether an order is there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// All of the interval is above what is asked for.
    Holds,
    /// All of it is below.
    DoesNotHold,
    CannotBeTold,
}

/// One expected order of two rows.
#[derive(Clone, Debug, Serialize)]
pub struct Ordering {
    /// What is expected.
    pub rule: String,
    /// The mean of the macro F1 on these splits is compared.
    pub splits: Vec<Split>,
    pub better: &'static str,
    pub worse: &'static str,
    /// Macro F1 of the better row; null where it is missing.
    pub better_macro_f1: Option<Spread>,
    pub worse_macro_f1: Option<Spread>,
    /// Better less worse; null where a row is missing.
    pub difference: Option<Difference>,
    /// By how much it has to be better.
    pub least_points: f64,
    /// Null where a row is missing.
    pub verdict: Option<Verdict>,
}

/// How far one row is ahead of another on the same episodes by the seeds that both have, points of macro F1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Difference {
    pub points: f64,
    /// 95 % interval over episodes and seeds, both drawn again with replacement; wider by √(n / (n − 1)) for n seeds,
    /// which resampling so few takes for nearer than they are.
    pub low_points: f64,
    pub high_points: f64,
    pub seeds: usize,
    /// Of the split with the fewest.
    pub episodes: usize,
}

impl Difference {
    fn new(better: &RowResults, worse: &RowResults, splits: &[Split]) -> Option<Self> {
        let of = |row: &RowResults, seed: u64| {
            let done = row.seeds.iter().find(|done| done.seed == seed)?;
            let split =
                |split: &Split| Some(done.splits.iter().find(|f| f.split == *split)?.confusion.clone());
            splits.iter().map(split).collect::<Option<Vec<_>>>()
        };
        let pairs =
            better.seeds.iter().filter_map(|done| Some([of(better, done.seed)?, of(worse, done.seed)?]));
        let mut pairs: Vec<_> = pairs.collect();
        // Rows with the paper's encoders have the first of the others' episodes.
        for [better, worse] in &mut pairs {
            for (better, worse) in better.iter_mut().zip(worse) {
                let both = better.len().min(worse.len());
                better.truncate(both);
                worse.truncate(both);
            }
        }
        Self::of_pairs(&pairs)
    }

    /// Of frames by truth and prediction, `[seed][better, worse][split][episode]`; none without a seed.
    pub(super) fn of_pairs(pairs: &[[Vec<Vec<Confusion>>; 2]]) -> Option<Self> {
        let first = pairs.first()?;
        let splits = first[0].len();
        let all = |split: usize| (0..first[0][split].len()).collect::<Vec<_>>();
        // Points of a choice of seeds, and of episodes of every split.
        let points = |seeds: &[usize], episodes: &[Vec<usize>]| {
            let of = |seed: usize, side: usize| {
                let per_split = pairs[seed][side]
                    .iter()
                    .zip(episodes)
                    .map(|(all, chosen)| macro_f1(chosen.iter().map(|&at| all[at])).unwrap_or(0.0));
                per_split.sum::<f64>() / splits as f64
            };
            100.0 * seeds.iter().map(|&seed| of(seed, 0) - of(seed, 1)).sum::<f64>() / seeds.len() as f64
        };
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut again = |count: usize| (0..count).map(|_| rng.random_range(0..count)).collect::<Vec<_>>();
        let resample = |_| {
            let seeds = again(pairs.len());
            let episodes: Vec<_> = (0..splits).map(|split| again(all(split).len())).collect();
            points(&seeds, &episodes)
        };
        let mut drawn: Vec<f64> = (0..RESAMPLES).map(resample).collect();
        drawn.sort_by(f64::total_cmp);
        let whole: Vec<_> = (0..splits).map(all).collect();
        let points = points(&(0..pairs.len()).collect::<Vec<_>>(), &whole);
        let seeds = pairs.len();
        let wider = (seeds as f64 / (seeds as f64 - 1.0).max(1.0)).sqrt();
        Some(Self {
            points,
            low_points: points + wider * (drawn[RESAMPLES / 40] - points),
            high_points: points + wider * (drawn[RESAMPLES - 1 - RESAMPLES / 40] - points),
            seeds,
            episodes: whole.iter().map(Vec::len).min()?,
        })
    }

    /// Held against what is asked for.
    fn verdict(&self, least_points: f64) -> Verdict {
        if self.seeds < LEAST_SEEDS || self.episodes < LEAST_EPISODES {
            Verdict::CannotBeTold
        } else if self.low_points > least_points {
            Verdict::Holds
        } else if self.high_points < least_points {
            Verdict::DoesNotHold
        } else {
            Verdict::CannotBeTold
        }
    }
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { points, low_points, high_points, .. } = self;
        write!(f, "{points:+.1} ({low_points:+.1} to {high_points:+.1})")
    }
}

/// Of these episodes together.
pub(super) fn macro_f1(episodes: impl Iterator<Item = Confusion>) -> Option<f64> {
    let mut sum = ClassScores::default();
    episodes.for_each(|confusion| sum.add(&ClassScores { confusion }));
    sum.macro_f1()
}

/// What the shipped network's size and integers cost.
#[derive(Clone, Debug, Serialize)]
pub struct Cost {
    pub what: &'static str,
    /// The row without it less the row with it, on both UMI splits.
    pub difference: Difference,
}

fn costs(rows: &[RowResults]) -> Vec<Cost> {
    let row = |name: &str| rows.iter().find(|row| row.row == name);
    let cost = |(what, without, with)| {
        let difference = Difference::new(row(without)?, row(with)?, &UMI)?;
        Some(Cost { what, difference })
    };
    let both = [
        ("our encoders and embeddings of 32 instead of the paper's", PAPER_ROW, BASE_ROW),
        ("integers instead of floats", BASE_ROW, INTEGERS_ROW),
    ];
    both.into_iter().filter_map(cost).collect()
}

/// Every expected order, in that of the paper.
pub(super) fn orderings(rows: &[RowResults]) -> Vec<Ordering> {
    let expected = |rule: &str, splits: [Split; 2], better, worse, least_points: f64| {
        let row = |name: &str| rows.iter().find(|row| row.row == name);
        let difference = row(better).zip(row(worse)).and_then(|(b, w)| Difference::new(b, w, &splits));
        Ordering {
            rule: rule.to_owned(),
            better_macro_f1: row(better).and_then(|row| row.macro_f1(&splits)),
            worse_macro_f1: row(worse).and_then(|row| row.macro_f1(&splits)),
            splits: splits.to_vec(),
            better,
            worse,
            difference,
            least_points,
            verdict: difference.map(|difference| difference.verdict(least_points)),
        }
    };
    let on_umi = |rule: &str, better, worse| expected(rule, UMI, better, worse, 0.0);
    let both = |one: &str, row| {
        let rule = format!("both modalities > {one} by {BOTH_POINTS} points");
        expected(&rule, UMI, BOTH_ROW, row, BOTH_POINTS)
    };
    vec![
        both("piezo", "piezo"),
        both("XL", "xl"),
        on_umi("cross-attention > concatenation", BASE_ROW, "concatenation"),
        on_umi("concatenation > late", "concatenation", "late"),
        on_umi("32×32 > 16×16", BASE_ROW, "side16"),
        on_umi("16×16 > 8×8", "side16", "side8"),
        on_umi("T = 15 > T = 6", "t15", "t6"),
        on_umi("T = 30 > T = 15", "t30", "t15"),
        on_umi("T = 60 > T = 30", BASE_ROW, "t30"),
        expected("XL augmentation > none, Tesollo", TESOLLO, BASE_ROW, "no-xl-augmentation", 0.0),
        on_umi("custom CNN > ResNet-18", PAPER_ROW, "resnet18"),
        on_umi("ViT-MAE, scratch > ResNet-18", "vit-scratch", "resnet18"),
        on_umi("ViT-MAE, frozen > scratch", "vit-frozen", "vit-scratch"),
        on_umi("ViT-MAE, frozen > finetuned", "vit-frozen", "vit-finetuned"),
        on_umi("custom CNN > ViT-MAE, frozen", PAPER_ROW, "vit-frozen"),
        on_umi("1-D CNN > MLP", "paper-cnn", "paper-mlp"),
        on_umi("SSAST-Tiny > 1-D CNN", PAPER_ROW, "paper-cnn"),
    ]
}

/// The root of `comparisons.json`. Keys carry their units: `_share` from 0 to 1, `_frames` of 1/240 s, `_s`,
/// `_points` of a hundredth; F1 has none.
#[derive(Clone, Debug, Serialize)]
pub struct Comparisons {
    /// All figures are of generated episodes.
    pub synthetic: bool,
    /// The command that makes them again.
    pub command: String,
    pub budget: Budget,
    pub rows: Vec<RowResults>,
    /// The paper's tables beside ours.
    pub published: Vec<PaperComparison>,
    pub orderings: Vec<Ordering>,
    pub costs: Vec<Cost>,
}

impl Comparisons {
    pub fn new(command: String, budget: Budget, finished: &[Finished]) -> Self {
        let rows: Vec<RowResults> = ROWS.iter().filter_map(|row| RowResults::new(row, finished)).collect();
        Self {
            synthetic: true,
            command,
            budget,
            orderings: orderings(&rows),
            costs: costs(&rows),
            published: PaperComparison::all(&rows),
            rows,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A row of four episodes on both splits with so many of 100 slip frames missed in each.
    fn row(name: &'static str, missed: &[[u64; 4]]) -> RowResults {
        let finished: Vec<Finished> = missed.iter().zip(1..).map(|(missed, seed)| {
            let confusion = missed.map(|n| [[50, 0, 0], [0, 100, 0], [0, n, 100 - n]]).to_vec();
            let split = |split| serde_json::json!({"split": split, "episodes": 4, "frames": 1000, "events": 4, "confusion": confusion});
            serde_json::from_value(serde_json::json!({
                "row": name, "seed": seed, "synthetic": true, "budget": Budget::default(), "parameters": 1,
                "wall_s": 1.0, "window_ms": null, "splits": UMI.map(split),
            })).unwrap()
        }).collect();
        RowResults::new(super::super::row_named(name).unwrap(), &finished).unwrap()
    }

    #[test]
    fn an_order_holds_where_all_of_its_interval_does() {
        let verdict = |better: &[[u64; 4]], worse: &[[u64; 4]]| {
            let orderings = orderings(&[row("side16", better), row("side8", worse)]);
            let order = orderings.into_iter().find(|order| order.better == "side16").unwrap();
            (order.verdict, order.difference.unwrap())
        };
        let (few, many) = ([1, 2, 3, 2], [9, 30, 20, 15]);
        let (holds, difference) = verdict(&[few; 3], &[many; 3]);
        assert_eq!((holds, difference.seeds), (Some(Verdict::Holds), 3));
        // All eight slip frames missed of 400 and 74 of 400: macro F1 by hand.
        let f1 = |missed: f64| {
            let hit = 400.0 - missed;
            (1.0 + 800.0 / (800.0 + missed) + 2.0 * hit / (hit + 400.0)) / 3.0
        };
        assert!((difference.points - 100.0 * (f1(8.0) - f1(74.0))).abs() < 1e-9, "{difference:?}");
        assert!(difference.low_points < difference.points && difference.points < difference.high_points);
        assert_eq!(verdict(&[many; 3], &[few; 3]).0, Some(Verdict::DoesNotHold));
        // One seed says this and one that.
        assert_eq!(verdict(&[few, many, few], &[many, few, many]).0, Some(Verdict::CannotBeTold));
        assert_eq!(verdict(&[few; 3], &[few; 3]).0, Some(Verdict::CannotBeTold));
        // Too few seeds.
        assert_eq!(verdict(&[few; 2], &[many; 2]).0, Some(Verdict::CannotBeTold));
        assert!(orderings(&[row("side16", &[few; 3])]).iter().all(|order| order.verdict.is_none()));
    }
}
