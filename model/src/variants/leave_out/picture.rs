//! The costs as a matrix of colours.

use anyhow::{Context, Result};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use slipsense_synth::FAMILIES;

use super::results::{KNOWN, Results, lower};
use crate::picture::{self, Area};

const TOP: i32 = 74;
const LEFT: i32 = 210;
const ROW: i32 = 24;
/// Above each stage: the families that are left out.
const HEAD: i32 = 30;
const COLUMN: i32 = 130;
/// A loss that has the full colour, points.
const FULL_POINTS: f64 = 20.0;

/// White for no difference, red for a loss, blue for a gain.
fn colour(points: f64) -> RGBColor {
    let pale = (255.0 * (1.0 - (points.abs() / FULL_POINTS).min(1.0))) as u8;
    if points < 0.0 { RGBColor(255, pale, pale) } else { RGBColor(pale, pale, 255) }
}

/// One block a stage: a row for each family that is tested, a column for each that is left out.
pub(super) fn svg(results: &Results) -> Result<String> {
    let stages = results.tested.len() as i32 / FAMILIES as i32;
    let block = HEAD + ROW * FAMILIES as i32;
    let size = ((LEFT + COLUMN * (KNOWN as i32 + 1) + 20) as u32, (TOP + stages * block + 20) as u32);
    let draw = |root: &Area<'_>| {
        let write = |text: &str, x: i32, y: i32, side: HPos| {
            let style = ("sans-serif", 13).into_text_style(root).pos(Pos::new(side, VPos::Center));
            root.draw(&Text::new(text.to_owned(), (x, y), style))
        };
        let title = "Macro F1 on each family, %, and what it costs to train without one, points";
        write(title, 12, 20, HPos::Left)?;
        let below = "Synthetic data; episodes of a stage differ in that family alone. * no network saw it. ! the 95 % interval is on one side of 0";
        write(below, 12, 40, HPos::Left)?;
        for (number, families) in results.tested.chunks(FAMILIES).enumerate() {
            let top = TOP + number as i32 * block;
            let middle = |column: usize| LEFT + COLUMN * column as i32 + COLUMN / 2;
            write(&lower(families[0].stage), 12, top, HPos::Left)?;
            write("all", middle(0), top, HPos::Center)?;
            for (column, left_out) in families[..KNOWN].iter().enumerate() {
                write(&format!("– {}", left_out.family), middle(column + 1), top, HPos::Center)?;
            }
            for (row, tested) in families.iter().enumerate() {
                let y = top + ROW * (row as i32 + 1);
                let star = if tested.is_held_out { " *" } else { "" };
                write(&format!("{}{star}", tested.family), LEFT - 12, y, HPos::Right)?;
                if let Some(all) = tested.all_macro_f1 {
                    write(&format!("{:.1}", 100.0 * all.mean), middle(0), y, HPos::Center)?;
                }
                for (column, cost) in tested.without.iter().enumerate() {
                    let Some(cost) = cost else { continue };
                    let (x, points) = (middle(column + 1), cost.difference.points);
                    let corners = [(x - COLUMN / 2, y - ROW / 2), (x + COLUMN / 2, y + ROW / 2)];
                    root.draw(&Rectangle::new(corners, colour(points).filled()))?;
                    let is_significant =
                        cost.difference.low_points > 0.0 || cost.difference.high_points < 0.0;
                    let mark = if is_significant { " !" } else { "" };
                    write(&format!("{points:+.1}{mark}"), x, y, HPos::Center)?;
                }
            }
        }
        anyhow::Ok(())
    };
    picture::svg(size, draw).context("cannot draw")
}
