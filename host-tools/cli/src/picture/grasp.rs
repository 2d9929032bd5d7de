//! Pictures of the closed loop: one trial over time, and histograms of what took how long.

use std::ops::Range;

use slipsense::params::FRAME_RATE_HZ;
use slipsense_synth::plant::{Direction, LOST_MM};
use svg::node::element::Circle;

use super::draw::{Anchor, CLASS, Canvas, GREY, INK, NEUTRAL, bold, curve, heading, rect, rule, text};
use super::scale::{Scale, line};
use crate::grasp::{Totals, TrialResult, TrialSeries};
use crate::summary::counted;

const WIDTH: f64 = 880.0;
const LEFT: f64 = 64.0;
const RIGHT: f64 = 860.0;
/// Shown before and after the slip, seconds.
const BEFORE_S: f64 = 0.2;
const AFTER_S: f64 = 0.8;
const FRAME_S: f64 = 1.0 / FRAME_RATE_HZ as f64;

fn words(result: &TrialResult) -> String {
    let speed = result.speed_mm_s.unwrap_or_default();
    let way = match result.direction {
        Direction::Twist => format!("twisted at {speed} mm/s"),
        Direction::Pull(deg) => format!("pulled at {speed} mm/s, about {deg}° from the rig's direction"),
    };
    format!("{}, {way}", result.object)
}

pub fn trial(result: &TrialResult, series: &TrialSeries, headline: &str) -> String {
    let frames = series.slid_mm.len();
    let outcome = &result.outcome;
    let middle = outcome.onset.or(outcome.detected).unwrap_or(frames / 2);
    let to_frames = |s: f64| (s / FRAME_S) as usize;
    let shown = middle.saturating_sub(to_frames(BEFORE_S))..(middle + to_frames(AFTER_S)).min(frames);
    // The tick of a frame ends it: times are milliseconds since the tick of the slip's first frame.
    let ms = |frame: f64| (frame - middle as f64 - 1.0) * FRAME_S * 1e3;
    let x = Scale::new(ms(shown.start as f64)..ms(shown.end as f64), LEFT..RIGHT);
    let mut canvas = titled(&words(result), headline);
    let trace = |y: &Scale, colour: &'static str, values: &[f64]| {
        let points = line(shown.clone(), usize::MAX, |frame| values[frame]);
        curve(points.iter().map(|&(frame, v)| (x.at(ms(frame + 1.0)), y.clamp(v))), colour)
    };
    let mut top = 98.0;
    let mut panel = |canvas: &mut Canvas, title: &str, unit: &str, range: Range<f64>| {
        let scale = Scale::new(range, top + PANEL..top);
        canvas.add(heading(LEFT, top - 8.0, title, unit));
        canvas.grid(LEFT, RIGHT, top + PANEL, PANEL, Some(&scale));
        top += PANEL + 46.0;
        scale
    };
    let most = |values: &[f64]| values[shown.clone()].iter().copied().fold(0.0, f64::max);

    let grip = panel(&mut canvas, "Grip", "of one finger, N", 0.0..most(&series.grip_n) * 1.15);
    canvas.add(trace(&grip, INK, &series.grip_n));

    let start = series.slid_mm[shown.start];
    let since = |values: &[f64]| values.iter().map(|mm| mm - start).collect::<Vec<f64>>();
    let (with, without) = (since(&series.slid_mm), since(&series.slid_without_mm));
    let range = 0.0..most(&without).max(most(&with)).clamp(0.5, LOST_MM) * 1.1;
    let slid = panel(&mut canvas, "Distance slid", "mm; dashed: without any reaction", range);
    canvas.add(trace(&slid, GREY, &without).set("stroke-dasharray", "5 4"));
    canvas.add(trace(&slid, CLASS[2], &with).set("stroke-width", 2.0));

    let lead = most(&series.log_odds_nat.iter().map(|v| v.abs()).collect::<Vec<f64>>()).max(1.0) * 1.1;
    let unit = "log-odds of slip, nat; one dot per frame, orange where the flag is up";
    let scale = panel(&mut canvas, "Network", unit, -lead..lead);
    for frame in shown.clone() {
        let (colour, radius) = if series.flag[frame] { (CLASS[2], 2.6) } else { (NEUTRAL, 1.6) };
        let (cx, cy) = (x.at(ms(frame as f64 + 1.0)), scale.clamp(series.log_odds_nat[frame]));
        canvas.add(Circle::new().set("cx", cx).set("cy", cy).set("r", radius).set("fill", colour));
    }

    let bottom = top - 46.0;
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
        let (at, y) = (x.clamp(at), 58.0 + 11.0 * row as f64);
        canvas.add(rule(at, y + 2.0, at, bottom, colour).set("stroke-dasharray", "3 3"));
        canvas.text(at + 4.0, y + 6.0, Anchor::Start, 11.0, colour, &name);
    }
    for at in series.commands_s.iter().map(|&command_s| to_ms(command_s)) {
        if ms(shown.start as f64) <= at && at <= ms(shown.end as f64) {
            canvas.add(rect(x.at(at) - 1.0, 200.0, 2.0, 8.0, CLASS[1]));
        }
    }
    let note = "Milliseconds since the slip of the whole contact. Blue ticks below the grip: a command has reached the \
                gripper.";
    canvas.text(LEFT, bottom + 44.0, Anchor::Start, 12.0, GREY, note);
    canvas.axis(&x, bottom);
    canvas.page(WIDTH, bottom + 58.0, headline)
}

