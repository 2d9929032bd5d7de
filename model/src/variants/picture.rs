//! Macro F1 of every row on every split as one picture.

use anyhow::{Context, Result};
use plotters::prelude::*;
use slipsense_synth::Split;

use super::orderings::Comparisons;
use crate::picture::{self, Area, COLOURS};

const WIDTH: u32 = 900;
/// Height of a row, and of all that is around the rows.
const ROW_HEIGHT: u32 = 26;
const AROUND_HEIGHT: u32 = 150;
/// Width of the names of the splits, right of the chart.
const RIGHT: u32 = 110;
/// Distance of two splits within a row, rows.
const APART: f64 = 0.12;

/// SVG: a dot per row and split at the mean of the seeds, a line from the lowest to the highest.
pub(super) fn svg(results: &Comparisons) -> Result<String> {
    let rows = &results.rows;
    let most = rows.iter().max_by_key(|row| row.splits.len());
    let splits: Vec<Split> = most.map_or(Vec::new(), |row| row.splits.iter().map(|s| s.split).collect());
    let all = rows.iter().flat_map(|row| &row.splits).filter_map(|split| split.macro_f1);
    let lowest = all.map(|spread| 100.0 * spread.lowest).fold(100.0, f64::min);
    let from = (lowest / 10.0).floor() * 10.0;
    let count = rows.len() as f64;
    let draw = |root: &Area<'_>| {
        let mut chart = ChartBuilder::on(root)
            .caption("Macro F1 on frozen splits, synthetic data", ("sans-serif", 18))
            .margin(12)
            .margin_right(RIGHT)
            .x_label_area_size(44)
            .y_label_area_size(150)
            .build_cartesian_2d(from..100.0, -0.5..count - 0.5)?;
        // From the top down; the axis counts upwards.
        let name = |at: &f64| {
            let row = (at - at.round()).abs().lt(&1e-6).then(|| count - 1.0 - at.round());
            let row = row.filter(|&row| row >= 0.0).and_then(|row| rows.get(row as usize));
            row.map_or(String::new(), |row| row.row.to_owned())
        };
        chart
            .configure_mesh()
            .x_desc("macro F1, %: mean of the seeds, line from the lowest to the highest")
            .y_labels(2 * rows.len() + 1)
            .y_label_formatter(&name)
            .bold_line_style(RGBAColor(128, 128, 128, 0.25))
            .light_line_style(TRANSPARENT)
            .label_style(("sans-serif", 13))
            .draw()?;
        for (n, split) in splits.iter().enumerate() {
            let colour = COLOURS[n % COLOURS.len()];
            let below = (n as f64 - (splits.len() as f64 - 1.0) / 2.0) * APART;
            let figures = rows.iter().enumerate().filter_map(|(index, row)| {
                let spread = row.splits.iter().find(|s| s.split == *split)?.macro_f1?;
                Some((count - 1.0 - index as f64 - below, spread))
            });
            let figures: Vec<_> = figures.collect();
            let lines = figures.iter().map(|&(y, spread)| {
                let points = vec![(100.0 * spread.lowest, y), (100.0 * spread.highest, y)];
                PathElement::new(points, colour.stroke_width(2))
            });
            chart.draw_series(lines)?;
            let dots =
                figures.iter().map(|&(y, spread)| Circle::new((100.0 * spread.mean, y), 4, colour.filled()));
            chart.draw_series(dots)?;
            // Beside the chart, where no dot can be.
            let (x, y) = ((WIDTH - RIGHT) as i32, 56 + 20 * n as i32);
            root.draw(&Circle::new((x + 14, y), 4, colour.filled()))?;
            let name = Text::new(split.name(), (x + 24, y - 7), ("sans-serif", 13));
            root.draw(&name)?;
        }
        anyhow::Ok(())
    };
    let size = (WIDTH, AROUND_HEIGHT + ROW_HEIGHT * rows.len() as u32);
    picture::svg(size, draw).context("cannot draw")
}
