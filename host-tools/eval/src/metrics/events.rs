//! Event by event: when a slip was flagged, against both truths.
//!
//! Hits, early events and misses are those of [`slipsense_recording::score`]. Latencies are those of the hits and, at
//! infinity, the misses: median, percentiles and shares count both, and no early event. They contain no computing time.
//!
//! Against the interface truth, the onset is that of the sliding that belongs to the labelled event, and
//! the end is the label's. Labelled events in which the contact never slid are counted apart.
//!
//! *From onset* ignores flags before the onset and takes the first frame flagged at or after it, so a flag
//! that stays up counts as latency 0: probably how the paper counts. *With transition* asks in addition
//! that the flag was down in the frame before the onset.

use serde::Serialize;
use slipsense_recording::score::{Detection, EventScore, Interval, score_intervals};

use super::statistics::{median, percentile, share, share_interval};
use crate::truth::Truth;

/// "Within 5 frames" (20.8 ms): the paper's mark.
pub(crate) const WITHIN_FRAMES: usize = 5;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Outcome {
    /// First frame of the event, frame after it, and its detection.
    pub(crate) event: EventScore,
    /// Frames from the onset to the first flagged frame at or after it; none if there is none.
    pub(crate) from_onset: Option<usize>,
    /// The flag was up in the frame before the onset.
    pub(crate) was_up: bool,
    /// Millimetres between onset and detection of a hit: of the crosshead (encoder truth), or slid by the
    /// interface (interface truth). None for other events and where the episode does not know.
    pub(crate) travel_mm: Option<f64>,
}

/// The events of one episode, against both truths.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Outcomes {
    /// One per labelled event.
    pub(crate) encoder: Vec<Outcome>,
    /// One per labelled event in which the contact slid; none where the episode lacks the interface truth.
    pub(crate) interface: Vec<Outcome>,
}

impl Outcomes {
    /// Match `flag` (non-zero where slip is predicted) with the events of an episode.
    pub(crate) fn new(truth: &Truth, flag: &[u8]) -> Self {
        let crosshead = truth.displacement_mm.as_deref();
        let encoder = outcomes(&truth.slip, flag, crosshead);
        let Some(interface) = &truth.interface else {
            return Self { encoder, interface: Vec::new() };
        };
        let mut windows: Vec<Interval> = Vec::new();
        for (&(_, end), sliding) in truth.slip.iter().zip(&interface.of_label) {
            if let Some(sliding) = *sliding {
                // The sliding may have begun within the label before.
                let previous_end = windows.last().map_or(0, |last| last.1);
                windows.push((interface.slip[sliding].0.max(previous_end), end));
            }
        }
        Self { encoder, interface: outcomes(&windows, flag, Some(&interface.slid_mm)) }
    }
}

fn outcomes(intervals: &[Interval], flag: &[u8], position_mm: Option<&[f32]>) -> Vec<Outcome> {
    let outcome = |event: EventScore| {
        let EventScore { onset, end, detection } = event;
        let travel_mm = match (detection, position_mm) {
            (Detection::Hit { delay }, Some(mm)) => Some(f64::from((mm[onset + delay] - mm[onset]).abs())),
            _ => None,
        };
        Outcome {
            event,
            from_onset: (onset..end).position(|f| flag[f] != 0),
            was_up: onset > 0 && flag[onset - 1] != 0,
            travel_mm,
        }
    };
    score_intervals(intervals, flag).events.into_iter().map(outcome).collect()
}

/// Figures of any number of events; null where infinite or without events.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct EventFigures {
    pub(crate) events: usize,
    pub(crate) hits: usize,
    pub(crate) early: usize,
    pub(crate) missed: usize,
    pub(crate) early_share: Option<f64>,
    pub(crate) miss_share: Option<f64>,
    /// Exact 95 % interval, as if events were independent.
    pub(crate) miss_share_interval: Option<[f64; 2]>,
    /// Hits within 5 frames, of hits and misses.
    pub(crate) within_5_frames_share: Option<f64>,
    /// Exact 95 % interval, as if events were independent.
    pub(crate) within_5_frames_share_interval: Option<[f64; 2]>,
    pub(crate) latency_median_frames: Option<f64>,
    /// 76 % is the paper's share within 5 frames.
    pub(crate) latency_p76_frames: Option<f64>,
    pub(crate) latency_p90_frames: Option<f64>,
    pub(crate) latency_p95_frames: Option<f64>,
    pub(crate) latency_max_of_hits_frames: Option<f64>,
    /// Mean latency of the hits; misses cannot count here.
    pub(crate) latency_mean_of_hits_frames: Option<f64>,
    /// Median from the onset to the first flagged frame, flags before it ignored.
    pub(crate) from_onset_median_frames: Option<f64>,
    /// Events whose onset frame is flagged, of all.
    pub(crate) at_onset_share: Option<f64>,
    /// ... and the frame before is not.
    pub(crate) at_onset_with_transition_share: Option<f64>,
    /// Flagged early or up to 5 frames after the onset, of all events.
    pub(crate) early_or_within_5_frames_share: Option<f64>,
    /// Flagged early or in the onset frame, of all events.
    pub(crate) early_or_at_onset_share: Option<f64>,
    /// Median travel at detection, misses at infinity.
    pub(crate) travel_median_mm: Option<f64>,
    pub(crate) travel_p90_mm: Option<f64>,
    pub(crate) travel_max_of_hits_mm: Option<f64>,
}

