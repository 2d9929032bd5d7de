//! The timeline picture, an SVG: pressure, log-mel, logits, flag and truth over one time axis, and
//! below it every onset close up. It needs no font of its own and embeds the log-mel image.

mod close_up;
mod draw;
#[cfg(feature = "full")]
mod families;
#[cfg(feature = "full")]
mod grasp;
mod heatmap;
#[cfg(feature = "full")]
mod load_bars;
mod scale;

use std::ops::Range;

use anyhow::Result;
use slipsense::params::{CLASSES, MEL_BINS};
use slipsense_recording::Episode;
use slipsense_recording::score::SLIP;
use svg::node::element::Image;

use crate::simulate::Simulation;
use crate::summary::{EventInfo, Outcome, Summary, TruthInfo, counted, file_name, seconds};
pub use draw::CLASS_NAME;
use draw::{Anchor, CLASS, Canvas, GREY, INK, SENSOR, area, bold, curve, heading, rect, rule, text};
#[cfg(feature = "full")]
pub use families::families;
#[cfg(feature = "full")]
pub use grasp::{latencies as grasp_latencies, trial as grasp_trial};
#[cfg(feature = "full")]
pub use load_bars::{load_bars, rates};
use scale::{LEFT, RIGHT, Scale, columns, line};

const WIDTH: f64 = 1200.0;
const GAP: f64 = 34.0;
const HEADER: f64 = 134.0;
/// Where marks of events and false alarms stand.
const MARKS: f64 = 96.0;
/// More points per line than this cannot be distinguished.
const COLUMNS: usize = 980;
/// Fraction of the log-mel values that may be darker than the darkest colour, and brighter than the
/// brightest: the ramp-in of the filters and single knocks would take all the contrast.
const OUTLIERS: (f64, f64) = (0.02, 0.002);

struct Panels<'a> {
    episode: &'a Episode,
    simulation: &'a Simulation,
    summary: &'a Summary,
    /// Frames to pixels.
    x: Scale,
    /// Top and bottom of each panel so far.
    spans: Vec<(f64, f64)>,
    canvas: Canvas,
}

pub fn timeline(episode: &Episode, simulation: &Simulation, summary: &Summary) -> Result<String> {
    let mut panels = Panels {
        episode,
        simulation,
        summary,
        x: Scale::new(0.0..episode.frames() as f64, LEFT..RIGHT),
        spans: Vec::new(),
        canvas: Canvas::new(),
    };
    panels.header();
    let mut y = panels.pressure(if summary.truth.is_some() { HEADER } else { MARKS }, 104.0) + GAP;
    y = panels.log_mel(y)? + GAP;
    y = panels.logits(y, 120.0) + GAP;
    y = panels.decisions(y) + if episode.slip_true_mm_s.is_some() { GAP } else { 8.0 };
    y = panels.slip_speed(y, 64.0);
    panels.events();
    panels.canvas.axis(&Scale::new(0.0..seconds(episode.frames()), LEFT..RIGHT), y);
    panels.canvas.text(RIGHT + 10.0, y + 19.0, Anchor::Start, 12.0, GREY, "seconds");
    let height = panels.close_ups(y + 50.0);
    Ok(panels.canvas.page(WIDTH, height, &format!("Timeline of {}", summary.episode.words())))
}

