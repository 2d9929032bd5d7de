//! Pictures of the closed loop: one trial over time, and histograms of what took how long.

use std::ops::Range;

use slipsense::params::FRAME_RATE_HZ;
use slipsense_synth::plant::{Direction, LOST_MM};
use svg::Document;
use svg::node::element::{Circle, Group};

use super::draw::{Anchor, CLASS, GREY, INK, RULE, bold, curve, heading, rect, rule, text};
use super::scale::{Scale, line};
use crate::grasp::{Course, Facts, Totals};
use crate::summary::plural;

const WIDTH: f64 = 880.0;
const LEFT: f64 = 64.0;
const RIGHT: f64 = 860.0;
const FONT: &str = "Inter, 'Helvetica Neue', Helvetica, Arial, 'Liberation Sans', 'DejaVu Sans', sans-serif";
/// Shown before and after the slip, seconds.
const BEFORE_S: f64 = 0.2;
const AFTER_S: f64 = 0.8;
const FRAME_S: f64 = 1.0 / FRAME_RATE_HZ as f64;

/// What a trial is, in words.
fn words(facts: &Facts) -> String {
    let speed = facts.speed_mm_s.unwrap_or_default();
    let way = match facts.direction {
        Direction::Twist => format!("twisted at {speed} mm/s"),
        Direction::Pull(deg) => format!("pulled at {speed} mm/s, about {deg}° from the rig's direction"),
    };
    format!("{}, {way}", facts.object)
}

/// A trial around its slip.
pub(crate) fn trial(facts: &Facts, course: &Course, headline: &str) -> String {
    let frames = course.slid_mm.len();
    let outcome = &facts.outcome;
    let middle = outcome.onset.or(outcome.detected).unwrap_or(frames / 2);
    let to_frames = |s: f64| (s / FRAME_S) as usize;
    let shown = middle.saturating_sub(to_frames(BEFORE_S))..(middle + to_frames(AFTER_S)).min(frames);
    // The tick of a frame ends it: times are milliseconds since the tick of the slip's first frame.
    let ms = |frame: f64| (frame - middle as f64 - 1.0) * FRAME_S * 1e3;
    let x = Scale::new(ms(shown.start as f64)..ms(shown.end as f64), LEFT..RIGHT);
    let panel = Panel { shown: shown.clone(), x: &x, ms: &ms };
    let title = text(LEFT, 26.0, Anchor::Start, 16.0, INK, &words(facts));
    let mut group = Group::new().set("font-family", FONT).add(bold(title)).add(text(
        LEFT,
        46.0,
        Anchor::Start,
        12.0,
        GREY,
        headline,
    ));

    let most = |values: &[f64]| values[shown.clone()].iter().copied().fold(0.0, f64::max);
    let top = 98.0;
    let grip = Scale::new(0.0..most(&course.grip_n) * 1.15, top + 110.0..top);
    group = panel.frame(group, top, 110.0, "Grip", "of one finger, N", &grip);
    group = group.add(panel.trace(&grip, INK, &course.grip_n));

    let top = top + 156.0;
    let start = course.slid_mm[shown.start];
    let since = |values: &[f64]| values.iter().map(|mm| mm - start).collect::<Vec<f64>>();
    let (with, without) = (since(&course.slid_mm), since(&course.slid_without_mm));
    let slid = Scale::new(0.0..most(&without).max(most(&with)).clamp(0.5, LOST_MM) * 1.1, top + 110.0..top);
    group = panel.frame(group, top, 110.0, "Way slid", "mm; dashed: without any reaction", &slid);
    group = group.add(panel.trace(&slid, GREY, &without).set("stroke-dasharray", "5 4"));
    group = group.add(panel.trace(&slid, CLASS[2], &with).set("stroke-width", 2.0));

    let top = top + 156.0;
    let lead = most(&course.lead.iter().map(|v| v.abs()).collect::<Vec<f64>>()).max(1.0) * 1.1;
    let scale = Scale::new(-lead..lead, top + 110.0..top);
    let unit = "slip's logit before the next, nat; one dot per frame, orange where the flag is up";
    group = panel.frame(group, top, 110.0, "Network", unit, &scale);
    for frame in shown.clone() {
        let up = course.flag[frame];
        let (colour, radius) = if up { (CLASS[2], 2.6) } else { ("#5b6774", 1.6) };
        let (cx, cy) = (x.at(ms(frame as f64 + 1.0)), scale.clamp(course.lead[frame]));
        group = group.add(Circle::new().set("cx", cx).set("cy", cy).set("r", radius).set("fill", colour));
    }

    let bottom = top + 110.0;
    let tick_s = |frame: usize| (frame + 1) as f64 * FRAME_S;
    let to_ms = |s: f64| (s - tick_s(middle)) * 1e3;
    let mut marks = vec![(0.0, "slip".to_owned(), CLASS[2])];
    if let Some(frame) = outcome.detected {
        let after = to_ms(tick_s(frame));
        marks.push((after, format!("flag, {after:.1} ms"), INK));
        if let Some(peak_s) = outcome.peak_s {
            let peak = to_ms(tick_s(frame) + peak_s);
            marks.push((peak, format!("largest grip, {peak:.1} ms"), CLASS[1]));
        }
    }
    for (row, (at, name, colour)) in marks.into_iter().enumerate() {
        let at = x.clamp(at);
        let y = 58.0 + 11.0 * row as f64;
        group = group.add(rule(at, y + 2.0, at, bottom, colour).set("stroke-dasharray", "3 3")).add(text(
            at + 4.0,
            y + 6.0,
            Anchor::Start,
            11.0,
            colour,
            &name,
        ));
    }
    for &command_s in &course.commands_s {
        let at = to_ms(command_s);
        if ms(shown.start as f64) <= at && at <= ms(shown.end as f64) {
            group = group.add(rect(x.at(at) - 1.0, 200.0, 2.0, 8.0, CLASS[1]));
        }
    }
    group = group.add(text(
        LEFT,
        bottom + 44.0,
        Anchor::Start,
        12.0,
        GREY,
        "Milliseconds since the slip of the whole contact. Blue ticks below the grip: a command has reached the gripper.",
    ));
    group = axis(group, &x, bottom, 10);
    page(group, bottom + 58.0)
}

