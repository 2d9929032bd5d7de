//! The state of each module on the bus, and a second of it as a line.

use std::collections::BTreeMap;
use std::fmt;

use serde::Serialize;
use slipsense::params::MAX_SENSORS;
use slipsense::sensor::PiezoFrame;
use slipsense::wire::{Received, Region, SlipMessage};
use slipsense_recording::candump::LogEntry;
use slipsense_recording::decode::{Count, Decoder};
use slipsense_recording::{HEALTH, words};

#[derive(Default)]
pub struct Module {
    pub slip: Option<SlipMessage>,
    pub piezo: [Option<PiezoFrame>; MAX_SENSORS],
    /// Since the last line.
    second: Second,
    /// At the last line.
    before: Count,
}

#[derive(Clone, Copy, Default)]
struct Second {
    slip_frames: u32,
    may_begin_frames: u32,
    health: [u8; MAX_SENSORS],
}

#[derive(Default)]
pub struct Modules {
    decoder: Decoder,
    pub modules: BTreeMap<u8, Module>,
    first_us: Option<u64>,
    last_us: u64,
}

#[derive(Serialize)]
pub struct Line {
    /// Since the first frame.
    time_s: f64,
    node: u8,
    slip_messages: u64,
    raw_messages: u64,
    class: Option<u8>,
    /// Why the last flag must not be believed, what makes it worse: bits.
    invalid: u8,
    degraded: u8,
    slip_frames: u32,
    may_begin_frames: u32,
    count_sum: Vec<u32>,
    health: Vec<String>,
    lost: u64,
    errors: u64,
}

impl Modules {
    pub fn accept(&mut self, entry: &LogEntry) {
        self.first_us.get_or_insert(entry.timestamp_us);
        self.last_us = entry.timestamp_us;
        let Some(decoded) = self.decoder.accept(&entry.frame) else { return };
        let module = self.modules.entry(decoded.node.get()).or_default();
        match decoded.message {
            Received::Slip(message) => {
                module.second.slip_frames += u32::from(message.slip);
                module.second.may_begin_frames += u32::from(message.may_begin);
                for (bits, contact) in module.second.health.iter_mut().zip(&message.contact) {
                    *bits |= contact.health;
                }
                module.slip = Some(message);
            }
            Received::Raw(message) => {
                if let Some(piezo) = module.piezo.get_mut(usize::from(message.sensor)) {
                    *piezo = (message.known() != Region::NONE).then_some(message.piezo);
                }
            }
        }
    }

    pub fn count(&self, node: u8) -> Count {
        self.decoder.counts().get(&node).copied().unwrap_or_default()
    }

    pub fn time_s(&self) -> f64 {
        self.last_us.saturating_sub(self.first_us.unwrap_or(self.last_us)) as f64 / 1e6
    }

    /// A line of each module since the last call.
    pub fn lines(&mut self) -> Vec<Line> {
        let (time_s, counts) = (self.time_s(), self.decoder.counts());
        let line = |(&node, module): (&u8, &mut Module)| {
            let count = counts.get(&node).copied().unwrap_or_default();
            let before = std::mem::replace(&mut module.before, count);
            let second = std::mem::take(&mut module.second);
            let sensors = module.slip.map_or(0, |slip| usize::from(slip.sensors).min(MAX_SENSORS));
            let contact = module.slip.map(|slip| slip.contact).unwrap_or_default();
            Line {
                time_s,
                node,
                slip_messages: count.slip - before.slip,
                raw_messages: count.raw - before.raw,
                class: module.slip.map(|slip| slip.class),
                invalid: module.slip.map_or(0, |slip| slip.invalid),
                degraded: module.slip.map_or(0, |slip| slip.degraded),
                slip_frames: second.slip_frames,
                may_begin_frames: second.may_begin_frames,
                count_sum: contact[..sensors].iter().map(|contact| contact.sum).collect(),
                health: second.health[..sensors].iter().map(|&bits| words(&HEALTH, bits)).collect(),
                lost: (count.slip_lost + count.raw_lost).saturating_sub(before.slip_lost + before.raw_lost),
                errors: count.errors - before.errors,
            }
        };
        self.modules.iter_mut().map(line).collect()
    }
}

impl fmt::Display for Line {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { time_s, node, slip_messages, raw_messages, slip_frames, may_begin_frames, .. } = self;
        write!(f, "{time_s:>9.3} s  node {node}  {slip_messages:>3} slip, {raw_messages:>3} raw messages")?;
        write!(f, "  slip in {slip_frames:>3}, may begin in {may_begin_frames:>3} frames")?;
        for (sensor, (sum, health)) in self.count_sum.iter().zip(&self.health).enumerate() {
            write!(f, "  [{sensor}] sum {sum:>7}, {health}")?;
        }
        write!(f, "  invalid {}, degraded {}", self.invalid, self.degraded)?;
        write!(f, "  lost {}, errors {}", self.lost, self.errors)
    }
}
