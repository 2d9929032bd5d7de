//! Raw messages of a recording back to an episode.

use std::collections::BTreeMap;

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

/// Rebuild what one node recorded; `node` may be left open where only one speaks.
pub fn episode(entries: &[LogEntry], node: Option<NodeId>, xl_lsb_g: f64) -> Result<Rebuilt> {
    let mut decoder = Decoder::new();
    let mut nodes: BTreeMap<u8, BTreeMap<u32, Vec<RawMessage>>> = BTreeMap::new();
    let mut times = BTreeMap::new();
    for entry in entries {
        let decoded = decoder.accept(&entry.frame);
        if let Some(Decoded { node, message: Received::Raw(message) }) = decoded {
            times.entry((node.get(), message.sequence)).or_insert(entry.timestamp_us);
            nodes.entry(node.get()).or_default().entry(message.sequence).or_default().push(message);
        }
    }
    let node = match (node.map(NodeId::get), nodes.len()) {
        (Some(node), _) => node,
        (None, 1) => nodes.keys().next().copied().unwrap_or_default(),
        (None, 0) => bail!("no raw message in it: an episode cannot be rebuilt"),
        (None, _) => bail!("raw messages of nodes {:?}: say which one, --node-id N", nodes.keys()),
    };
    let Some(frames) = nodes.remove(&node) else { bail!("no raw message of node {node} in it") };
    let count = frames.values().flatten().count();
    let sensors = 1 + frames.values().flatten().map(|m| usize::from(m.sensor)).max().unwrap_or(0);

    let (mut best, mut run): (Vec<&Vec<RawMessage>>, Vec<&Vec<RawMessage>>) = Default::default();
    for parts in frames.values() {
        let whole = parts.len() == sensors && (0..sensors).all(|s| usize::from(parts[s].sensor) == s);
        let follows = run.last().is_some_and(|before| whole && continues(before, parts));
        if !follows {
            best = longer(best, std::mem::take(&mut run));
        }
        if whole {
            run.push(parts);
        }
    }
    best = longer(best, run);
    ensure!(!best.is_empty(), "no frame of which all {sensors} sensors' raw messages came");

    let mut notes = Vec::new();
    let kept = best.len() * sensors;
    if kept < count {
        notes.push(format!(
            "{} of {count} raw messages are left out: others around them are missing, and an episode has no gaps",
            count - kept
        ));
    }
    let missing = best.iter().flat_map(|parts| parts.iter());
    let missing = missing.filter(|m| m.health & (health::PIEZO_MISSING | health::XL_MISSING) != 0).count();
    if missing > 0 {
        notes.push(format!(
            "{missing} raw messages say that array or accelerometer was missing; an episode cannot"
        ));
    }
    notes.push("decisions (class, logits, slip) are left out: `slipsense run` makes them again".to_owned());

    let first = best[0][0].sequence;
    let mut episode = assemble(&best, sensors, xl_lsb_g)?;
    if let Some(calibrations) = calibrations(entries, node) {
        episode.meta.other.insert("calibration".to_owned(), calibrations);
    }
    Ok(Rebuilt { episode, first, start_us: times.get(&(node, first)).copied().unwrap_or_default(), notes })
}

/// By which calibration each sensor's array was read, as the node said again and again: version and name, or `none`; one
/// after the other where it changed. `None`: it said nothing.
fn calibrations(entries: &[LogEntry], node: u8) -> Option<Value> {
    let mut said: BTreeMap<String, Vec<String>> = BTreeMap::new();
    let lines = entries.iter().filter_map(|entry| calibration(&entry.frame));
    for (_, sensor, calibration) in lines.filter(|(from, ..)| from.get() == node) {
        let of_sensor = said.entry(sensor.to_string()).or_default();
        if of_sensor.last().is_none_or(|last| last != calibration) {
            of_sensor.push(calibration.to_owned());
        }
    }
    let joined = said.into_iter().map(|(sensor, names)| (sensor, Value::from(names.join(", then "))));
    Some(Value::Object(joined.collect())).filter(|said| said.as_object().is_some_and(|said| !said.is_empty()))
}

fn longer<'a>(a: Vec<&'a Vec<RawMessage>>, b: Vec<&'a Vec<RawMessage>>) -> Vec<&'a Vec<RawMessage>> {
    if b.len() > a.len() { b } else { a }
}

/// Is this the next frame, with every sample since the last one?
fn continues(before: &[RawMessage], parts: &[RawMessage]) -> bool {
    before.iter().zip(parts).all(|(before, now)| {
        now.sequence == before.sequence.wrapping_add(1)
            && now.xl_dropped == 0
            && now.xl_end.wrapping_sub(now.xl.len() as u32) == before.xl_end
    })
}

fn assemble(frames: &[&Vec<RawMessage>], sensors: usize, xl_lsb_g: f64) -> Result<Episode> {
    let mut xl = vec![Vec::new(); sensors];
    let mut xl_end = Vec::new();
    let mut piezo = Vec::new();
    for parts in frames {
        for (message, xl) in parts.iter().zip(&mut xl) {
            piezo.push(message.piezo.clone());
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