struct Panel<'a> {
    shown: Range<usize>,
    x: &'a Scale,
    ms: &'a dyn Fn(f64) -> f64,
}

impl Panel<'_> {
    fn frame(&self, group: Group, y: f64, height: f64, title: &str, unit: &str, scale: &Scale) -> Group {
        let mut group = group.add(heading(LEFT, y - 8.0, title, unit));
        let (ticks, digits) = scale.ticks((height / 30.0) as usize);
        for tick in ticks {
            let at = scale.at(tick);
            let label = format!("{tick:.digits$}");
            group = group.add(rule(LEFT, at, RIGHT, at, RULE)).add(text(
                LEFT - 8.0,
                at + 4.0,
                Anchor::End,
                11.0,
                GREY,
                &label,
            ));
        }
        group.add(rule(LEFT, y + height, RIGHT, y + height, "#aab4bf"))
    }

    fn trace(&self, y: &Scale, colour: &'static str, values: &[f64]) -> svg::node::element::Path {
        let points = line(self.shown.clone(), usize::MAX, |frame| values[frame]);
        curve(points.iter().map(|&(frame, v)| (self.x.at((self.ms)(frame + 1.0)), y.clamp(v))), colour)
    }
}

fn axis(mut group: Group, x: &Scale, y: f64, count: usize) -> Group {
    let (ticks, digits) = x.ticks(count);
    for tick in ticks {
        let (at, label) = (x.at(tick), format!("{tick:.digits$}"));
        group = group.add(rule(at, y, at, y + 5.0, GREY)).add(text(
            at,
            y + 19.0,
            Anchor::Middle,
            12.0,
            GREY,
            &label,
        ));
    }
    group
}

fn page(group: Group, height: f64) -> String {
    let page = Document::new()
        .set("viewBox", (0, 0, WIDTH, height))
        .set("width", WIDTH)
        .set("height", height)
        .set("role", "img")
        .add(rect(0.0, 0.0, WIDTH, height, "#ffffff"))
        .add(group);
    format!("{page}\n")
}