impl Panels<'_> {
    fn add(&mut self, node: impl Into<Box<dyn svg::Node>>) {
        self.canvas.add(node);
    }

    fn header(&mut self) {
        self.add(bold(text(20.0, 32.0, Anchor::Start, 19.0, INK, &headline(self.summary))));
        let model = &self.summary.model;
        let (episode, name) = (self.summary.episode.words(), file_name(&model.name));
        let line = format!("{episode}  ·  model {name} {}…", &model.hash[..8]);
        self.canvas.text(20.0, 54.0, Anchor::Start, 13.0, GREY, &line);
    }

    fn panel(&mut self, y: f64, height: f64, title: &str, unit: &str, scale: Option<&Scale>) {
        self.spans.push((y, y + height));
        self.add(heading(LEFT, y - 9.0, title, unit));
        self.canvas.grid(LEFT, RIGHT, y + height, height, scale);
    }

    /// Names at the right edge, moved apart where they would overlap.
    fn names(&mut self, mut names: Vec<(f64, String, &str)>, bottom: f64) {
        names.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut lowest = bottom + 8.0;
        for name in names.iter_mut().rev() {
            name.0 = name.0.min(lowest);
            lowest = name.0 - 14.0;
        }
        for (y, name, colour) in names {
            self.add(bold(text(RIGHT + 10.0, y + 4.0, Anchor::Start, 12.0, colour, &name)));
        }
    }

    fn trace(&mut self, y: &Scale, colour: &'static str, width: f64, value: impl Fn(usize) -> f64) {
        let points = line(0..self.episode.frames(), COLUMNS, value);
        let path = curve(points.iter().map(|&(f, v)| (self.x.at(f), y.clamp(v))), colour);
        self.add(path.set("stroke-width", width));
    }

    fn pressure(&mut self, y: f64, height: f64) -> f64 {
        let sensors = self.episode.sensors;
        let simulation = self.simulation;
        let most = simulation.pressure.iter().copied().max().unwrap_or(0).max(1000);
        let scale = Scale::new(0.0..f64::from(most) / 1000.0 * 1.05, y + height..y);
        self.panel(y, height, "Pressure", "sum of the pad, 1000 ADC counts", Some(&scale));
        let mut names = Vec::new();
        for (sensor, colour) in (0..sensors).zip(SENSOR) {
            let value = |f: usize| f64::from(simulation.pressure[f * sensors + sensor]) / 1000.0;
            // Pads that carry the same force lie on one line: the first shows beneath the others.
            self.trace(&scale, colour, if sensor == 0 { 3.2 } else { 1.4 }, value);
            let last = scale.at(value(self.episode.frames() - 1));
            names.push((last, format!("sensor {sensor}"), colour));
        }
        self.names(names, y + height);
        y + height
    }

    fn log_mel(&mut self, mut y: f64) -> Result<f64> {
        let sensors = self.episode.sensors;
        let height = if sensors == 1 { 110.0 } else { 80.0 };
        let simulation = self.simulation;
        let decibel = |f: usize, s: usize, bin: usize| {
            f64::from(simulation.predictions.logmel[f * sensors + s][bin]) * 10.0 / std::f64::consts::LN_10
        };
        let range = contrast(simulation);
        for sensor in 0..sensors {
            let title = format!("Vibration, sensor {sensor}");
            self.panel(y, height, &title, "log-mel power of the three axes, 20 Hz to 4 kHz", None);
            let image = heatmap::image(0..self.episode.frames(), &range, |f, bin| decibel(f, sensor, bin))?;
            self.add(
                Image::new()
                    .set("x", LEFT)
                    .set("y", y)
                    .set("width", RIGHT - LEFT)
                    .set("height", height)
                    .set("preserveAspectRatio", "none")
                    .set("style", "image-rendering:pixelated")
                    .set("href", image),
            );
            for (bin, name) in [(0, "0.1"), (8, "1.2"), (15, "3.5 kHz")] {
                let at = y + height * (1.0 - (f64::from(bin) + 0.5) / MEL_BINS as f64);
                self.canvas.text(LEFT - 8.0, at + 4.0, Anchor::End, 11.0, GREY, name);
            }
            self.colour_bar(y, height, &range);
            y += height + GAP;
        }
        Ok(y - GAP)
    }

    fn colour_bar(&mut self, y: f64, height: f64, range: &Range<f64>) {
        let steps = 16;
        let step = height / f64::from(steps);
        for i in 0..steps {
            let colour = heatmap::colour((f64::from(i) + 0.5) / f64::from(steps));
            self.add(rect(RIGHT + 10.0, y + height - f64::from(i + 1) * step, 10.0, step + 0.3, &colour));
        }
        self.canvas.text(RIGHT + 26.0, y + 9.0, Anchor::Start, 11.0, GREY, &format!("{:.0} dB", range.end));
        self.canvas.text(RIGHT + 26.0, y + height / 2.0 + 4.0, Anchor::Start, 11.0, GREY, "re 1 g²");
        let low = format!("{:.0} dB", range.start);
        self.canvas.text(RIGHT + 26.0, y + height, Anchor::Start, 11.0, GREY, &low);
    }

    fn logits(&mut self, y: f64, height: f64) -> f64 {
        let simulation = self.simulation;
        let value = |f: usize, class: usize| f64::from(simulation.predictions.logits[f][class]) / 1024.0;
        let all = || (0..self.episode.frames()).flat_map(|f| (0..CLASSES).map(move |class| value(f, class)));
        let (low, high) = (all().fold(f64::MAX, f64::min), all().fold(f64::MIN, f64::max));
        let margin = 0.05 * (high - low).max(0.1);
        let scale = Scale::new(low - margin..high + margin, y + height..y);
        self.panel(y, height, "Network", "logits, nat: the larger, the more likely", Some(&scale));
        let mut names = Vec::new();
        for class in 0..CLASSES {
            self.trace(&scale, CLASS[class], 1.4, |f| value(f, class));
            let last = scale.at(value(self.episode.frames() - 1, class));
            names.push((last, CLASS_NAME[class].to_owned(), CLASS[class]));
        }
        self.names(names, y + height);
        y + height
    }

    fn decisions(&mut self, mut y: f64) -> f64 {
        let simulation = self.simulation;
        let title = if self.episode.label.is_some() { "Decision and truth" } else { "Decision" };
        self.add(bold(text(LEFT, y - 8.0, Anchor::Start, 13.0, INK, title)));
        let mut x = LEFT + 150.0;
        for (colour, name) in CLASS.into_iter().zip(CLASS_NAME) {
            self.add(rect(x, y - 17.0, 10.0, 10.0, colour));
            self.canvas.text(x + 15.0, y - 8.0, Anchor::Start, 12.0, GREY, name);
            x += 34.0 + 6.6 * name.len() as f64;
        }
        let raised =
            |up: &[u8]| up.iter().map(|&up| if up != 0 { SLIP } else { u8::MAX }).collect::<Vec<u8>>();
        y = self.strip(y, "slip", &raised(&simulation.predictions.slip));
        y = self.strip(y, "may begin", &raised(&simulation.predictions.may_begin));
        y = self.strip(y, "class", &simulation.predictions.class);
        if let Some(label) = &self.episode.label {
            y = self.strip(y, "truth", label);
        }
        y
    }

    fn strip(&mut self, y: f64, name: &str, class: &[u8]) -> f64 {
        let height = 18.0;
        self.spans.push((y, y + height));
        self.add(rect(LEFT, y, RIGHT - LEFT, height, "#f2f4f7"));
        self.canvas.text(LEFT - 8.0, y + 13.0, Anchor::End, 12.0, INK, name);
        // A column shows its highest class: a slip of one frame must not vanish.
        let shown = columns(0..self.episode.frames(), COLUMNS * 2);
        let known = |f: usize| Some(class[f]).filter(|c| usize::from(*c) < CLASSES);
        let highest: Vec<_> = shown.iter().map(|column| column.clone().filter_map(known).max()).collect();
        let mut at = 0;
        for run in highest.chunk_by(|a, b| a == b) {
            let (from, to) = (shown[at].start, shown[at + run.len() - 1].end);
            at += run.len();
            if let Some(class) = run[0] {
                let (x1, x2) = (self.x.at(from as f64), self.x.at(to as f64));
                self.add(rect(x1, y, x2 - x1, height, CLASS[usize::from(class)]));
            }
        }
        y + height + 5.0
    }

    fn slip_speed(&mut self, y: f64, height: f64) -> f64 {
        let Some(speed) = &self.episode.slip_true_mm_s else { return y };
        let most = speed.iter().copied().fold(1.0, f32::max);
        let scale = Scale::new(0.0..f64::from(most) * 1.1, y + height..y);
        self.panel(y, height, "True slip speed", "mm/s at the pads, known to the simulator", Some(&scale));
        let points = line(0..self.episode.frames(), COLUMNS, |f| f64::from(speed[f]));
        let points: Vec<_> = points.iter().map(|&(f, v)| (self.x.at(f), scale.clamp(v))).collect();
        self.add(area(&points, y + height, "#f3c9a9"));
        self.add(curve(points.into_iter(), CLASS[2]));
        y + height
    }

    /// Onsets and ends across all panels, detections and false alarms above them.
    fn events(&mut self) {
        let Some(TruthInfo { may_begin: flag, .. }) = &self.summary.truth else { return };
        let spans = std::mem::take(&mut self.spans);
        let mut free = 0.0;
        for event in &flag.events {
            let (from, to) = (self.x.at(event.onset_frame as f64), self.x.at(event.end_frame as f64));
            for x in [from, to] {
                for &(top, bottom) in &spans {
                    self.add(rule(x, top, x, bottom, CLASS[2]).set("stroke-dasharray", "3 3"));
                }
            }
            self.add(rect(from, MARKS + 7.0, to - from, 4.0, CLASS[2]));
            let words = mark(event, to - from);
            if let Some(middle) = room(&words, (from + to) / 2.0, &mut free) {
                self.add(bold(text(middle, MARKS, Anchor::Middle, 13.0, CLASS[2], &words)));
            }
        }
        let mut free = 0.0;
        for alarm in &flag.false_alarms {
            let (from, to) = (self.x.at(alarm.start_frame as f64), self.x.at(alarm.end_frame as f64));
            self.add(rect(from, MARKS + 7.0, (to - from).max(2.0), 4.0, INK));
            // A row of its own: an alarm may be close to an event.
            let words = "false alarm";
            if let Some(middle) = room(words, (from + to) / 2.0, &mut free) {
                self.canvas.text(middle, MARKS - 16.0, Anchor::Middle, 11.0, INK, words);
                self.add(rule(middle, MARKS - 12.0, middle, MARKS + 6.0, INK));
            }
        }
    }
}

