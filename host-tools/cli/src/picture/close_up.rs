//! Onsets close up, frame by frame: at the timeline's scale a delay of a few frames cannot be seen.

use std::ops::Range;

use svg::node::element::{Circle, Group};

use super::Panels;
use super::draw::{Anchor, BASE, CLASS, Canvas, GREY, NEUTRAL, RULE, area, curve, heading, rect, rule};
use super::scale::{LEFT, RIGHT, Scale, line};
use crate::summary::EventInfo;

/// Frames shown before and after an onset: 75 ms and 175 ms.
const BEFORE: usize = 18;
const AFTER: usize = 42;
/// Most close-ups: those of the first events.
const MOST: usize = 3;
const SPACE: f64 = 34.0;
const HEIGHT: f64 = 104.0;

impl Panels<'_> {
    /// Add the close-ups at `y`; returns the bottom of the picture.
    pub(super) fn close_ups(&mut self, y: f64) -> f64 {
        let events = self.summary.truth.iter().flat_map(|truth| &truth.may_begin.events).take(MOST);
        let events: Vec<&EventInfo> = events.collect();
        if events.is_empty() {
            return y;
        }
        let count = events.len() as f64;
        let width = (RIGHT - LEFT - SPACE * (count - 1.0)) / count;
        for (i, event) in events.into_iter().enumerate() {
            let left = LEFT + i as f64 * (width + SPACE);
            let title = format!("Onset {}: {}", i + 1, event.words());
            let close_up = self.close_up(event, &title, left..left + width, y + 34.0);
            self.add(close_up.0);
        }
        let legend = "Line: slip logit minus no-slip logit, one dot per frame, orange where the flag is up.";
        let shade = if self.episode.slip_true_mm_s.is_some() { " Shade: true slip speed." } else { "" };
        let bottom = y + 34.0 + HEIGHT;
        self.canvas.text(LEFT, bottom + 42.0, Anchor::Start, 12.0, GREY, &format!("{legend}{shade}"));
        bottom + 60.0
    }

    fn close_up(&self, event: &EventInfo, title: &str, span: Range<f64>, y: f64) -> Canvas {
        let onset = event.onset_frame;
        let frames = onset.saturating_sub(BEFORE)..(onset + AFTER).min(self.episode.frames());
        let x = Scale::new(onset as f64 - BEFORE as f64..(onset + AFTER) as f64, span.clone());
        let bottom = y + HEIGHT;
        let (left, right) = (span.start, span.end);
        let mut group = Canvas(Group::new());
        group.add(heading(left, y - 10.0, title, ""));

        if let Some(speed) = &self.episode.slip_true_mm_s {
            let most = frames.clone().map(|f| speed[f]).fold(1.0, f32::max);
            let scale = Scale::new(0.0..f64::from(most) * 1.15, bottom..y);
            let points = line(frames.clone(), usize::MAX, |f| f64::from(speed[f]));
            let points: Vec<_> = points.iter().map(|&(f, v)| (x.at(f), scale.clamp(v))).collect();
            group.add(area(&points, bottom, "#fbe6d6"));
        }
        let lead = |f: usize| {
            // With contact given by the pads, the sign of this is the flag.
            let [_, hold, slip] = self.simulation.predictions.logits[f].map(f64::from);
            (slip - hold) / 1024.0
        };
        let most = frames.clone().map(|f| lead(f).abs()).fold(1.0, f64::max) * 1.1;
        let scale = Scale::new(-most..most, bottom..y);
        let zero = scale.at(0.0);
        group.add(rule(left, zero, right, zero, RULE));
        group.text(left - 6.0, zero + 4.0, Anchor::End, 11.0, GREY, "0");
        let at = |f: usize| (x.at(f as f64), scale.clamp(lead(f)));
        group.add(curve(frames.clone().map(at), NEUTRAL));
        for frame in frames.clone() {
            let (cx, cy) = at(frame);
            let flagged = self.simulation.predictions.may_begin[frame] != 0;
            let (colour, radius) = if flagged { (CLASS[2], 3.4) } else { (NEUTRAL, 2.2) };
            group.add(Circle::new().set("cx", cx).set("cy", cy).set("r", radius).set("fill", colour));
        }

        let start = x.at(onset as f64);
        group.add(rule(start, y, start, bottom, CLASS[2]).set("stroke-dasharray", "3 3"));
        if let Some(delay) = event.delay_frames {
            let flag = x.at((onset as i64 + delay) as f64);
            let (from, to) = (start.min(flag), start.max(flag));
            group.add(rule(flag, y, flag, bottom, CLASS[2]));
            group.add(rect(from, y, (to - from).max(1.0), 4.0, CLASS[2]));
        }
        group.add(rule(left, bottom, right, bottom, BASE));
        for ms in [-50, 0, 50, 100, 150] {
            let place = x.at(onset as f64 + f64::from(ms) * 0.24);
            let label = if ms == 0 { "onset".to_owned() } else { format!("{ms:+} ms") };
            group.add(rule(place, bottom, place, bottom + 5.0, GREY));
            group.text(place, bottom + 19.0, Anchor::Middle, 12.0, GREY, &label);
        }
        group
    }
}