/// Histograms: from slip to the flag's tick, and from there to the largest grip.
pub(crate) fn latencies(facts: &[Facts], totals: &Totals, headline: &str) -> String {
    let title = format!(
        "{} of {} slips detected, {} of {} objects kept, {} without any reaction",
        totals.detected, totals.slips, totals.kept, totals.trials, totals.kept_without
    );
    let mut group = Group::new()
        .set("font-family", FONT)
        .add(bold(text(LEFT, 26.0, Anchor::Start, 16.0, INK, &title)))
        .add(text(LEFT, 46.0, Anchor::Start, 12.0, GREY, headline));
    let delays: Vec<f64> = facts.iter().filter_map(|facts| facts.delay_ms).collect();
    let since_flag = |of: fn(&Facts) -> Option<f64>| -> Vec<f64> {
        facts.iter().filter_map(of).map(|s| s * 1e3).collect()
    };
    let firsts = since_flag(|facts| facts.outcome.first_s);
    let peaks = since_flag(|facts| facts.outcome.peak_s);
    let mut y = 92.0;
    for (name, unit, values, bin_ms, colour) in [
        (
            "From slip to the flag",
            "ms to the tick of the frame that says it, bins of two frames",
            delays,
            2e3 * FRAME_S,
            CLASS[2],
        ),
        ("From the flag's tick to the force of the first motion", "ms, bins of 5 ms", firsts, 5.0, CLASS[1]),
        ("From the flag's tick to the largest grip, all motions", "ms, bins of 10 ms", peaks, 10.0, CLASS[1]),
    ] {
        group = histogram(group, y, name, unit, &values, bin_ms, colour);
        y += 206.0;
    }
    page(group, y - 30.0)
}

/// Values outside are counted in the first or last bin.
const SHOWN_MS: Range<f64> = -200.0..500.0;

fn histogram(
    group: Group,
    y: f64,
    name: &str,
    unit: &str,
    values: &[f64],
    bin_ms: f64,
    colour: &'static str,
) -> Group {
    const HEIGHT: f64 = 120.0;
    let ends = ((SHOWN_MS.start / bin_ms).floor() as i64, (SHOWN_MS.end / bin_ms).ceil() as i64 - 1);
    let bin = |ms: f64| ((ms / bin_ms).floor() as i64).clamp(ends.0, ends.1);
    let first = values.iter().map(|&ms| bin(ms)).min().unwrap_or(0).min(0);
    let last = values.iter().map(|&ms| bin(ms)).max().unwrap_or(0).max((100.0 / bin_ms) as i64);
    let count = |of: i64| values.iter().filter(|&&ms| bin(ms) == of).count();
    let most = (first..=last).map(count).max().unwrap_or(0).max(1);
    let x = Scale::new(first as f64 * bin_ms..(last + 1) as f64 * bin_ms, LEFT..RIGHT);
    let scale = Scale::new(0.0..most as f64 * 1.1, y + HEIGHT..y);
    let mut group = group.add(heading(LEFT, y - 8.0, name, unit));
    let (ticks, _) = scale.ticks(4);
    for tick in ticks.into_iter().filter(|tick| tick.fract() == 0.0) {
        let at = scale.at(tick);
        group = group.add(rule(LEFT, at, RIGHT, at, RULE)).add(text(
            LEFT - 8.0,
            at + 4.0,
            Anchor::End,
            11.0,
            GREY,
            &format!("{tick}"),
        ));
    }
    for of in first..=last {
        let (from, to) = (x.at(of as f64 * bin_ms), x.at((of + 1) as f64 * bin_ms));
        let top = scale.at(count(of) as f64);
        group = group.add(rect(from + 0.5, top, to - from - 1.0, y + HEIGHT - top, colour));
    }
    let beyond = values.iter().filter(|ms| !SHOWN_MS.contains(ms)).count();
    if beyond > 0 {
        let note = format!("{beyond} trial{} beyond, counted at the ends", plural(beyond as i64));
        group = group.add(text(RIGHT, y + 8.0, Anchor::End, 11.0, GREY, &note));
    }
    let group = group.add(rule(LEFT, y + HEIGHT, RIGHT, y + HEIGHT, "#aab4bf"));
    axis(group, &x, y + HEIGHT, 10)
}
