//! Shapes of the picture and their colours.

use svg::node::Text as Content;
use svg::node::element::path::Data;
use svg::node::element::{Line, Path, Rectangle, TSpan, Text};

/// Text and axes.
pub(super) const INK: &str = "#1f2933";
/// Secondary text.
pub(super) const GREY: &str = "#66727f";
/// Lines that guide the eye.
pub(super) const RULE: &str = "#dfe4ea";
/// Classes: no contact, contact without slip, slip. Told apart by the colour-blind too (Okabe and Ito).
pub(super) const CLASS: [&str; 3] = ["#a3aebb", "#4a9bd4", "#d55e00"];
/// Names of the classes.
pub(crate) const CLASS_NAME: [&str; 3] = ["no contact", "no slip", "slip"];
/// Sensors.
pub(super) const SENSOR: [&str; 3] = ["#2b3a55", "#009e73", "#cc79a7"];

/// Where text stands relative to its point.
#[derive(Clone, Copy, Debug)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

pub(super) fn text(x: f64, y: f64, anchor: Anchor, size: f64, colour: &str, words: &str) -> Text {
    let anchor = match anchor {
        Anchor::Start => "start",
        Anchor::Middle => "middle",
        Anchor::End => "end",
    };
    Text::new("")
        .set("x", round(x))
        .set("y", round(y))
        .set("text-anchor", anchor)
        .set("font-size", size)
        .set("fill", colour)
        .add(Content::new(words))
}

/// A title and, paler, what it is measured in.
pub(super) fn heading(x: f64, y: f64, title: &str, unit: &str) -> Text {
    let title = TSpan::new(title).set("font-weight", 600).set("font-size", 13).set("fill", INK);
    let unit = TSpan::new(unit).set("dx", 8).set("font-size", 12).set("fill", GREY);
    Text::new("").set("x", round(x)).set("y", round(y)).add(title).add(unit)
}

pub(super) fn bold(text: Text) -> Text {
    text.set("font-weight", 600)
}

pub(super) fn rect(x: f64, y: f64, width: f64, height: f64, colour: &str) -> Rectangle {
    Rectangle::new()
        .set("x", round(x))
        .set("y", round(y))
        .set("width", round(width))
        .set("height", round(height))
        .set("fill", colour)
}

pub(super) fn rule(x1: f64, y1: f64, x2: f64, y2: f64, colour: &str) -> Line {
    Line::new()
        .set("x1", round(x1))
        .set("y1", round(y1))
        .set("x2", round(x2))
        .set("y2", round(y2))
        .set("stroke", colour)
        .set("stroke-width", 1)
}

/// A line through points, in pixels.
pub(super) fn curve(points: impl Iterator<Item = (f64, f64)>, colour: &str) -> Path {
    Path::new()
        .set("d", path(points))
        .set("fill", "none")
        .set("stroke", colour)
        .set("stroke-width", 1.4)
        .set("stroke-linejoin", "round")
}

/// The area between points and a level, in pixels.
pub(super) fn area(points: &[(f64, f64)], level: f64, colour: &str) -> Path {
    let (Some(first), Some(last)) = (points.first(), points.last()) else {
        return Path::new();
    };
    let outline = [(first.0, level)].into_iter().chain(points.iter().copied()).chain([(last.0, level)]);
    Path::new().set("d", path(outline).close()).set("fill", colour)
}

fn path(points: impl Iterator<Item = (f64, f64)>) -> Data {
    points.enumerate().fold(Data::new(), |data, (i, (x, y))| match i {
        0 => data.move_to((round(x), round(y))),
        _ => data.line_to((round(x), round(y))),
    })
}

/// A tenth of a pixel is more than a screen shows and keeps the file small.
fn round(pixels: f64) -> f64 {
    (pixels * 10.0).round() / 10.0
}
