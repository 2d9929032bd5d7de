//! Shapes of the pictures and their colours.

use svg::Document;
use svg::node::Text as Content;
use svg::node::element::path::Data;
use svg::node::element::{Group, Line, Path, Rectangle, TSpan, Text};

use super::scale::Scale;

const FONT: &str = "Inter, 'Helvetica Neue', Helvetica, Arial, 'Liberation Sans', 'DejaVu Sans', sans-serif";

/// Text and axes.
pub(super) const INK: &str = "#1f2933";
pub(super) const GREY: &str = "#66727f";
/// Grid lines.
pub(super) const RULE: &str = "#dfe4ea";
/// The bottom line of a panel.
pub(super) const BASE: &str = "#aab4bf";
/// A line or dot without a class.
pub(super) const NEUTRAL: &str = "#5b6774";
/// Classes: no contact, contact without slip, slip. Colour-blind readers can distinguish them (Okabe and Ito).
pub(super) const CLASS: [&str; 3] = ["#a3aebb", "#4a9bd4", "#d55e00"];
pub const CLASS_NAME: [&str; 3] = ["no contact", "no slip", "slip"];
pub(super) const SENSOR: [&str; 3] = ["#2b3a55", "#009e73", "#cc79a7"];

pub(super) struct Canvas(pub(super) Group);

impl Canvas {
    pub(super) fn new() -> Self {
        Self(Group::new().set("font-family", FONT))
    }

    pub(super) fn add(&mut self, node: impl Into<Box<dyn svg::Node>>) {
        self.0 = std::mem::take(&mut self.0).add(node);
    }

    pub(super) fn text(&mut self, x: f64, y: f64, anchor: Anchor, size: f64, colour: &str, words: &str) {
        self.add(text(x, y, anchor, size, colour, words));
    }

    /// Lines at round values of a panel `height` pixels high, with the values left of it, and its bottom line.
    pub(super) fn grid(&mut self, left: f64, right: f64, bottom: f64, height: f64, scale: Option<&Scale>) {
        if let Some(scale) = scale {
            let (ticks, digits) = scale.ticks((height / 30.0) as usize);
            for tick in ticks {
                let at = scale.at(tick);
                self.add(rule(left, at, right, at, RULE));
                self.text(left - 8.0, at + 4.0, Anchor::End, 11.0, GREY, &format!("{tick:.digits$}"));
            }
        }
        self.add(rule(left, bottom, right, bottom, BASE));
    }

    /// Round values below a panel, about ten.
    pub(super) fn axis(&mut self, scale: &Scale, y: f64) {
        let (ticks, digits) = scale.ticks(10);
        for tick in ticks {
            let x = scale.at(tick);
            self.add(rule(x, y, x, y + 5.0, GREY));
            self.text(x, y + 19.0, Anchor::Middle, 12.0, GREY, &format!("{tick:.digits$}"));
        }
    }

    /// The SVG file; `label` is what a screen reader says.
    pub(super) fn page(self, width: f64, height: f64, label: &str) -> String {
        let page = Document::new()
            .set("viewBox", (0, 0, width, height))
            .set("width", width)
            .set("height", height)
            .set("role", "img")
            .set("aria-label", label)
            .add(rect(0.0, 0.0, width, height, "#ffffff"))
            .add(self.0);
        format!("{page}\n")
    }
}

/// The point of a text that its place names, as SVG calls it.
#[derive(Clone, Copy, Debug)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

pub(super) fn text(x: f64, y: f64, anchor: Anchor, size: f64, colour: &str, words: &str) -> Text {
    Text::new("")
        .set("x", round(x))
        .set("y", round(y))
        .set("text-anchor", format!("{anchor:?}").to_lowercase())
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
