//! Slips by their direction: does a detector know slip, or the rig, which pulls one way only? Training has pulls any way
//! and twists by hand as well, of other objects.
//!
//! A slip on the rig is labelled by the crosshead, one by hand by the interface. The onset of the crosshead
//! comes earlier, so only the latencies against the interface truth compare across the rows.

use serde::Serialize;
use slipsense_synth::SlipDirection;

use crate::metrics::events::{EventFigures, Outcome};
use crate::metrics::figures::EpisodeRecord;
use crate::truth::{EpisodeInfo, Truth};

/// What the slips of an episode have in common.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum DirectionClass {
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

    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::VerticalRig => "vertical, rig",
            Self::VerticalHand => "vertical, by hand",
            Self::OtherInPlane => "other in plane",
            Self::Rotational => "rotational",
        }
    }

    /// The class of an episode's slips; none where its metadata does not give it.
    pub(crate) fn from_info(info: &EpisodeInfo) -> Option<Self> {
        if info.scenario.as_deref() == Some("six_step") {
            return Some(Self::VerticalRig);
        }
        Some(match info.slip_direction? {
            SlipDirection::Vertical => Self::VerticalHand,
            SlipDirection::OtherInPlane => Self::OtherInPlane,
            SlipDirection::Rotational => Self::Rotational,
        })
    }
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct DirectionFigures {
    pub(crate) direction: DirectionClass,
    pub(crate) input: String,
    /// Events that are not missed, of all: early ones or hits, against the label.
    pub(crate) detected_share: Option<f64>,
    /// The same against the interface truth, which only has sustained sliding.
    pub(crate) interface_detected_share: Option<f64>,
    pub(crate) encoder_events: EventFigures,
    pub(crate) interface_events: EventFigures,
}

/// The figures of each direction in each input, directions first; empty where all slips are the rig's.
pub(crate) fn by_direction(episodes: &[(&Truth, &EpisodeRecord)]) -> Vec<DirectionFigures> {
    let class = |truth: &Truth| DirectionClass::from_info(&truth.info);
    if episodes.iter().filter_map(|(truth, _)| class(truth)).all(|of| of == DirectionClass::VerticalRig) {
        return Vec::new();
    }
    let mut inputs: Vec<&str> = episodes.iter().map(|(truth, _)| truth.info.input.as_str()).collect();
    inputs.dedup();
    let mut found = Vec::new();
    for direction in DirectionClass::ALL {
        for &input in &inputs {
            let here = |truth: &Truth| class(truth) == Some(direction) && truth.info.input == input;
            let chosen =
                || episodes.iter().filter(|(truth, _)| here(truth)).map(|(_, record)| &record.events);
            let encoder: Vec<&Outcome> = chosen().flat_map(|events| &events.encoder).collect();
            let interface: Vec<&Outcome> = chosen().flat_map(|events| &events.interface).collect();
            if encoder.is_empty() {
                continue;
            }
            let [encoder_events, interface_events] = [encoder, interface].map(|of| EventFigures::new(&of));
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