const PANEL: f64 = 110.0;

fn titled(title: &str, headline: &str) -> Canvas {
    let mut canvas = Canvas::new();
    canvas.add(bold(text(LEFT, 26.0, Anchor::Start, 16.0, INK, title)));
    canvas.text(LEFT, 46.0, Anchor::Start, 12.0, GREY, headline);
    canvas
}

/// Histograms: from slip to the flag's tick, and from there to the largest grip.
pub fn latencies(results: &[TrialResult], totals: &Totals, headline: &str) -> String {
    let title = format!(
        "{} of {} slips detected, {} of {} objects kept, {} without any reaction",
        totals.detected, totals.slips, totals.kept, totals.trials, totals.kept_without
    );
    let mut canvas = titled(&title, headline);
    let delays: Vec<f64> = results.iter().filter_map(|result| result.delay_ms).collect();
    let since_flag = |of: fn(&TrialResult) -> Option<f64>| -> Vec<f64> {
        results.iter().filter_map(of).map(|s| s * 1e3).collect()
    };
    let firsts = since_flag(|result| result.outcome.first_s);
    let peaks = since_flag(|result| result.outcome.peak_s);
    let mut y = 92.0;
    for (name, unit, values, bin_ms, colour) in [
        (
            "From slip to the flag",
            "ms to the tick of the frame with the flag, bins of two frames",
            delays,
            2e3 * FRAME_S,
            CLASS[2],
        ),
        ("From the flag's tick to the force of the first motion", "ms, bins of 5 ms", firsts, 5.0, CLASS[1]),
        ("From the flag's tick to the largest grip, all motions", "ms, bins of 10 ms", peaks, 10.0, CLASS[1]),
    ] {
        canvas.add(heading(LEFT, y - 8.0, name, unit));
        histogram(&mut canvas, y, &values, bin_ms, colour);
        y += 206.0;
    }
    canvas.page(WIDTH, y - 30.0, &title)
}

/// Values outside are counted in the first or last bin.
const SHOWN_MS: Range<f64> = -200.0..500.0;

fn histogram(canvas: &mut Canvas, y: f64, values: &[f64], bin_ms: f64, colour: &'static str) {
    const HEIGHT: f64 = 120.0;
    let ends = ((SHOWN_MS.start / bin_ms).floor() as i64, (SHOWN_MS.end / bin_ms).ceil() as i64 - 1);
    let bin = |ms: f64| ((ms / bin_ms).floor() as i64).clamp(ends.0, ends.1);
    let first = values.iter().map(|&ms| bin(ms)).min().unwrap_or(0).min(0);
    let last = values.iter().map(|&ms| bin(ms)).max().unwrap_or(0).max((100.0 / bin_ms) as i64);
    let count = |of: i64| values.iter().filter(|&&ms| bin(ms) == of).count();
    // At least 4, so that the grid's lines are whole numbers.
    let most = (first..=last).map(count).max().unwrap_or(0).max(4);
    let x = Scale::new(first as f64 * bin_ms..(last + 1) as f64 * bin_ms, LEFT..RIGHT);
    let scale = Scale::new(0.0..most as f64 * 1.1, y + HEIGHT..y);
    canvas.grid(LEFT, RIGHT, y + HEIGHT, HEIGHT, Some(&scale));
    for of in first..=last {
        let (from, to) = (x.at(of as f64 * bin_ms), x.at((of + 1) as f64 * bin_ms));
        let top = scale.at(count(of) as f64);
        canvas.add(rect(from + 0.5, top, to - from - 1.0, y + HEIGHT - top, colour));
    }
    let beyond = values.iter().filter(|ms| !SHOWN_MS.contains(ms)).count();
    if beyond > 0 {
        let note = format!("{} beyond, counted at the ends", counted(beyond, "trial"));
        canvas.text(RIGHT, y + 8.0, Anchor::End, 11.0, GREY, &note);
    }
    canvas.axis(&x, y + HEIGHT);
}
