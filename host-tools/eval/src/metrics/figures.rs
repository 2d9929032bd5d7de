//! One episode's predictions reduced to what adds up, and the figures of many episodes.

use serde::Serialize;
use slipsense_recording::score::{Detection, SLIP};

use super::alarms::{AlarmCounts, AlarmFigures};
use super::events::{EventFigures, Outcome, Outcomes};
use super::frames::{FalseSlipFigures, FrameCounts, FrameFigures};
use super::statistics::share;
use crate::truth::Truth;

#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct EpisodeRecord {
    pub(crate) frames: FrameCounts,
    pub(crate) events: Outcomes,
    pub(crate) alarms: AlarmCounts,
}

impl EpisodeRecord {
    /// Score the classes of one episode's frames.
    ///
    /// # Panics
    /// If `class` is not as long as the episode.
    pub(crate) fn new(truth: &Truth, class: &[u8]) -> Self {
        let flag: Vec<u8> = class.iter().map(|&class| u8::from(class == SLIP)).collect();
        Self {
            frames: FrameCounts::new(truth, class),
            events: Outcomes::new(truth, &flag),
            alarms: AlarmCounts::new(truth, &flag),
        }
    }

    /// Missed events and false alarms.
    pub(crate) fn failures(&self) -> usize {
        let missed = |o: &&Outcome| o.event.detection == Detection::Missed;
        self.events.encoder.iter().filter(missed).count() + self.alarms.total() as usize
    }
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Figures {
    pub(crate) episodes: usize,
    pub(crate) frames: u64,
    pub(crate) frame: FrameFigures,
    pub(crate) false_slip: FalseSlipFigures,
    pub(crate) encoder_events: EventFigures,
    pub(crate) interface_events: EventFigures,
    /// Labelled events without sliding of the interface, which `interface_events` lacks.
    pub(crate) labelled_without_interface_slip: usize,
    /// ... as a share of the labelled events.
    pub(crate) labelled_without_interface_slip_share: Option<f64>,
    pub(crate) alarms: AlarmFigures,
}

impl Figures {
    pub(crate) fn new<'a>(records: impl IntoIterator<Item = &'a EpisodeRecord>) -> Self {
        let (mut frames, mut alarms) = (FrameCounts::default(), AlarmCounts::default());
        let (mut encoder, mut interface, mut episodes) = (Vec::new(), Vec::new(), 0);
        for record in records {
            frames.add(&record.frames);
            alarms.add(&record.alarms);
            encoder.extend(&record.events.encoder);
            interface.extend(&record.events.interface);
            episodes += 1;
        }
        let without = encoder.len() - interface.len();
        Self {
            episodes,
            frames: frames.all.frames(),
            frame: FrameFigures::new(&frames),
            false_slip: FalseSlipFigures::new(&frames),
            labelled_without_interface_slip_share: share(without, encoder.len()),
            encoder_events: EventFigures::new(&encoder),
            interface_events: EventFigures::new(&interface),
            labelled_without_interface_slip: without,
            alarms: AlarmFigures::new(&alarms),
        }
    }
}
