//! What truly happened in an episode: two truths about slip, and what else happened.
//!
//! The *encoder truth* is the label: the crosshead has moved by more than 0.07 mm (the paper's rule). The
//! *interface truth* is what a simulator knows and a rig does not: the contact as a whole slides. Pad,
//! finger and fixture give way before that, so the label starts earlier, at slow speeds by many frames.

use anyhow::{Result, anyhow, bail};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use slipsense::params::FRAME_RATE_HZ;
use slipsense_recording::score::{Interval, SLIP, runs};
use slipsense_recording::{Episode, Meta};
use slipsense_synth::SlipDirection;
use slipsense_synth::labels::{mostly_sliding, sustained_sliding};

/// The contact slides where the slip speed is above this, mm/s.
pub(crate) const SLIDING_MM_S: f32 = slipsense_synth::labels::SLIPPING_MM_S as f32;
/// ... and where this share of the load slips.
pub(crate) const SLIDING_FRACTION: f32 = slipsense_synth::labels::SLIPPING_SHARE as f32;
/// The sliding of a labelled event may begin this many frames before its label: 250 ms.
const BEFORE_LABEL_FRAMES: usize = FRAME_RATE_HZ as usize / 4;

/// Classes of disturbances by precedence: where several are active, a frame belongs to the first of this list.
/// Short impacts come before what lasts long, and what touches the object before what does not.
pub(crate) const DISTURBANCES: [&str; 16] = [
    "tap",
    "set_down",
    "lift",
    "drag",
    "rolling",
    "jaw",
    "close",
    "open",
    "grip_change",
    "pull",
    "move",
    "motion",
    "electrical",
    "ambient",
    "other",
    "none",
];
/// Index of the class of names that the list lacks.
const OTHER: u8 = 14;
/// Index of the class of frames without any.
const NONE: u8 = 15;
/// A disturbance counts as active up to this many frames after its end, as a structure rings on and windows
/// remember: 150 ms.
const LOOK_BACK_FRAMES: usize = FRAME_RATE_HZ as usize * 150 / 1000;

/// What an episode's metadata says about it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EpisodeInfo {
    pub(crate) input: String,
    pub(crate) name: String,
    pub(crate) sensors: usize,
    pub(crate) object: Option<String>,
    pub(crate) object_kind: Option<String>,
    pub(crate) platform: Option<String>,
    pub(crate) scenario: Option<String>,
    /// Direction of its slips over the pad; none where the metadata does not give one, as on a rig, which has
    /// only one.
    pub(crate) slip_direction: Option<SlipDirection>,
    /// Where on the finger the object lies.
    pub(crate) region: Option<String>,
    /// Speed of the pull, mm/s; none where nothing pulls.
    pub(crate) speed_mm_s: Option<f64>,
    pub(crate) grip_n: Option<f64>,
    /// A generator made it.
    pub(crate) synthetic: bool,
}

/// A key of the metadata, or none if it is not there; `episode` names the episode in an error.
fn meta_value<T: DeserializeOwned>(meta: &Meta, key: &str, episode: &str) -> Result<Option<T>> {
    let value = meta.other.get(key).cloned();
    let parsed = value.map(|value| {
        serde_json::from_value(value).map_err(|e| anyhow!("{episode}: `meta` key `{key}`: {e}"))
    });
    parsed.transpose()
}

impl EpisodeInfo {
    fn new(meta: &Meta, sensors: usize, input: &str, name: &str) -> Result<Self> {
        let text = |key: &str| meta.other.get(key).and_then(Value::as_str).map(str::to_owned);
        let number = |key: &str| meta.other.get(key).and_then(Value::as_f64);
        let flag = meta.other.get("synthetic").and_then(Value::as_bool).unwrap_or(false);
        Ok(Self {
            input: input.to_owned(),
            name: name.to_owned(),
            sensors,
            object: text("object"),
            object_kind: text("object_kind"),
            platform: text("platform"),
            scenario: text("scenario"),
            slip_direction: meta_value(meta, "slip_direction", &format!("{input}/{name}"))?.flatten(),
            region: text("region"),
            speed_mm_s: number("speed_mm_s"),
            grip_n: number("grip_n"),
            synthetic: flag || text("source").is_some_and(|source| source.contains("synthetic")),
        })
    }
}

/// One episode's truth: all that the metrics need of it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    pub(crate) info: EpisodeInfo,
    /// 0 no contact, 1 contact without slip, 2 slip, one per frame.
    pub(crate) label: Vec<u8>,
    /// Slip by the labels, in order of time.
    pub(crate) slip: Vec<Interval>,
    /// Slip of the interface; none where the episode does not hold it.
    pub(crate) interface: Option<Interface>,
    /// Crosshead displacement, mm, one per frame.
    pub(crate) displacement_mm: Option<Vec<f32>>,
    /// Disturbance of each frame: index into [`DISTURBANCES`].
    pub(crate) disturbance: Vec<u8>,
    /// Intervals of the disturbances, as in the metadata.
    pub(crate) events: Vec<Disturbance>,
}

/// The sliding of the contact.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Interface {
    /// Sustained sliding, in order of time.
    pub(crate) slip: Vec<Interval>,
    /// Frames in which most of the contact slides, sustained sliding or not: a twisted object slides around a centre that
    /// still sticks, and not all of the contact stops at once.
    pub(crate) mostly_sliding: Vec<Interval>,
    /// Sliding that belongs to each labelled event, index into `slip`: the first that begins between
    /// 250 ms before the label and its end. None where the contact never slid as a whole.
    pub(crate) of_label: Vec<Option<usize>>,
    /// Length slid since the episode began, mm, up to and with each frame.
    pub(crate) slid_mm: Vec<f32>,
}

