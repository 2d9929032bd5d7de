//! Line plots as inline SVG, for light and dark pages alike.

use anyhow::{Context, Result};
use plotters::coord::Shift;
use plotters::coord::ranged1d::{AsRangedCoord, Ranged, ValueFormatter};
use plotters::prelude::*;

/// Stands for the page's text colour while plotting.
const TEXT: RGBColor = RGBColor(1, 2, 3);
pub(super) const GRID: RGBAColor = RGBAColor(128, 128, 128, 0.25);
/// Okabe and Ito's colours, which colour-blind readers can tell apart, without black and yellow,
/// then three of Tol's.
const COLOURS: [RGBColor; 9] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(230, 159, 0),
    RGBColor(136, 34, 85),
    RGBColor(17, 119, 51),
    RGBColor(153, 153, 153),
];
const SIZE: (u32, u32) = (640, 380);

pub(super) fn colour(n: usize) -> RGBColor {
    COLOURS[n % COLOURS.len()]
}

pub(crate) struct Line {
    pub(crate) name: String,
    pub(crate) points: Vec<(f64, f64)>,
    /// Marked points and whether they are filled.
    pub(crate) marks: Vec<((f64, f64), bool)>,
}

pub(crate) struct Axes<'a> {
    pub(crate) title: &'a str,
    pub(crate) x: &'a str,
    pub(crate) y: &'a str,
    pub(crate) legend: SeriesLabelPosition,
}

/// What `draw` draws as SVG text with the page's colour for text.
pub(super) fn drawn(
    size: (u32, u32),
    draw: impl FnOnce(&DrawingArea<SVGBackend<'_>, Shift>) -> Result<()>,
) -> Result<String> {
    let mut svg = String::new();
    let area = SVGBackend::with_string(&mut svg, size).into_drawing_area();
    draw(&area).and_then(|()| Ok(area.present()?)).context("cannot draw")?;
    drop(area);
    Ok(svg.replace("#010203", "currentColor"))
}

pub(super) fn text(size: u32) -> TextStyle<'static> {
    ("sans-serif", size).into_font().color(&TEXT)
}

/// Lines over axes, of which x may be logarithmic.
pub(crate) fn plot<X>(axes: &Axes<'_>, x: X, y: std::ops::Range<f64>, lines: &[Line]) -> Result<String>
where
    X: AsRangedCoord<Value = f64>,
    X::CoordDescType: Ranged<ValueType = f64> + ValueFormatter<f64>,
{
    drawn(SIZE, |area| {
        let mut chart = ChartBuilder::on(area)
            .caption(axes.title, text(17))
            .margin(10)
            .x_label_area_size(42)
            .y_label_area_size(56)
            .build_cartesian_2d(x, y)?;
        chart
            .configure_mesh()
            .x_desc(axes.x)
            .y_desc(axes.y)
            .axis_style(TEXT)
            .bold_line_style(GRID)
            .light_line_style(TRANSPARENT)
            .label_style(text(13))
            .axis_desc_style(text(14))
            .draw()?;
        for (n, line) in lines.iter().enumerate() {
            let style = colour(n).stroke_width(2);
            chart
                .draw_series(LineSeries::new(line.points.iter().copied(), style))?
                .label(line.name.clone())
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], style));
            let mark = |&(at, filled): &((f64, f64), bool)| {
                let style = if filled { colour(n).filled() } else { colour(n).stroke_width(2) };
                Circle::new(at, 5, style)
            };
            chart.draw_series(line.marks.iter().map(mark))?;
        }
        chart
            .configure_series_labels()
            .position(axes.legend.clone())
            .label_font(text(13))
            .border_style(TRANSPARENT)
            .draw()?;
        Ok(())
    })
}