/// Latencies of hits and misses (infinite), sorted.
pub(crate) fn latencies<'a>(outcomes: impl IntoIterator<Item = &'a Outcome>) -> Vec<f64> {
    let latency = |outcome: &Outcome| match outcome.event.detection {
        Detection::Hit { delay } => Some(delay as f64),
        Detection::Missed => Some(f64::INFINITY),
        Detection::Early { .. } => None,
    };
    let mut latencies: Vec<f64> = outcomes.into_iter().filter_map(latency).collect();
    latencies.sort_by(f64::total_cmp);
    latencies
}

impl EventFigures {
    pub(crate) fn new(outcomes: &[&Outcome]) -> Self {
        let latency = latencies(outcomes.iter().copied());
        let events = outcomes.len();
        let hits = latency.iter().filter(|frames| frames.is_finite()).count();
        let missed = latency.len() - hits;
        let early = events - latency.len();
        let within = latency.iter().filter(|&&frames| frames <= WITHIN_FRAMES as f64).count();
        let at_once = latency.iter().filter(|&&frames| frames == 0.0).count();
        let mut from_onset: Vec<f64> =
            outcomes.iter().map(|o| o.from_onset.map_or(f64::INFINITY, |frames| frames as f64)).collect();
        from_onset.sort_by(f64::total_cmp);
        let of_events = |is: fn(&Outcome) -> bool| share(outcomes.iter().filter(|o| is(o)).count(), events);
        let mut travel: Vec<f64> = outcomes.iter().filter_map(|outcome| outcome.travel_mm).collect();
        travel.sort_by(f64::total_cmp);
        let hits_with_travel = travel.len();
        // Misses count only where hits have a travel at all.
        if hits == hits_with_travel {
            travel.resize(hits + missed, f64::INFINITY);
        }
        Self {
            events,
            hits,
            early,
            missed,
            early_share: share(early, events),
            miss_share: share(missed, events),
            miss_share_interval: share_interval(missed as u64, events as u64),
            within_5_frames_share: share(within, latency.len()),
            within_5_frames_share_interval: share_interval(within as u64, latency.len() as u64),
            latency_median_frames: median(&latency),
            latency_p76_frames: percentile(&latency, 0.76),
            latency_p90_frames: percentile(&latency, 0.90),
            latency_p95_frames: percentile(&latency, 0.95),
            latency_max_of_hits_frames: hits.checked_sub(1).map(|last| latency[last]),
            latency_mean_of_hits_frames: (hits > 0)
                .then(|| latency[..hits].iter().sum::<f64>() / hits as f64),
            from_onset_median_frames: median(&from_onset),
            at_onset_share: of_events(|o| o.from_onset == Some(0)),
            at_onset_with_transition_share: of_events(|o| o.from_onset == Some(0) && !o.was_up),
            early_or_within_5_frames_share: share(early + within, events),
            early_or_at_onset_share: share(early + at_once, events),
            travel_median_mm: median(&travel),
            travel_p90_mm: percentile(&travel, 0.90),
            travel_max_of_hits_mm: hits_with_travel.checked_sub(1).map(|last| travel[last]),
        }
    }
}

/// Shares of hits and misses that are flagged within `frames[i]` frames of the onset. Misses keep the
/// shares below 1; early events are not among them.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Cdf {
    /// Hits and misses.
    pub(crate) events: usize,
    /// Latencies at which the share changes, and 0.
    pub(crate) latency_at_most_frames: Vec<u32>,
    /// Share of the events at each; empty without events.
    pub(crate) events_share: Vec<f64>,
}

impl Cdf {
    pub(crate) fn new<'a>(outcomes: impl IntoIterator<Item = &'a Outcome>) -> Self {
        let latencies = latencies(outcomes);
        let mut cdf = Self { events: latencies.len(), ..Self::default() };
        let mut push = |frames: f64, events: usize| {
            cdf.latency_at_most_frames.push(frames as u32);
            cdf.events_share.push(events as f64 / latencies.len() as f64);
        };
        if latencies.first().is_some_and(|&frames| frames > 0.0) {
            push(0.0, 0);
        }
        let mut events = 0;
        for equal in latencies.chunk_by(|a, b| a == b).filter(|equal| equal[0].is_finite()) {
            events += equal.len();
            push(equal[0], events);
        }
        cdf
    }
}
