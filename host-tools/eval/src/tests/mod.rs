//! Tests that need several parts of the crate: hand-made episodes with known answers, and generated ones.

#![expect(clippy::single_range_in_vec_init, reason = "a list of intervals may have one")]

mod events;
mod alarms;
mod frames;
mod operating;
mod intervals;
mod results;
mod goals;
mod baselines;
mod detectors;
mod hardness;

use std::ops::Range;

use serde_json::Value;
use slipsense::params::{TAXELS, XL_RATE_HZ};
use slipsense::sensor::PiezoFrame;
use slipsense_recording::{Episode, Meta};

use crate::detector::{Detector, Prediction};
use crate::metrics::figures::{EpisodeRecord, Figures};
use crate::run::Candidate;
use crate::truth::Truth;

/// An episode of one sensor with contact throughout that slips in the given frames by the label.
fn episode(frames: usize, slip: &[Range<usize>]) -> Episode {
    let mut counts = [0; TAXELS];
    counts[500] = 2000;
    let per_frame = XL_RATE_HZ as usize / 240;
    Episode {
        sensors: 1,
        piezo: vec![PiezoFrame::from_scan(counts); frames],
        xl: vec![vec![Default::default(); frames * per_frame]],
        xl_end: (1..=frames).map(|f| (f * per_frame) as u32).collect(),
        label: Some(class(frames, slip)),
        meta: Meta::nominal(0.000488),
        ..Episode::default()
    }
}

/// The same with sliding of the interface at this speed in other frames.
fn sliding(mut episode: Episode, slides: &[Range<usize>], mm_s: f32) -> Episode {
    let mut speed = vec![0.0; episode.frames()];
    let mut fraction = vec![0.2; episode.frames()];
    for range in slides {
        speed[range.clone()].fill(mm_s);
        fraction[range.clone()].fill(1.0);
    }
    (episode.slip_true_mm_s, episode.slip_fraction) = (Some(speed), Some(fraction));
    episode
}

fn with(mut episode: Episode, key: &str, value: Value) -> Episode {
    episode.meta.other.insert(key.to_owned(), value);
    episode
}

fn truth(episode: &Episode) -> Truth {
    Truth::new(episode, "input", "episode").unwrap()
}

fn class(frames: usize, flags: &[Range<usize>]) -> Vec<u8> {
    let mut class = vec![1; frames];
    flags.iter().for_each(|range| class[range.clone()].fill(2));
    class
}

/// What becomes of an episode with slip predicted in the given frames.
fn record(episode: &Episode, flags: &[Range<usize>]) -> EpisodeRecord {
    EpisodeRecord::new(&truth(episode), &class(episode.frames(), flags))
}

fn figures(episode: &Episode, flags: &[Range<usize>]) -> Figures {
    Figures::new([&record(episode, flags)])
}

/// Slip in the given frames of every episode, else contact.
fn flags_in(flags: Range<usize>) -> Detector<'static> {
    Box::new(move |episode| {
        let frames = episode.frames();
        let score = (0..frames).map(|f| if flags.contains(&f) { 1.0 } else { 0.0 }).collect();
        Ok(Prediction::new(score, 0.5, vec![1; frames]))
    })
}

fn candidate<'a>(
    name: &str,
    family: &str,
    make: impl Fn() -> anyhow::Result<Detector<'a>> + Sync + 'a,
) -> Candidate<'a> {
    Candidate { name: name.to_owned(), family: family.to_owned(), make: Box::new(make) }
}

fn collect_nulls(value: &Value, key: &str, nulls: &mut Vec<String>) {
    match value {
        Value::Null => nulls.push(key.to_owned()),
        Value::Array(values) => values.iter().for_each(|value| collect_nulls(value, key, nulls)),
        Value::Object(map) => map.iter().for_each(|(key, value)| collect_nulls(value, key, nulls)),
        _ => {}
    }
}

/// Every null has its reason.
fn check_nulls(results: &crate::results::Results) -> Vec<String> {
    let mut nulls = Vec::new();
    collect_nulls(&serde_json::to_value(results).unwrap(), "", &mut nulls);
    for key in &nulls {
        assert!(crate::results::NULL_REASONS.iter().any(|(start, _)| key.starts_with(start)), "{key}");
    }
    nulls
}
