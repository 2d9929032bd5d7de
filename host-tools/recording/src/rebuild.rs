//! Raw messages of a recording back to an episode.

use std::collections::BTreeMap;
use std::ops::Range;

use crate::candump::LogEntry;
use crate::{Episode, Meta};
use anyhow::{Result, bail};
use serde_json::Value;
use slipsense::health;
use slipsense::wire::{NodeId, RawMessage, Received};

use crate::decode::{Decoded, Decoder, calibration};

/// An episode and, in words, what of the recording is not in it.
pub struct Rebuilt {
    /// The longest stretch in which every raw message of every sensor came, with all taxels.
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
    nodes: BTreeMap<u8, BTreeMap<Number, Messages>>,
    /// By which calibration each sensor's array was read, as a node said again and again: version and name, or `none`; one
    /// after the other where it changed.
    calibrations: BTreeMap<(u8, usize), Vec<String>>,
}

/// A start of the module, as the numbers of its frames show, and the number of the frame.
type Number = (u32, u32);

/// A bus may bring a frame later than those that follow it, though not by more than this; a number further back is that of
/// a module that has started again.
const LATE_FRAMES: u32 = 8;

/// Raw messages of one frame and when the first came, microseconds.
struct Messages {
    timestamp_us: u64,
    parts: Vec<RawMessage>,
}

impl Rebuilder {
    pub fn accept(&mut self, entry: &LogEntry) {
        let decoded = self.decoder.accept(&entry.frame);
        if let Some(Decoded { node, message: Received::Raw(message) }) = decoded {
            let frames = self.nodes.entry(node.get()).or_default();
            let new = || Messages { timestamp_us: entry.timestamp_us, parts: Vec::new() };
            let (start, newest) = frames.last_key_value().map_or((0, 0), |(&number, _)| number);
            let restarted = newest.saturating_sub(message.sequence) > LATE_FRAMES;
            let number = (start + u32::from(restarted), message.sequence);
            frames.entry(number).or_insert_with(new).parts.push(message);
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
        let lacking = messages().filter(|m| m.lacks_taxels()).count();
        let begin = frames.iter().nth(best.start).filter(|_| !best.is_empty());
        let Some((&(_, first), &Messages { timestamp_us: start_us, .. })) = begin else {
            bail!("no frame of which all {sensors} sensors' raw messages came with all taxels");
        };

        let mut notes = Vec::new();
        let kept = best.len() * sensors;
        if kept < count {
            notes.push(format!(
                "{} of {count} raw messages are left out: others around them are missing, and an episode has no gaps",
                count - kept
            ));
        }
        if lacking > 0 {
            notes.push(format!(
                "{lacking} raw messages lack taxels, for which the bus had no room; an episode cannot"
            ));
        }
        let kept = frames.values().skip(best.start).take(best.len()).flat_map(|frame| &frame.parts);
        let missing = kept.filter(|m| m.health & (health::PIEZO_MISSING | health::XL_MISSING) != 0).count();
        if missing > 0 {
            notes.push(format!(
                "{missing} raw messages say that array or accelerometer was missing; an episode cannot"
            ));
        }
        notes.push(
            "decisions (class, logits, slip) are left out: `slipsense run` makes them again".to_owned(),
        );

        let kept = frames.into_values().skip(best.start).take(best.len());
        let mut episode = assemble(kept.map(|frame| frame.parts), sensors, xl_lsb_g)?;
        let said = self.calibrations.into_iter().filter(|((from, _), _)| *from == node);
        let said = said.map(|((_, sensor), names)| (sensor.to_string(), Value::from(names.join(", then "))));
        let said: serde_json::Map<_, _> = said.collect();
        if !said.is_empty() {
            episode.meta.other.insert("calibration".to_owned(), said.into());
        }
        Ok(Rebuilt { episode, first, start_us, notes })
    }
}

/// The longest stretch of frames that follow each other with all sensors, counted from the first frame that came.
fn longest(frames: &BTreeMap<Number, Messages>, sensors: usize) -> Range<usize> {
    let (mut best, mut run) = (0..0, 0..0);
    let mut before: Option<&[RawMessage]> = None;
    for (index, Messages { parts, .. }) in frames.values().enumerate() {
        let is_whole = |(sensor, part): (_, &RawMessage)| part.sensor == sensor && !part.lacks_taxels();
        let whole = parts.len() == sensors && (0..).zip(parts).all(is_whole);
        if !before.is_some_and(|before| whole && continues(before, parts)) {
            run = index..index;
        }
        before = whole.then_some(parts);
        if whole {
            run.end = index + 1;
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
