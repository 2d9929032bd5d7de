//! One episode as pads alone, accelerometers alone and both see it: the paper's qualitative picture.

use anyhow::{Context, Result};
use plotters::prelude::*;
use slipsense::params::{CLASSES, FRAME_RATE_HZ, OUTPUTS};
use slipsense_recording::score::{SLIP, runs};
use slipsense_synth::Split;

use super::results::{Example, RowResults};
use super::sets::Sets;
use super::{BOTH_ROW, Row};
use crate::data::Features;
use crate::evaluate::classes;
use crate::picture::{self, Area, COLOURS};

/// The rows that the picture has, from the top.
const SHOWN: [(&str, &str); 3] = [("piezo", "pads"), ("xl", "accelerometers"), (BOTH_ROW, "both")];
const SIZE: (u32, u32) = (900, 420);

/// What a network says of the episode; none for a row that is not in the picture.
pub(super) fn of(
    row: &Row,
    sets: &Sets,
    outputs: impl Fn(&Features) -> Vec<[f32; OUTPUTS]>,
) -> Option<Example> {
    SHOWN.iter().find(|(name, _)| *name == row.name)?;
    let features = sets.splits.iter().find(|(split, _)| *split == Split::UmiOod)?.1.first()?;
    let outputs = outputs(features);
    let probability = |logits: &[f32; OUTPUTS]| {
        let power = |class: usize| f64::from(logits[class]).exp();
        (power(SLIP as usize) / (0..CLASSES).map(power).sum::<f64>()) as f32
    };
    Some(Example {
        label: features.label.clone(),
        class: classes(features, &outputs, row.variant.pads_say_contact()),
        slip_probability: outputs.iter().map(probability).collect(),
    })
}

/// SVG, a panel for each of the rows that are there, of its first seed. None if none is.
pub(super) fn svg(rows: &[RowResults]) -> Result<Option<String>> {
    let example = |&(name, title): &(&str, &'static str)| {
        let seed = rows.iter().find(|row| row.row == name)?.seeds.first()?;
        Some((title, seed.example.as_ref()?))
    };
    let shown: Vec<_> = SHOWN.iter().filter_map(example).collect();
    if shown.is_empty() {
        return Ok(None);
    }
    let draw = |root: &Area<'_>| {
        let title = "Probability of slip, one synthetic episode; shaded: slip by the label";
        let below = root.titled(title, ("sans-serif", 16))?;
        for (area, (title, example)) in below.split_evenly((shown.len(), 1)).iter().zip(&shown) {
            panel(area, title, example)?;
        }
        anyhow::Ok(())
    };
    picture::svg(SIZE, draw).context("cannot draw").map(Some)
}

fn panel(area: &Area<'_>, title: &str, example: &Example) -> Result<()> {
    let time_s = |frame: usize| frame as f64 / f64::from(FRAME_RATE_HZ);
    let mut chart = ChartBuilder::on(area)
        .margin(6)
        .margin_right(20)
        .x_label_area_size(28)
        .y_label_area_size(60)
        .build_cartesian_2d(0.0..time_s(example.label.len()), 0.0..1.1)?;
    let slips = |class: &[u8], from: f64, to: f64, style: ShapeStyle| {
        let slips = runs(class.len(), |frame| class[frame] == SLIP).into_iter();
        slips.map(move |(first, end)| Rectangle::new([(time_s(first), from), (time_s(end), to)], style))
    };
    let [line, flagged] = [COLOURS[0], COLOURS[1]];
    chart.draw_series(slips(&example.label, 0.0, 1.1, BLACK.mix(0.15).filled()))?;
    chart.draw_series(slips(&example.class, 1.03, 1.1, flagged.filled()))?;
    let points = example.slip_probability.iter().enumerate();
    let points = points.map(|(frame, &p)| (time_s(frame), f64::from(p)));
    chart.draw_series(LineSeries::new(points, line.stroke_width(1)))?;
    chart
        .configure_mesh()
        .disable_mesh()
        .x_desc("s; bar on top: class is slip")
        .y_desc(title)
        .y_labels(3)
        .draw()?;
    Ok(())
}
