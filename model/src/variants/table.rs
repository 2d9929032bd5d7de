//! The tables that the terminal shows.

use std::fmt;

use super::orderings::{Comparisons, Cost, Verdict};
use super::published;
use super::results::{Budget, RowSplit, Spread};
use crate::evaluate::VALIDATION_ALARMS_PER_HOUR;

/// Width of the first column.
const NAME: usize = 19;
/// Width of the others.
const CELL: usize = 20;

/// Mean and, in brackets, lowest and highest; `scale` times the figure.
fn cell(spread: Option<Spread>, scale: f64, decimals: usize, missing: &str) -> String {
    let Some(Spread { mean, lowest, highest }) = spread else { return missing.to_owned() };
    let text = |x: f64| format!("{:.decimals$}", scale * x);
    let (low, high) = (text(lowest), text(highest));
    if low == high { text(mean) } else { format!("{} ({low}–{high})", text(mean)) }
}

type Show = fn(&RowSplit) -> String;

const FIGURES: [(&str, Show); 4] = [
    ("macro F1, %", |split| cell(split.macro_f1, 100.0, 1, "–")),
    ("accuracy, %", |split| cell(split.accuracy, 100.0, 1, "–")),
    ("false slip frames of non-slip, %", |split| cell(split.fpr_of_non_slip_share, 100.0, 2, "–")),
    ("median latency, frames", |split| {
        cell(split.latency_median_frames, 1.0, 1, if split.events > 0 { "∞" } else { "–" })
    }),
];

impl fmt::Display for Comparisons {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(most) = self.rows.iter().max_by_key(|row| row.splits.len()) else {
            return writeln!(f, "no row is finished");
        };
        let Budget { episodes, steps, encoder_steps, test_episodes, encoder_test_episodes, .. } = self.budget;
        let step = self.budget.batch * self.budget.frames;
        let encoder_step = self.budget.encoder_batch * self.budget.encoder_frames;
        let seeds = self.rows.iter().map(|row| row.seeds.len()).max().unwrap_or(0);
        writeln!(
            f,
            "Synthetic data, float networks but for integers; {episodes} training episodes, {steps} steps of {step} frames \
             ({encoder_steps} of {encoder_step} with the paper's encoders), first {test_episodes} \
             ({encoder_test_episodes}) episodes of each frozen split; mean (lowest–highest) of up to {seeds} seeds"
        )?;
        for (figure, show) in FIGURES {
            write!(f, "\n{figure}\n{:NAME$}", "row")?;
            for split in &most.splits {
                write!(f, "{:>CELL$}", split.split.name())?;
            }
            writeln!(f)?;
            for row in &self.rows {
                write!(f, "{:NAME$}", row.row)?;
                for RowSplit { split, .. } in &most.splits {
                    let own = row.splits.iter().find(|own| own.split == *split);
                    write!(f, "{:>CELL$}", own.map_or_else(String::new, show))?;
                }
                writeln!(f)?;
            }
        }
        writeln!(
            f,
            "\n{:NAME$}{:>20}{:>12}{:>24}  {:10}what",
            "row", "detector misses, %", "parameters", "one window, ms", "by"
        )?;
        for row in &self.rows {
            let time = cell(row.window_ms, 1.0, 1, "–");
            let by = row.devices.iter().map(|device| device.name()).collect::<Vec<_>>().join(", ");
            let missed = cell(row.detector_missed, 100.0, 0, "–");
            writeln!(
                f,
                "{:NAME$}{missed:>20}{:>12}{time:>24}  {by:10}{}",
                row.row, row.parameters, row.about
            )?;
        }
        writeln!(
            f,
            "detector: sustained sliding of {} episodes of each validation split at {VALIDATION_ALARMS_PER_HOUR} false alarms \
             per hour, frame by frame\n\
             instructions of the rows that fit the microcontroller: cargo xtask bench --only layouts",
            self.budget.detector_episodes
        )?;
        if !self.published.is_empty() {
            writeln!(f, "\n{}\n{}", published::HEADING, published::header())?;
        }
        for comparison in &self.published {
            writeln!(f, "{comparison}")?;
        }
        writeln!(
            f,
            "\nthe paper's orderings: macro F1, mean over the splits named; difference in points, 95 % interval over \
             episodes and seeds"
        )?;
        for order in &self.orderings {
            let (Some(verdict), Some(d)) = (order.verdict, order.difference) else { continue };
            let verdict = match verdict {
                Verdict::Holds => "holds",
                Verdict::DoesNotHold => "does not hold",
                Verdict::CannotBeTold => "cannot be told",
            };
            let splits: Vec<&str> = order.splits.iter().map(|split| split.name()).collect();
            writeln!(f, "{verdict:15} {:36} {:24} {}", order.rule, d.to_string(), splits.join(", "))?;
        }
        if !self.costs.is_empty() {
            let (ours, paper) = (steps * step, encoder_steps * encoder_step);
            writeln!(
                f,
                "\nwhat the microcontroller's network costs: points of macro F1 lost on both UMI splits, negative ones \
                 gained; rows with our encoders saw {ours} frames, those with the paper's {paper}"
            )?;
        }
        for Cost { what, difference } in &self.costs {
            writeln!(f, "{what:58} {difference}")?;
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
