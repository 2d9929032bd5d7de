//! What truly happened in an episode: two truths about slip, and what else went on.
//!
//! The *encoder truth* is the label: the crosshead has moved by more than 0.07 mm (the paper's rule). The
//! *interface truth* is what a simulator knows and a rig does not: the contact as a whole slides. Pad,
//! finger and fixture give way before that, so the label starts earlier, at slow speeds by many frames.

use anyhow::{Result, anyhow, bail};
use serde::Serialize;
use serde_json::Value;
use slipsense::params::FRAME_RATE_HZ;
use slipsense_recording::score::{Interval, MARGIN_FRAMES, SLIP, runs};
use slipsense_recording::{Episode, Meta};
use slipsense_synth::SlipDirection;

use crate::disturbance::disturbances;

/// The contact slides where the slip speed is above this, mm/s.
pub const SLIDING_MM_S: f32 = slipsense_synth::labels::SLIPPING_MM_S as f32;
/// ... and where this share of the load slips.
pub const SLIDING_FRACTION: f32 = slipsense_synth::labels::SLIPPING_SHARE as f32;
/// Stretches of sliding closer than this are one: 50 ms, as stick-slip interrupts the sliding. What is
/// shorter than this in the end is not sustained and is no event.
pub const SUSTAINED_FRAMES: usize = MARGIN_FRAMES;
/// The sliding of a labelled event may begin this many frames before its label: 250 ms.
pub const BEFORE_LABEL_FRAMES: usize = FRAME_RATE_HZ as usize / 4;

/// What an episode's metadata says about it.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Facts {
    /// Name of the input that it came with.
    pub input: String,
    /// The episode's name.
    pub name: String,
    /// Sensors, 1 to 3.
    pub sensors: usize,
    /// Object gripped.
    pub object: Option<String>,
    /// Kind of object.
    pub object_kind: Option<String>,
    /// The hand.
    pub platform: Option<String>,
    /// Course of events.
    pub scenario: Option<String>,
    /// Way of its slips over the pad; none where the metadata do not say, as on a rig, which has one.
    pub slip_direction: Option<SlipDirection>,
    /// Where on the finger the object lies.
    pub region: Option<String>,
    /// Speed of the pull, mm/s; none where nothing pulls.
    pub speed_mm_s: Option<f64>,
    /// Base grip of one finger, N.
    pub grip_n: Option<f64>,
    /// Whether a generator made it.
    pub synthetic: bool,
}

impl Facts {
    fn new(meta: &Meta, sensors: usize, input: &str, name: &str) -> Result<Self> {
        let text = |key: &str| meta.other.get(key).and_then(Value::as_str).map(str::to_owned);
        let number = |key: &str| meta.other.get(key).and_then(Value::as_f64);
        let slip_direction = match meta.other.get("slip_direction") {
            None => None,
            Some(direction) => serde_json::from_value(direction.clone())
                .map_err(|error| anyhow!("{input}/{name}: `meta` key `slip_direction`: {error}"))?,
        };
        Ok(Self {
            input: input.to_owned(),
            name: name.to_owned(),
            sensors,
            object: text("object"),
            object_kind: text("object_kind"),
            platform: text("platform"),
            scenario: text("scenario"),
            slip_direction,
            region: text("region"),
            speed_mm_s: number("speed_mm_s"),
            grip_n: number("grip_n"),
            synthetic: is_synthetic(meta),
        })
    }
}

/// Whether an episode's metadata say that a generator made it.
pub(crate) fn is_synthetic(meta: &Meta) -> bool {
    let says = |value: Option<&Value>| value.and_then(Value::as_bool).unwrap_or(false);
    let source = meta.other.get("source").and_then(Value::as_str).unwrap_or_default();
    says(meta.other.get("synthetic")) || source.contains("synthetic")
}

/// One episode's truth: all that the metrics need of it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Truth {
    /// What the metadata says.
    pub facts: Facts,
    /// 0 no contact, 1 contact without slip, 2 slip, one per frame.
    pub label: Vec<u8>,
    /// Slip by the labels, in order of time.
    pub slip: Vec<Interval>,
    /// Slip of the interface, in order of time; none where the episode does not know.
    pub interface: Option<Interface>,
    /// Crosshead displacement, mm, one per frame.
    pub displacement_mm: Option<Vec<f32>>,
    /// What went on in each frame: index into [`crate::disturbance::CLASSES`].
    pub disturbance: Vec<u8>,
    /// Intervals of the disturbances, as in the metadata.
    pub events: Vec<Disturbance>,
}

/// The sliding of the contact.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Interface {
    /// Sustained sliding, in order of time.
    pub slip: Vec<Interval>,
    /// Sliding that belongs to each labelled event, index into `slip`: the first that begins between
    /// 250 ms before the label and its end. None where the contact never slid as a whole.
    pub of_label: Vec<Option<usize>>,
    /// Length slid since the episode began, mm, up to and with each frame.
    pub slid_mm: Vec<f32>,
}

/// Something other than slip that a detector may take for it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, serde::Deserialize)]
pub struct Disturbance {
    /// Class, such as `tap`.
    pub name: String,
    /// Start, s from the episode's begin.
    pub start_s: f64,
    /// End, s.
    pub end_s: f64,
}

impl Truth {
    /// Take the truth from an episode, which must have labels.
    pub fn new(episode: &Episode, input: &str, name: &str) -> Result<Self> {
        let Some(label) = &episode.label else {
            bail!("{input}/{name}: array `label` is missing, an evaluation needs it");
        };
        let frames = episode.frames();
        let slip = runs(frames, |f| label[f] == SLIP);
        let interface = match (&episode.slip_true_mm_s, &episode.slip_fraction) {
            (Some(speed), Some(fraction)) => Some(Interface::new(speed, fraction, &slip)),
            _ => None,
        };
        let events: Vec<Disturbance> = match episode.meta.other.get("events") {
            None => Vec::new(),
            Some(events) => serde_json::from_value(events.clone())
                .map_err(|error| anyhow!("{input}/{name}: `meta` key `events`: {error}"))?,
        };
        Ok(Self {
            facts: Facts::new(&episode.meta, episode.sensors, input, name)?,
            label: label.clone(),
            slip,
            interface,
            displacement_mm: episode.displacement_mm.clone(),
            disturbance: disturbances(&events, frames),
            events,
        })
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.label.len()
    }
}

impl Interface {
    fn new(speed_mm_s: &[f32], fraction: &[f32], labelled: &[Interval]) -> Self {
        let sliding = |f: usize| speed_mm_s[f] > SLIDING_MM_S && fraction[f] > SLIDING_FRACTION;
        let mut slip: Vec<Interval> = Vec::new();
        for (start, end) in runs(speed_mm_s.len(), sliding) {
            match slip.last_mut() {
                Some(last) if start - last.1 < SUSTAINED_FRAMES => last.1 = end,
                _ => slip.push((start, end)),
            }
        }
        slip.retain(|&(start, end)| end - start >= SUSTAINED_FRAMES);
        let belongs = |&(onset, end): &Interval| {
            let from = onset.saturating_sub(BEFORE_LABEL_FRAMES);
            slip.iter().position(|&(start, _)| (from..end).contains(&start))
        };
        let of_label = labelled.iter().map(belongs).collect();
        let mut slid = 0.0;
        let slid_mm = speed_mm_s
            .iter()
            .map(|&speed| {
                slid += f64::from(speed) / f64::from(FRAME_RATE_HZ);
                slid as f32
            })
            .collect();
        Self { slip, of_label, slid_mm }
    }
}
