//! One episode over time: score, displacement, truths, flag and disturbances.

use anyhow::Result;
use plotters::prelude::*;
use slipsense::params::FRAME_RATE_HZ;
use slipsense_recording::score::{Interval, SLIP, runs};

use super::plots::{GRID, colour, drawn, text};
use crate::detector::{NEVER, Prediction};
use crate::truth::Truth;

/// Rows of bars, from the top: name, height 1 each.
const ROWS: [&str; 5] = ["score", "flag", "label", "interface", "others"];
const SIZE: (u32, u32) = (900, 330);

pub(super) fn timeline(truth: &Truth, prediction: &Prediction) -> Result<String> {
    let seconds = |frame: usize| frame as f64 / f64::from(FRAME_RATE_HZ);
    let frames = truth.frames();
    drawn(SIZE, |area| {
        let rows = ROWS.len() as f64 + 1.0;
        let mut chart = ChartBuilder::on(area)
            .margin(8)
            .x_label_area_size(38)
            .y_label_area_size(12)
            .build_cartesian_2d(0.0..seconds(frames), 0.0..rows)?;
        chart
            .configure_mesh()
            .disable_y_mesh()
            .disable_y_axis()
            .x_desc("time, s")
            .bold_line_style(GRID)
            .light_line_style(TRANSPARENT)
            .axis_style(GRID)
            .label_style(text(13))
            .draw()?;
        // The score's row is two high and shows the scores around the threshold.
        let top = |row: usize| rows - row as f64 - if row > 0 { 1.0 } else { 0.0 };
        let flags = runs(frames, |f| prediction.class[f] == SLIP);
        let interface = truth.interface.as_ref().map_or(&[][..], |interface| &interface.slip);
        let bars: [(usize, &[Interval]); 3] = [(1, &flags), (2, &truth.slip), (3, interface)];
        for (row, intervals) in bars {
            let bar = |&(start, end): &Interval| {
                let corners = [(seconds(start), top(row) - 0.8), (seconds(end), top(row) - 0.3)];
                Rectangle::new(corners, colour(row - 1).filled())
            };
            chart.draw_series(intervals.iter().map(bar))?;
        }
        let others = truth.events.iter().map(|event| {
            let corners =
                [(event.start_s, top(4) - 0.8), (event.end_s.max(event.start_s + 0.01), top(4) - 0.5)];
            Rectangle::new(corners, RGBAColor(128, 128, 128, 0.4).filled())
        });
        chart.draw_series(others)?;
        let names =
            truth.events.iter().map(|e| Text::new(e.name.clone(), (e.start_s, top(4) - 0.45), text(10)));
        chart.draw_series(names)?;
        let place = scale(&prediction.score, prediction.threshold);
        let score = (0..frames).map(|f| (seconds(f), rows - 1.9 + 1.5 * place(prediction.score[f])));
        chart.draw_series(LineSeries::new(score, colour(3).stroke_width(1)))?;
        let threshold = rows - 1.9 + 1.5 * place(prediction.threshold);
        let ends = [(0.0, threshold), (seconds(frames), threshold)];
        chart.draw_series(LineSeries::new(ends, RGBColor(128, 128, 128)))?;
        let name = |(row, name): (usize, &&str)| Text::new((*name).to_owned(), (0.0, top(row)), text(12));
        chart.draw_series(ROWS.iter().enumerate().map(name))?;
        Ok(())
    })
}

/// Places scores between 0 and 1: their 1st to 99th percentile, and the threshold, fit; others are cut.
fn scale(score: &[f32], threshold: f32) -> impl Fn(f32) -> f64 + use<> {
    let mut sorted: Vec<f32> = score.iter().copied().filter(|&score| score > NEVER).collect();
    sorted.sort_by(f32::total_cmp);
    let at = |p: f64| sorted.get((p * sorted.len() as f64) as usize).copied();
    let low = f64::from(at(0.01).unwrap_or(threshold).min(threshold));
    let high = f64::from(at(0.99).unwrap_or(threshold).max(threshold));
    let span = (high - low).max(f64::MIN_POSITIVE);
    move |score| ((f64::from(score) - low) / span).clamp(0.0, 1.0)
}
