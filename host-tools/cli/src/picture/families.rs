//! The families of physics side by side: pressure, its change at an onset, spectra.

use std::ops::Range;

use slipsense::params::{MEL_BINS, TAXEL_COLS};
use slipsense_eval::families::{AROUND_ONSET, Gallery, Panel};
use slipsense_synth::Stage;

use super::draw::{Anchor, CLASS, Canvas, GREY, INK, bold, curve, rect, rule, text};
use super::heatmap::colour;
use super::scale::Scale;

const LEFT: f64 = 150.0;
const TOP: f64 = 84.0;
const WIDTH: f64 = 150.0;
const HEIGHT: f64 = 96.0;
const COLUMN: f64 = WIDTH + 36.0;
const ROW: f64 = HEIGHT + 44.0;

/// One row a stage, one column a family; recordings stand last in every row.
pub fn families(gallery: &Gallery, headline: &str) -> String {
    let mut canvas = Canvas::new();
    canvas.add(bold(text(16.0, 26.0, Anchor::Start, 16.0, INK, "Families of physics (synthetic data)")));
    canvas.text(16.0, 46.0, Anchor::Start, 12.0, GREY, headline);
    let mut columns = 0;
    for (row, stage) in Stage::ALL.into_iter().enumerate() {
        let top = TOP + ROW * row as f64;
        let of_stage: Vec<&Panel> = gallery
            .synthetic
            .iter()
            .filter(|panel| panel.stage == Some(stage))
            .chain(&gallery.recorded)
            .collect();
        columns = columns.max(of_stage.len());
        let name = format!("{stage:?}").to_lowercase();
        canvas.add(bold(text(16.0, top + 18.0, Anchor::Start, 13.0, INK, &name)));
        for (line, words) in unit(stage).into_iter().enumerate() {
            canvas.text(16.0, top + 36.0 + 14.0 * line as f64, Anchor::Start, 11.0, GREY, words);
        }
        let nat = of_stage.iter().flat_map(|panel| panel.event_nat.iter().chain(&panel.hold_nat)).copied();
        let nat = nat.clone().fold(f64::MAX, f64::min)..nat.fold(f64::MIN, f64::max);
        let fastest = of_stage.iter().flat_map(|panel| &panel.onset_mm_s).copied().fold(1.0, f64::max);
        for (column, panel) in of_stage.into_iter().enumerate() {
            let left = LEFT + COLUMN * column as f64;
            canvas.text(left, top - 6.0, Anchor::Start, 12.0, INK, &panel.name);
            match stage {
                Stage::Contact => map(&mut canvas, panel, left, top),
                Stage::Friction => onset(&mut canvas, &panel.onset_mm_s, 0.0..fastest, left, top),
                Stage::Film => onset(&mut canvas, &panel.onset_pressure, 0.7..1.3, left, top),
                _ => spectra(&mut canvas, panel, nat.clone(), left, top),
            }
        }
    }
    let height = TOP + ROW * Stage::ALL.len() as f64;
    canvas.page(LEFT + COLUMN * columns as f64, height, headline)
}

const fn unit(stage: Stage) -> [&'static str; 3] {
    match stage {
        Stage::Contact => ["mean counts", "in the hold,", "dark: most"],
        Stage::Friction => ["sliding, mm/s,", "0.5 s around", "an onset"],
        Stage::Film => ["pad's sum over", "its mean, 0.5 s", "around an onset"],
        Stage::Disturbance => ["16 mel bins, nat:", "blue: hold,", "orange: loudest"],
        _ => ["16 mel bins, nat:", "blue: hold,", "orange: slip"],
    }
}

fn map(canvas: &mut Canvas, panel: &Panel, left: f64, top: f64) {
    let cell = HEIGHT / TAXEL_COLS as f64;
    let most = panel.hold_counts.iter().copied().fold(1.0, f64::max);
    canvas.add(rect(left, top, HEIGHT, HEIGHT, &colour(1.0)));
    for (taxel, &counts) in
        panel.hold_counts.iter().enumerate().filter(|(_, counts)| **counts >= most / 100.0)
    {
        let (row, col) = (taxel / TAXEL_COLS, taxel % TAXEL_COLS);
        let (x, y) = (left + cell * col as f64, top + cell * row as f64);
        canvas.add(rect(x, y, cell, cell, &colour(1.0 - counts / most)));
    }
}

fn onset(canvas: &mut Canvas, values: &[f64], range: Range<f64>, left: f64, top: f64) {
    let x = Scale::new(0.0..2.0 * AROUND_ONSET as f64, left..left + WIDTH);
    let y = Scale::new(range, top + HEIGHT..top);
    canvas.grid(left, left + WIDTH, top + HEIGHT, HEIGHT, Some(&y));
    let at_onset = x.at(AROUND_ONSET as f64);
    canvas.add(rule(at_onset, top, at_onset, top + HEIGHT, CLASS[2]));
    let points = values.iter().enumerate();
    canvas.add(curve(points.map(|(frame, &value)| (x.at(frame as f64), y.clamp(value))), INK));
    if values.is_empty() {
        canvas.text(left + 4.0, top + 14.0, Anchor::Start, 10.0, GREY, "not known");
    }
}

fn spectra(canvas: &mut Canvas, panel: &Panel, nat: Range<f64>, left: f64, top: f64) {
    let x = Scale::new(0.0..(MEL_BINS - 1) as f64, left..left + WIDTH);
    let y = Scale::new(nat, top + HEIGHT..top);
    canvas.grid(left, left + WIDTH, top + HEIGHT, HEIGHT, Some(&y));
    for (nat, colour) in [(&panel.hold_nat, CLASS[1]), (&panel.event_nat, CLASS[2])] {
        let points = nat.iter().enumerate();
        canvas.add(curve(points.map(|(bin, &nat)| (x.at(bin as f64), y.clamp(nat))), colour));
    }
}
