//! Slips by the way they go: the rig pulls one way only, so the others show whether a detector learnt slip or
//! the rig.
//!
//! A slip on the rig is labelled by the crosshead, one by hand by the interface. The onset of the crosshead
//! comes earlier, so only the latencies against the interface truth compare across the rows.

use serde::Serialize;
use slipsense_synth::SlipDirection;

use crate::grid::Grid;
use crate::metrics::events::{EventFigures, Outcome};
use crate::metrics::record::Record;
use crate::results::DetectorResults;
use crate::table::{latency, percent};
use crate::truth::{Facts, Truth};

/// What the slips of an episode have in common.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum DirectionClass {
    /// Pulled by the crosshead, along the pad.
    VerticalRig,
    /// Pulled the same way by hand: what a hand alone changes.
    VerticalHand,
    /// Pulled any other way in the pad's plane.
    OtherInPlane,
    /// Twisted about the pad's normal.
    Rotational,
}

impl DirectionClass {
    const ALL: [Self; 4] = [Self::VerticalRig, Self::VerticalHand, Self::OtherInPlane, Self::Rotational];

    /// Words for tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::VerticalRig => "vertical, rig",
            Self::VerticalHand => "vertical, by hand",
            Self::OtherInPlane => "other in plane",
            Self::Rotational => "rotational",
        }
    }

    /// The class of an episode's slips; none where its metadata do not say.
    pub fn of(facts: &Facts) -> Option<Self> {
        if facts.scenario.as_deref() == Some("six_step") {
            return Some(Self::VerticalRig);
        }
        Some(match facts.slip_direction? {
            SlipDirection::Vertical => Self::VerticalHand,
            SlipDirection::OtherInPlane => Self::OtherInPlane,
            SlipDirection::Rotational => Self::Rotational,
        })
    }
}

/// Slips of one direction in one input.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DirectionFigures {
    /// Direction.
    pub direction: DirectionClass,
    /// Input.
    pub input: String,
    /// Events that are not missed, of all: early ones or hits, against the label.
    pub detected_share: Option<f64>,
    /// The same against the interface truth, which only has sustained sliding.
    pub interface_detected_share: Option<f64>,
    /// Against the label.
    pub encoder_events: EventFigures,
    /// Against the interface truth.
    pub interface_events: EventFigures,
}

/// The figures of each direction in each input, directions first; empty where all slips are the rig's.
pub fn by_direction(episodes: &[(&Truth, &Record)]) -> Vec<DirectionFigures> {
    let classes: Vec<Option<DirectionClass>> =
        episodes.iter().map(|(truth, _)| DirectionClass::of(&truth.facts)).collect();
    if classes.iter().flatten().all(|class| *class == DirectionClass::VerticalRig) {
        return Vec::new();
    }
    let mut inputs: Vec<&str> = episodes.iter().map(|(truth, _)| truth.facts.input.as_str()).collect();
    inputs.dedup();
    let mut found = Vec::new();
    for direction in DirectionClass::ALL {
        for &input in &inputs {
            let of = |((truth, _), class): &(&(&Truth, &Record), &Option<DirectionClass>)| {
                **class == Some(direction) && truth.facts.input == input
            };
            let records: Vec<&Record> =
                episodes.iter().zip(&classes).filter(of).map(|((_, record), _)| *record).collect();
            let encoder: Vec<&Outcome> = records.iter().flat_map(|record| &record.events.encoder).collect();
            let interface: Vec<&Outcome> =
                records.iter().flat_map(|record| &record.events.interface).collect();
            if encoder.is_empty() {
                continue;
            }
            let (encoder_events, interface_events) =
                (EventFigures::new(&encoder), EventFigures::new(&interface));
            let detected = |events: &EventFigures| events.miss_share.map(|missed| 1.0 - missed);
            found.push(DirectionFigures {
                direction,
                input: input.to_owned(),
                detected_share: detected(&encoder_events),
                interface_detected_share: detected(&interface_events),
                encoder_events,
                interface_events,
            });
        }
    }
    found
}

/// The table for terminal and report; `kind` says what data it is.
pub(crate) fn grid(detectors: &[DetectorResults], kind: &str) -> Option<Grid> {
    let cells = |detector: &str, of: &DirectionFigures| {
        let (label, interface) = (&of.encoder_events, &of.interface_events);
        vec![
            detector.to_owned(),
            of.direction.name().to_owned(),
            of.input.clone(),
            label.events.to_string(),
            percent(of.detected_share),
            label.missed.to_string(),
            percent(label.early_share),
            latency(label.latency_median_frames, label.hits + label.missed),
            interface.events.to_string(),
            percent(of.interface_detected_share),
            percent(interface.early_share),
            latency(interface.latency_median_frames, interface.hits + interface.missed),
            latency(interface.from_onset_median_frames, interface.events),
        ]
    };
    let rows: Vec<Vec<String>> = detectors
        .iter()
        .flat_map(|detector| detector.directions.iter().map(|of| cells(&detector.name, of)))
        .collect();
    (!rows.is_empty()).then(|| Grid {
        title: format!("slips by direction ({kind})"),
        header: vec![
            "detector",
            "direction",
            "input",
            "slips",
            "detected %",
            "missed",
            "early %",
            "latency fr",
            "interface: slips",
            "detected %",
            "early %",
            "latency fr",
            "from onset fr",
        ],
        word_columns: 3,
        rows,
        note: "the rig's slips are labelled by its crosshead, those by hand by the interface, short jerks \
               included: what compares are the last columns, against sustained sliding of the interface"
            .to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn facts(scenario: &str, slip_direction: Option<SlipDirection>) -> Facts {
        Facts { scenario: Some(scenario.to_owned()), slip_direction, ..Facts::default() }
    }

    #[test]
    fn classes_follow_the_metadata() {
        use DirectionClass::*;
        let of = |scenario, direction| DirectionClass::of(&facts(scenario, direction));
        assert_eq!(of("six_step", None), Some(VerticalRig));
        assert_eq!(of("free_pull", Some(SlipDirection::Vertical)), Some(VerticalHand));
        assert_eq!(of("free_pull", Some(SlipDirection::OtherInPlane)), Some(OtherInPlane));
        assert_eq!(of("rotation", Some(SlipDirection::Rotational)), Some(Rotational));
        assert_eq!(of("free_grasp", None), None);
        assert_eq!(DirectionClass::of(&Facts::default()), None);
    }
}
