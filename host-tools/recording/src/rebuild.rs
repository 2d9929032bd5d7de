//! Raw messages of a recording back to an episode.

use std::collections::BTreeMap;
use std::ops::Range;

use crate::candump::LogEntry;
use crate::{Episode, Meta};
use anyhow::{Result, bail, ensure};
use serde_json::Value;
use slipsense::health;
use slipsense::wire::{NodeId, RawMessage, Received};

use crate::decode::{Decoded, Decoder, calibration};

/// An episode and, in words, what of the recording is not in it.
pub struct Rebuilt {
    /// The longest stretch in which every raw message of every sensor came.
    pub episode: Episode,
    /// Number of its first frame, as the module counted.
    pub first: u32,
    /// Microseconds of the recording at its first frame.
    pub start_us: u64,
    pub notes: Vec<String>,
}

/// Takes a recording entry by entry and rebuilds what one node recorded. It holds the raw messages, which the episode
/// has to hold anyway, and not the CAN frames.
#[derive(Default)]
pub struct Rebuilder {
    decoder: Decoder,
    /// By node and number of the frame.
    nodes: BTreeMap<u8, BTreeMap<u32, Messages>>,
    /// By which calibration each sensor's array was read, as a node said again and again: version and name, or `none`; one
    /// after the other where it changed.
    calibrations: BTreeMap<(u8, usize), Vec<String>>,
}

/// Raw messages of one frame and when the first came, microseconds.
struct Messages {
    timestamp_us: u64,
    parts: Vec<RawMessage>,
}

impl Rebuilder {
    pub fn new() -> Self {
        Self::default()
    }

    pub fn accept(&mut self, entry: &LogEntry) {
        let decoded = self.decoder.accept(&entry.frame);
        if let Some(Decoded { node, message: Received::Raw(message) }) = decoded {
            let frames = self.nodes.entry(node.get()).or_default();
            let new = || Messages { timestamp_us: entry.timestamp_us, parts: Vec::new() };
            frames.entry(message.sequence).or_insert_with(new).parts.push(message);
        }
        if let Some((node, sensor, calibration)) = calibration(&entry.frame) {
            let said = self.calibrations.entry((node.get(), sensor)).or_default();
            if said.last().is_none_or(|last| last != calibration) {
                said.push(calibration.to_owned());
            }
        }
    }

    /// The episode; `node` may be left open where only one speaks.
    pub fn episode(mut self, node: Option<NodeId>, xl_lsb_g: f64) -> Result<Rebuilt> {
        let node = match (node.map(NodeId::get), self.nodes.len()) {
            (Some(node), _) => node,
            (None, 1) => self.nodes.keys().next().copied().unwrap_or_default(),
            (None, 0) => bail!("no raw message in it: an episode cannot be rebuilt"),
            (None, _) => bail!("raw messages of nodes {:?}: say which one, --node-id N", self.nodes.keys()),
        };
        let Some(frames) = self.nodes.remove(&node) else { bail!("no raw message of node {node} in it") };
        let messages = || frames.values().flat_map(|frame| &frame.parts);
        let count = messages().count();
        let sensors = 1 + messages().map(|m| usize::from(m.sensor)).max().unwrap_or(0);
        let best = longest(&frames, sensors);
        ensure!(!best.is_empty(), "no frame of which all {sensors} sensors' raw messages came");

        let mut notes = Vec::new();
        let kept = best.len() * sensors;
        if kept < count {
            notes.push(format!(
                "{} of {count} raw messages are left out: others around them are missing, and an episode has no gaps",
                count - kept
            ));
        }
        let kept = frames.range(best.clone()).flat_map(|(_, frame)| &frame.parts);
        let missing = kept.filter(|m| m.health & (health::PIEZO_MISSING | health::XL_MISSING) != 0).count();
        if missing > 0 {
            notes.push(format!(
                "{missing} raw messages say that array or accelerometer was missing; an episode cannot"
            ));
        }
        notes.push(
            "decisions (class, logits, slip) are left out: `slipsense run` makes them again".to_owned(),
        );

        let start_us = frames[&best.start].timestamp_us;
        let kept = frames.into_iter().filter(|(sequence, _)| best.contains(sequence));
        let mut episode = assemble(kept.map(|(_, frame)| frame.parts), sensors, xl_lsb_g)?;
        let said = self.calibrations.into_iter().filter(|((from, _), _)| *from == node);
        let said = said.map(|((_, sensor), names)| (sensor.to_string(), Value::from(names.join(", then "))));
        let said: serde_json::Map<_, _> = said.collect();
        if !said.is_empty() {
            episode.meta.other.insert("calibration".to_owned(), said.into());
        }
        Ok(Rebuilt { episode, first: best.start, start_us, notes })
    }
}

/// Numbers of the longest stretch of frames that follow each other with all sensors.
fn longest(frames: &BTreeMap<u32, Messages>, sensors: usize) -> Range<u32> {
    let (mut best, mut run) = (0..0, 0..0);
    let mut before: Option<&[RawMessage]> = None;
    for (&sequence, Messages { parts, .. }) in frames {
        let whole = parts.len() == sensors && (0..sensors).all(|s| usize::from(parts[s].sensor) == s);
        if !before.is_some_and(|before| whole && continues(before, parts)) {
            run = sequence..sequence;
        }
        before = whole.then_some(parts);
        if whole {
            run.end = sequence.saturating_add(1);
        }
        if run.len() > best.len() {
            best = run.clone();
        }
    }
    best
}

/// Is this the next frame, with every sample since the last one?
fn continues(before: &[RawMessage], parts: &[RawMessage]) -> bool {
    before.iter().zip(parts).all(|(before, now)| {
        now.sequence == before.sequence.wrapping_add(1)
            && now.xl_dropped == 0
            && now.xl_end.wrapping_sub(now.xl.len() as u32) == before.xl_end
    })
}

fn assemble(frames: impl Iterator<Item = Vec<RawMessage>>, sensors: usize, xl_lsb_g: f64) -> Result<Episode> {
    let mut xl = vec![Vec::new(); sensors];
    let mut xl_end = Vec::new();
    let mut piezo = Vec::new();
    for parts in frames {
        for (message, xl) in parts.into_iter().zip(&mut xl) {
            piezo.push(message.piezo);
            xl.extend_from_slice(&message.xl);
            xl_end.push(u32::try_from(xl.len())?);
        }
    }
    // Sensors of different clocks: what is added lies beyond every `xl_end`.
    let longest = xl.iter().map(Vec::len).max().unwrap_or(0);
    xl.iter_mut().for_each(|xl| xl.resize(longest, [0; 3]));
    let mut meta = Meta::nominal(xl_lsb_g);
    meta.other.insert("source".to_owned(), "rebuilt from a recording of the bus".into());
    let episode = Episode { sensors, piezo, xl, xl_end, meta, ..Episode::default() };
    episode.validate()?;
    Ok(episode)
}
