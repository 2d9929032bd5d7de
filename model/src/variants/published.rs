//! The paper's tables, of real grippers, beside ours, which are synthetic.

use std::fmt;

use serde::Serialize;
use slipsense_synth::paper::{self, PaperRow};

use super::results::{RowResults, RowSplit, Spread};
use super::{BASE_ROW, BOTH_ROW, PAPER_ROW};

/// A row of the paper's, and what compares with it here.
#[derive(Clone, Debug, Serialize)]
pub struct PaperComparison {
    pub paper: &'static PaperRow,
    pub row: &'static str,
    pub ours: RowSplit,
    pub window_ms: Option<Spread>,
}

impl PaperComparison {
    /// Every pair there is, in the order of the paper's tables. The paper's whole network stands beside three of ours.
    pub(super) fn all(rows: &[RowResults]) -> Vec<Self> {
        let of = |paper: &'static PaperRow| {
            let is_it = move |row: &&RowResults| match row.row {
                BASE_ROW | BOTH_ROW | PAPER_ROW => paper.detector == "network",
                name => paper.detector == name,
            };
            rows.iter().filter(is_it).filter_map(move |row| {
                let ours = row.splits.iter().find(|split| split.split.name() == paper.input)?.clone();
                Some(Self { paper, row: row.row, ours, window_ms: row.window_ms })
            })
        };
        paper::ROWS.iter().flat_map(of).collect()
    }
}

pub(super) const HEADING: &str = "the paper's tables, of real grippers | ours: mean of the seeds, synthetic; each time on its own computer";

pub(super) fn header() -> String {
    let figures = ["latency, frames", "false slip, %", "accuracy, %", "macro F1, %", "window, ms"];
    let figures = figures.map(|figure| format!("{figure:>16}")).concat();
    format!("{:13}{:20}{:10}{figures}", "table", "row", "split")
}

impl fmt::Display for PaperComparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { paper, row, ours, window_ms } = self;
        write!(f, "{:13}{row:20}{:10}", paper.table, paper.input)?;
        let percent = |spread: Option<Spread>| spread.map(|spread| 100.0 * spread.mean);
        let mean = |spread: &Option<Spread>| spread.map(|spread| spread.mean);
        for (theirs, ours) in [
            (Some(paper.latency_frames), mean(&ours.latency_median_frames)),
            (Some(paper.fpr_percent), percent(ours.fpr_of_non_slip_share)),
            (Some(paper.accuracy_percent), percent(ours.accuracy)),
            (Some(paper.macro_f1_percent), percent(ours.macro_f1)),
            (paper.time_ms, mean(window_ms)),
        ] {
            let text = |x: Option<f64>| x.map_or("–".to_owned(), |x| format!("{x:.1}"));
            write!(f, "{:>16}", format!("{} | {}", text(theirs), text(ours)))?;
        }
        Ok(())
    }
}