/// `middle`, if words fit there behind what is written already; the bars and the table show the rest.
fn room(words: &str, middle: f64, free: &mut f64) -> Option<f64> {
    // Generous for any font of the sizes used here.
    let half = 4.2 * words.chars().count() as f64;
    (middle - half >= *free).then(|| {
        *free = middle + half;
        middle
    })
}

/// What is written above an event, as wide as there is room for.
fn mark(event: &EventInfo, width: f64) -> String {
    let roomy = width > 220.0;
    match (event.outcome, event.delay_ms) {
        (Outcome::Hit, Some(ms)) if roomy => format!("slip, flagged after {ms:.1} ms"),
        (Outcome::Early, Some(ms)) if roomy => format!("slip, flagged {:.1} ms early", -ms),
        (Outcome::Hit | Outcome::Early, Some(ms)) => format!("{ms:+.1} ms"),
        _ => "missed".to_owned(),
    }
}

fn headline(summary: &Summary) -> String {
    let Some(TruthInfo { may_begin: flag, .. }) = &summary.truth else {
        let runs = summary.output.may_begin_runs.len();
        let times = if runs == 1 { "once" } else { &format!("{runs} times") };
        return format!("SlipSense: slip may begin {times} (no labels to compare with)");
    };
    let count = |outcome| flag.events.iter().filter(|event| event.outcome == outcome).count();
    let early = count(Outcome::Early);
    let found = count(Outcome::Hit) + early;
    let early = if early > 0 { format!(", {early} of them early") } else { String::new() };
    let (slips, alarms) =
        (counted(flag.events.len(), "slip"), counted(flag.false_alarms.len(), "false alarm"));
    format!("SlipSense: {found} of {slips} flagged{early}, {alarms}")
}

/// The range of log-mel levels worth colours, dB re 1 g².
fn contrast(simulation: &Simulation) -> Range<f64> {
    let mut levels: Vec<f32> = simulation.predictions.logmel.iter().flatten().copied().collect();
    levels.sort_by(f32::total_cmp);
    let at = |share: f64| {
        let index = (share * (levels.len() - 1) as f64) as usize;
        f64::from(levels[index]) * 10.0 / std::f64::consts::LN_10
    };
    at(OUTLIERS.0)..at(1.0 - OUTLIERS.1).max(at(OUTLIERS.0) + 10.0)
}
