//! The tables that the terminal shows.

use std::fmt;

use super::orderings::Comparisons;
use super::results::{RowSplit, Spread};

/// Width of the first column.
const NAME: usize = 19;
/// Width of the others.
const CELL: usize = 18;

/// Mean and, in brackets, lowest and highest; `scale` times the figure.
fn cell(spread: Option<Spread>, scale: f64, decimals: usize, missing: &str) -> String {
    let Some(Spread { mean, lowest, highest }) = spread else { return missing.to_owned() };
    let text = |x: f64| format!("{:.decimals$}", scale * x);
    let (low, high) = (text(lowest), text(highest));
    if low == high { text(mean) } else { format!("{} ({low}–{high})", text(mean)) }
}

/// How a figure of a row and split is written.
type Show = fn(&RowSplit) -> String;

const FIGURES: [(&str, Show); 3] = [
    ("macro F1, %", |split| cell(split.macro_f1, 100.0, 1, "–")),
    ("false slip frames of non-slip, %", |split| cell(split.fpr_of_non_slip_share, 100.0, 2, "–")),
    ("median latency, frames", |split| {
        cell(split.latency_median_frames, 1.0, 1, if split.events > 0 { "∞" } else { "–" })
    }),
];

impl fmt::Display for Comparisons {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(first) = self.rows.first() else { return writeln!(f, "no row is finished") };
        let seeds = self.rows.iter().map(|row| row.seeds.len()).max().unwrap_or(0);
        writeln!(
            f,
            "Synthetic data, float networks; {} training episodes, {} steps, first {} episodes of each frozen \
             split; mean (lowest–highest) of up to {seeds} seeds",
            self.budget.episodes, self.budget.steps, self.budget.test_episodes
        )?;
        for (figure, show) in FIGURES {
            write!(f, "\n{figure}\n{:NAME$}", "row")?;
            for split in &first.splits {
                write!(f, "{:>CELL$}", split.split.name())?;
            }
            writeln!(f)?;
            for row in &self.rows {
                write!(f, "{:NAME$}", row.row)?;
                for split in &row.splits {
                    write!(f, "{:>CELL$}", show(split))?;
                }
                writeln!(f)?;
            }
        }
        writeln!(f, "\nthe paper's orderings, macro F1 in %, mean over the splits named")?;
        for order in &self.orderings {
            let holds = match (order.holds, order.holds_for_every_seed) {
                (None, _) => "not run",
                (Some(false), _) => "no",
                (Some(true), Some(true)) => "yes, every seed",
                (Some(true), _) => "yes, the means",
            };
            let of = |spread| cell(spread, 100.0, 1, "–");
            let splits: Vec<&str> = order.splits.iter().map(|split| split.name()).collect();
            writeln!(
                f,
                "{holds:16} {:44} {:18} against {:18} {}",
                order.rule,
                of(order.better_macro_f1),
                of(order.worse_macro_f1),
                splits.join(", ")
            )?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cell_has_the_spread_where_there_is_one() {
        let spread = Spread { mean: 0.9512, lowest: 0.948, highest: 0.955 };
        assert_eq!(cell(Some(spread), 100.0, 1, "–"), "95.1 (94.8–95.5)");
        let one = Spread { mean: 2.0, lowest: 2.0, highest: 2.0 };
        assert_eq!(cell(Some(one), 1.0, 1, "–"), "2.0");
        assert_eq!(cell(None, 1.0, 1, "∞"), "∞");
    }
}
