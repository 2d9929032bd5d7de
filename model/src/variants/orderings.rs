//! All rows together, and the orders that the paper found, each compared with the result here.

use serde::Serialize;
use slipsense_synth::Split;

use super::results::{Budget, Finished, RowResults, Spread};
use super::{BASE_ROW, ROWS};

/// Both UMI splits: where the paper compares modalities, fusions, resolutions and windows.
const UMI: [Split; 2] = [Split::UmiId, Split::UmiOod];
/// The other hand: where the paper compares augmentations.
const TESOLLO: [Split; 2] = [Split::Tesollo2, Split::Tesollo3];
/// Least difference of both modalities from one alone, points.
const BOTH_POINTS: f64 = 10.0;

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
    /// Better less worse, means of the seeds.
    pub difference_points: Option<f64>,
    /// By how much it has to be better.
    pub least_points: f64,
    /// Whether the means are in this order; null where a row is missing.
    pub holds: Option<bool>,
    /// Whether the better row's worst seed is also no worse than the worse row's best.
    pub holds_for_every_seed: Option<bool>,
}

/// How one row must be better than another.
#[derive(Clone, Copy)]
enum Must {
    Be,
    NotBeWorse,
    /// Least difference, points.
    By(f64),
}

/// Every expected order, in that of the paper.
pub(super) fn orderings(rows: &[RowResults]) -> Vec<Ordering> {
    let expected = |rule: &str, splits: [Split; 2], better, worse, must| {
        let of = |name: &str| rows.iter().find(|row| row.row == name)?.macro_f1(&splits);
        Ordering::new(rule, &splits, (better, of(better)), (worse, of(worse)), must)
    };
    vec![
        expected("both modalities > piezo", UMI, BASE_ROW, "piezo", Must::By(BOTH_POINTS)),
        expected("both modalities > XL", UMI, BASE_ROW, "xl", Must::By(BOTH_POINTS)),
        expected("cross-attention ≥ concatenation", UMI, BASE_ROW, "concatenation", Must::NotBeWorse),
        expected("concatenation ≥ late", UMI, "concatenation", "late", Must::NotBeWorse),
        expected("32×32 > 16×16", UMI, BASE_ROW, "side16", Must::Be),
        expected("16×16 > 8×8", UMI, "side16", "side8", Must::Be),
        expected("8×8 > XL only", UMI, "side8", "xl", Must::Be),
        expected("T = 15 > T = 6", UMI, "t15", "t6", Must::Be),
        expected("T = 30 > T = 15", UMI, "t30", "t15", Must::Be),
        expected("T = 60 > T = 30", UMI, BASE_ROW, "t30", Must::Be),
        expected("XL augmentation > none, Tesollo", TESOLLO, BASE_ROW, "no-xl-augmentation", Must::Be),
    ]
}

impl Ordering {
    fn new(
        rule: &str,
        splits: &[Split],
        (better, better_macro_f1): (&'static str, Option<Spread>),
        (worse, worse_macro_f1): (&'static str, Option<Spread>),
        must: Must,
    ) -> Self {
        let least_points = if let Must::By(points) = must { points } else { 0.0 };
        let in_order = |points: f64| match must {
            Must::Be => points > 0.0,
            Must::NotBeWorse | Must::By(_) => points >= least_points,
        };
        let both = better_macro_f1.zip(worse_macro_f1);
        let difference_points = both.map(|(better, worse)| 100.0 * (better.mean - worse.mean));
        Self {
            rule: match must {
                Must::By(points) => format!("{rule} by {points} points"),
                Must::Be | Must::NotBeWorse => rule.to_owned(),
            },
            splits: splits.to_vec(),
            better,
            worse,
            better_macro_f1,
            worse_macro_f1,
            difference_points,
            least_points,
            holds: difference_points.map(in_order),
            holds_for_every_seed: both
                .map(|(better, worse)| in_order(100.0 * (better.lowest - worse.highest))),
        }
    }
}

/// The root of `comparisons.json`. Keys carry their units: `_share` from 0 to 1, `_frames` of 1/240 s, `_s`,
/// `_points` of a hundredth; F1 has none.
#[derive(Clone, Debug, Serialize)]
pub struct Comparisons {
    /// All figures are of generated episodes.
    pub synthetic: bool,
    /// The command that makes them again.
    pub command: String,
    /// What every row got.
    pub budget: Budget,
    pub rows: Vec<RowResults>,
    pub orderings: Vec<Ordering>,
}

impl Comparisons {
    /// Collect what is finished.
    pub fn new(command: String, budget: Budget, finished: &[Finished]) -> Self {
        let rows: Vec<RowResults> = ROWS.iter().filter_map(|row| RowResults::new(row, finished)).collect();
        Self { synthetic: true, command, budget, orderings: orderings(&rows), rows }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(mean: f64, around: f64) -> Option<Spread> {
        Some(Spread { mean, lowest: mean - around, highest: mean + around })
    }

    #[test]
    fn an_order_is_held_against_the_means_and_every_seed() {
        let order = |better, worse, must| Ordering::new("a > b", &UMI, ("a", better), ("b", worse), must);
        let by_ten = order(at(0.95, 0.01), at(0.84, 0.002), Must::By(10.0));
        assert_eq!((by_ten.holds, by_ten.holds_for_every_seed), (Some(true), Some(false)));
        assert!((by_ten.difference_points.unwrap() - 11.0).abs() < 1e-9);
        assert_eq!(by_ten.rule, "a > b by 10 points");
        let equal = at(0.9, 0.0);
        assert_eq!(order(equal, equal, Must::NotBeWorse).holds, Some(true));
        assert_eq!(order(equal, equal, Must::Be).holds, Some(false));
        assert_eq!(order(equal, None, Must::Be).holds, None);
    }
}
