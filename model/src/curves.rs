//! The training curves as a picture.

use anyhow::{Context, Result};
use plotters::prelude::*;

use crate::checkpoint::Row;
use crate::picture::{self, Area, COLOURS};

const SIZE: (u32, u32) = (900, 360);

/// SVG text: losses on the left, what the validation objects say on the right.
pub fn svg(rows: &[Row]) -> Result<String> {
    let [blue, vermilion, green, ..] = COLOURS;
    let of = |value: fn(&Row) -> Option<f64>| {
        rows.iter().map(|row| value(row).unwrap_or(f64::NAN)).collect::<Vec<_>>()
    };
    let losses = [
        ("train, weighted and augmented", vermilion, of(|row| Some(row.train_loss))),
        ("validation objects", blue, of(|row| row.validation_loss)),
    ];
    let errors = [
        ("1 − macro F1", blue, of(|row| Some(100.0 * (1.0 - row.validation_macro_f1?)))),
        ("false slip frames", vermilion, of(|row| Some(100.0 * row.validation_fpr?))),
        ("slips missed by the detector", green, of(|row| Some(100.0 * row.validation_missed?))),
    ];
    let draw = |root: &Area<'_>| {
        let (left, right) = root.split_horizontally(SIZE.0 / 2);
        panel(&left, "cross entropy, nat", &losses)?;
        panel(&right, "validation, synthetic, %", &errors)
    };
    picture::svg(SIZE, draw).context("cannot draw the curves")
}

/// `lines`: named values per epoch, with their colour.
fn panel(area: &Area<'_>, title: &str, lines: &[(&str, RGBColor, Vec<f64>)]) -> Result<()> {
    let values = || lines.iter().flat_map(|(_, _, values)| values.iter().copied()).filter(|x| x.is_finite());
    let most = values().fold(0.0, f64::max).max(1e-3) * 1.05;
    let epochs = lines.iter().map(|(_, _, values)| values.len()).max().unwrap_or(1).max(2);
    let mut chart = ChartBuilder::on(area)
        .caption(title, ("sans-serif", 16))
        .margin(10)
        .x_label_area_size(36)
        .y_label_area_size(48)
        .build_cartesian_2d(1.0..epochs as f64, 0.0..most)?;
    chart.configure_mesh().x_desc("epoch").x_labels(epochs.min(12)).draw()?;
    for (name, colour, values) in lines {
        let points: Vec<(f64, f64)> = (1u32..).map(f64::from).zip(values.iter().copied()).collect();
        let style = colour.stroke_width(2);
        let drawn = chart.draw_series(LineSeries::new(points.clone(), style))?;
        drawn.label(*name).legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], style));
        let dots = points.into_iter().map(|point| Circle::new(point, 3, colour.filled()));
        chart.draw_series(dots)?;
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .background_style(WHITE.mix(0.8))
        .border_style(BLACK.mix(0.2))
        .draw()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_picture_names_its_lines() {
        let row = |epoch: usize| Row {
            epoch,
            step: epoch * 10,
            learning_rate: 1e-3,
            train_loss: 1.0 / epoch as f64,
            validation_loss: None,
            validation_accuracy: Some(0.9),
            validation_macro_f1: Some(0.8),
            validation_fpr: Some(0.01),
            validation_missed: Some(0.1),
            validation_latency: Some(4.0),
            seconds: 1.0,
        };
        // One epoch must draw as well, and a figure that is not there must not spoil the axis.
        for rows in [vec![row(1)], vec![row(1), row(2), row(3)]] {
            let svg = svg(&rows).unwrap();
            for text in ["validation objects", "1 − macro F1", "false slip frames", "epoch"] {
                assert!(svg.contains(text), "{text}");
            }
        }
    }
}
