//! One episode judged by one detector, reduced to what adds up; and the figures of many.

use serde::Serialize;
use slipsense_recording::score::SLIP;

use super::alarms::{AlarmCounts, AlarmFigures};
use super::events::{EventFigures, Outcome, Outcomes};
use super::false_slip::{FalseSlipCounts, FalseSlipFigures};
use super::frames::{FrameCounts, FrameFigures};
use super::statistics::share;
use crate::truth::Truth;

/// Counts and outcomes of one episode.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Record {
    /// Frames by truth and decision.
    pub frames: FrameCounts,
    /// Frames falsely called slip by where they lie.
    pub false_slip: FalseSlipCounts,
    /// What became of its events.
    pub events: Outcomes,
    /// False alarms and exposure.
    pub alarms: AlarmCounts,
}

impl Record {
    /// Score the classes of one episode's frames.
    ///
    /// # Panics
    /// If `class` is not as long as the episode.
    pub fn new(truth: &Truth, class: &[u8]) -> Self {
        let flag: Vec<u8> = class.iter().map(|&class| u8::from(class == SLIP)).collect();
        Self {
            frames: FrameCounts::new(truth, class),
            false_slip: FalseSlipCounts::new(truth, class),
            events: Outcomes::new(truth, &flag),
            alarms: AlarmCounts::new(truth, &flag),
        }
    }

    /// Missed events and false alarms: how bad it went.
    pub fn failures(&self) -> usize {
        let missed = |o: &&Outcome| o.event.detection == slipsense_recording::score::Detection::Missed;
        self.events.encoder.iter().filter(missed).count() + self.alarms.total() as usize
    }
}

/// All figures of a group of episodes.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Figures {
    /// Episodes.
    pub episodes: usize,
    /// Frames of 1/240 s.
    pub frames: u64,
    /// Frame by frame.
    pub frame: FrameFigures,
    /// The false positive rate by where the frames lie.
    pub false_slip: FalseSlipFigures,
    /// Events against the encoder truth.
    pub encoder_events: EventFigures,
    /// Events against the interface truth.
    pub interface_events: EventFigures,
    /// Labelled events without sliding of the interface, which `interface_events` lacks.
    pub labelled_without_interface_slip: usize,
    /// ... as a share of the labelled events.
    pub labelled_without_interface_slip_share: Option<f64>,
    /// False alarms.
    pub alarms: AlarmFigures,
}

impl Figures {
    /// Figures of these episodes together.
    pub fn new<'a>(records: impl IntoIterator<Item = &'a Record>) -> Self {
        let (mut frames, mut alarms) = (FrameCounts::default(), AlarmCounts::zero());
        let mut false_slip = FalseSlipCounts::default();
        let (mut encoder, mut interface, mut without, mut episodes) = (Vec::new(), Vec::new(), 0, 0);
        for record in records {
            frames.add(&record.frames);
            false_slip.add(&record.false_slip);
            alarms.add(&record.alarms);
            encoder.extend(&record.events.encoder);
            interface.extend(&record.events.interface);
            without += record.events.without_interface;
            episodes += 1;
        }
        Self {
            episodes,
            frames: frames.all.frames(),
            frame: FrameFigures::new(&frames),
            false_slip: FalseSlipFigures::new(&false_slip),
            labelled_without_interface_slip_share: share(without, encoder.len()),
            encoder_events: EventFigures::new(&encoder),
            interface_events: EventFigures::new(&interface),
            labelled_without_interface_slip: without,
            alarms: AlarmFigures::new(&alarms),
        }
    }
}