/// Something other than slip that a detector may take for it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Disturbance {
    /// Class, such as `tap`.
    pub(crate) name: String,
    pub(crate) start_s: f64,
    pub(crate) end_s: f64,
}

impl Truth {
    pub fn new(episode: &Episode, input: &str, name: &str) -> Result<Self> {
        let Some(label) = &episode.label else {
            bail!("{input}/{name}: array `label` is missing, an evaluation needs it");
        };
        let labelled = Self::from_labels(label.clone());
        let interface = match (&episode.slip_true_mm_s, &episode.slip_fraction) {
            (Some(speed), Some(fraction)) => Some(Interface::new(speed, fraction, &labelled.slip)),
            _ => None,
        };
        let events: Option<Vec<Disturbance>> =
            meta_value(&episode.meta, "events", &format!("{input}/{name}"))?;
        let events = events.unwrap_or_default();
        Ok(Self {
            info: EpisodeInfo::new(&episode.meta, episode.sensors, input, name)?,
            interface,
            displacement_mm: episode.displacement_mm.clone(),
            disturbance: disturbance_classes(&events, label.len()),
            events,
            ..labelled
        })
    }

    pub fn from_labels(label: Vec<u8>) -> Self {
        let slip = runs(label.len(), |f| label[f] == SLIP);
        Self { slip, disturbance: vec![NONE; label.len()], label, ..Self::default() }
    }

    pub(crate) fn frames(&self) -> usize {
        self.label.len()
    }

    /// Slip by the labels, and where most of the contact slides.
    pub(crate) fn slip_or_mostly_sliding(&self) -> Vec<Interval> {
        let mostly = self.interface.iter().flat_map(|interface| &interface.mostly_sliding);
        let mut slides = vec![false; self.frames()];
        self.slip.iter().chain(mostly).for_each(|&(start, end)| slides[start..end].fill(true));
        runs(slides.len(), |f| slides[f])
    }
}

impl Interface {
    fn new(speed_mm_s: &[f32], fraction: &[f32], labelled: &[Interval]) -> Self {
        let (slip, _) = sustained_sliding(speed_mm_s, fraction);
        let belongs = |&(onset, end): &Interval| {
            let from = onset.saturating_sub(BEFORE_LABEL_FRAMES);
            slip.iter().position(|&(start, _)| (from..end).contains(&start))
        };
        let of_label = labelled.iter().map(belongs).collect();
        let slid_mm = speed_mm_s.iter().scan(0.0, |slid, &speed| {
            *slid += f64::from(speed) / f64::from(FRAME_RATE_HZ);
            Some(*slid as f32)
        });
        let slid_mm = slid_mm.collect();
        Self { slip, mostly_sliding: mostly_sliding(speed_mm_s, fraction), of_label, slid_mm }
    }
}

/// The class of each frame: of the disturbances active between 150 ms before it and itself.
fn disturbance_classes(events: &[Disturbance], frames: usize) -> Vec<u8> {
    let mut classes = vec![NONE; frames];
    for event in events {
        let known = DISTURBANCES[..OTHER as usize].iter().position(|&name| name == event.name);
        let class = known.map_or(OTHER, |class| class as u8);
        let frame = |s: f64| (s.max(0.0) * f64::from(FRAME_RATE_HZ)) as usize;
        let start = frame(event.start_s).min(frames);
        let end = (frame(event.end_s) + LOOK_BACK_FRAMES + 1).clamp(start, frames);
        for of_frame in &mut classes[start..end] {
            *of_frame = class.min(*of_frame);
        }
    }
    classes
}

#[cfg(test)]
mod tests {
    use super::*;

    fn event(name: &str, start_s: f64, end_s: f64) -> Disturbance {
        Disturbance { name: name.to_owned(), start_s, end_s }
    }

    #[test]
    fn most_of_the_contact_slides_before_and_after_a_slip() {
        let label = [1, 1, 1, 2, 2, 1, 1, 1];
        let slipping = [0.0, 0.09, 0.2, 0.2, 0.2, 0.2, 0.2, 0.0];
        let share = [0.9, 0.9, 0.51, 0.96, 0.96, 0.9, 0.5, 0.9];
        let truth = Truth::from_labels(label.to_vec());
        assert_eq!(truth.slip_or_mostly_sliding(), [(3, 5)]);
        let interface = Some(Interface::new(&slipping, &share, &truth.slip));
        assert_eq!(Truth { interface, ..truth }.slip_or_mostly_sliding(), [(2, 6)]);
    }

    #[test]
    fn a_frame_belongs_to_the_first_class_active_in_the_150_ms_before_it() {
        let (tap, long) = (event("tap", 1.0, 1.1), event("move", 0.0, 2.0));
        let (unknown, none) = (event("earthquake", 1.9, 9.0), Vec::new());
        for (events, frame, class) in [
            (vec![tap.clone()], 239, "none"),
            (vec![tap.clone()], 240, "tap"),
            (vec![tap.clone()], 264 + 36, "tap"),
            (vec![tap.clone()], 264 + 37, "none"),
            (vec![long.clone(), tap.clone()], 250, "tap"),
            (vec![tap, long.clone()], 250, "tap"),
            (vec![long], 100, "move"),
            (vec![unknown], 479, "other"),
            (none, 0, "none"),
        ] {
            let classes = disturbance_classes(&events, 480);
            assert_eq!(DISTURBANCES[usize::from(classes[frame])], class, "{events:?} at {frame}");
        }
        assert!(DISTURBANCES.iter().enumerate().all(|(i, name)| !DISTURBANCES[..i].contains(name)));
    }
}
