//! The distribution of latencies: which share of the events is flagged within so many frames.

use serde::Serialize;

use super::events::{Outcome, latencies};

/// Shares of hits and misses that are flagged within `frames[i]` frames of the onset. Misses keep the
/// shares below 1; early events are not among them.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Cdf {
    /// Hits and misses.
    pub events: usize,
    /// Latencies at which the share changes, and 0.
    pub latency_at_most_frames: Vec<u32>,
    /// Share of the events at each; empty without events.
    pub events_share: Vec<f64>,
}

impl Cdf {
    /// The distribution of these events' latencies.
    pub fn new<'a>(outcomes: impl IntoIterator<Item = &'a Outcome>) -> Self {
        let latencies = latencies(outcomes);
        let mut cdf = Self { events: latencies.len(), ..Self::default() };
        let mut latest = None;
        for (i, &frames) in latencies.iter().enumerate() {
            if latest.is_none() && frames > 0.0 {
                cdf.latency_at_most_frames.push(0);
                cdf.events_share.push(0.0);
            }
            if !frames.is_finite() {
                break;
            }
            let share = (i + 1) as f64 / latencies.len() as f64;
            if latest == Some(frames) {
                cdf.events_share.pop();
                cdf.latency_at_most_frames.pop();
            }
            cdf.latency_at_most_frames.push(frames as u32);
            cdf.events_share.push(share);
            latest = Some(frames);
        }
        cdf
    }
}
