//! `cargo xtask qemu --real-time`: the same tasks, executors and scheduler as on a board, against the clock.
//!
//! An episode is looped for as long as asked; its sensors are handed out in turn and shifted in time, so that one
//! episode fills any number of them. What arrives on the modelled bus is compared with what this computer makes of the
//! same input.

use std::collections::HashMap;
use std::fs;
use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use slipsense::board::TxSlot;
use slipsense::params::FRAME_RATE_HZ;
use slipsense::pipeline::FrameStamp;
use slipsense::wire::{CanFrame, Received, Receiver, SlipMessage};
use slipsense_can_sim::controller::{Arrived, Disturbance};
use slipsense_qemu::events::{
    ARRIVED_FILE, BUS_FILE, Counters, DECIDED_FILE, Decided, START_US, STATUS_FILE, decode_arrived,
    decode_decided, encode_disturbance,
};
use slipsense_recording::Episode;

use super::frames::{Frames, NODE};
use super::host;
use super::machine::{Machine, folder};
use crate::table::{Table, median_and_worst, thousands};

const PROGRAM: &str = "slipsense-qemu-realtime";
/// Tick to slip message in the queue, µs, with one and with three sensors: what is to be kept.
const BARS_US: [(usize, u32); 2] = [(1, 1300), (3, 3400)];
const NS_PER_S: u64 = 1_000_000_000;

/// Its name, and what happens on the bus in a run of so many seconds.
type Scenario = (&'static str, fn(u64) -> Disturbance);

/// Bus-off lasts this long, less in a run that is shorter than three times that.
fn off_ns(seconds: u64) -> std::ops::Range<u64> {
    let start = START_US * 1000 + seconds * NS_PER_S / 3;
    start..start + (2 * NS_PER_S).min(seconds * NS_PER_S / 3)
}

const QUIET: Scenario = ("free bus", |_| Disturbance::default());
/// Three sensors whose raw messages go compressed: the bus carries them all.
const COMPRESSED: Scenario = ("free bus, compressed", |_| Disturbance::default());
const SCENARIOS: [Scenario; 3] = [
    ("100 % foreign load", |_| Disturbance { foreign_load_percent: 100, ..Disturbance::default() }),
    ("1 in 10 frames destroyed", |_| Disturbance { error_every: 10, ..Disturbance::default() }),
    ("bus-off", |seconds| Disturbance { dominant_ns: off_ns(seconds), ..Disturbance::default() }),
];

struct Outcome {
    bus: &'static str,
    sensors: usize,
    frames: usize,
    counters: Counters,
    decided: usize,
    /// Emulated microseconds: 480 instructions each.
    queued_us: [u32; 2],
    busy_max_us: u32,
    arrivals: Arrivals,
    wall_s: f64,
    /// Was the node kept off the bus?
    off: bool,
}

/// Run all scenarios; `false` if one of them is not as it should be.
pub fn run(episode: &Path, model: &[u8], seconds: u32) -> Result<bool> {
    let episode = Episode::read(episode)?;
    let machine = Machine::build(PROGRAM)?.in_real_time();
    let mut outcomes = Vec::new();
    for (sensors, _) in BARS_US {
        let mut frames = looped(&episode, sensors, seconds * FRAME_RATE_HZ)?;
        for compress_raw in [false, true] {
            frames.compress_raw = compress_raw;
            let expected = Expected::new(&frames, model)?;
            let dir = folder(&frames, model)?;
            let (quiet, others): (_, &[_]) =
                if compress_raw { (&COMPRESSED, &[]) } else { (&QUIET, &SCENARIOS) };
            for scenario in std::iter::once(quiet).chain(others.iter().filter(|_| sensors == 3)) {
                eprintln!("{sensors} sensors, {}: {} frames in real time", scenario.0, frames.list.len());
                outcomes.push(one(&machine, dir.path(), scenario, seconds, &expected)?);
            }
        }
    }
    print(&outcomes);
    Ok(outcomes.iter().all(|outcome| outcome.failures().is_empty()))
}

/// The episode again and again; sensor `n` is the episode's sensor `n` modulo what it has, a third of it later each.
fn looped(episode: &Episode, sensors: usize, count: u32) -> Result<Frames> {
    let Frames { list: once, sensors: recorded, .. } = Frames::from_episode(episode, None)?;
    ensure!(!once.is_empty(), "the episode has no frame");
    let mut xl_end = vec![0u32; sensors];
    let frame = |sequence| {
        let part = |sensor: usize| {
            let later = sensor * once.len() / 3;
            let mut part = once[(sequence as usize + later) % once.len()].1[sensor % recorded].clone();
            xl_end[sensor] = xl_end[sensor].wrapping_add(part.xl.len() as u32);
            part.xl_end = xl_end[sensor];
            part
        };
        let since_start_us = (u64::from(sequence) + 1) * 1_000_000 / u64::from(FRAME_RATE_HZ);
        let stamp = FrameStamp { sequence, timestamp_us: START_US + since_start_us };
        (stamp, (0..sensors).map(part).collect())
    };
    Ok(Frames::new(sensors, (0..count).map(frame).collect()))
}

/// What this computer makes of the frames.
struct Expected {
    sensors: usize,
    stamps: Vec<FrameStamp>,
    slips: Vec<CanFrame>,
    /// The CAN frames of each raw message, by frame and sensor.
    raw: HashMap<(u32, u8), Vec<CanFrame>>,
}

impl Expected {
    fn new(frames: &Frames, model: &[u8]) -> Result<Self> {
        let mut expected =
            Self { sensors: frames.sensors, stamps: Vec::new(), slips: Vec::new(), raw: HashMap::new() };
        for (stamp, record) in host::records(frames, model)? {
            let (slip, raw) = record.can.split_first().context("a frame without a slip message")?;
            expected.stamps.push(stamp);
            expected.slips.push(*slip);
            let mut left = raw;
            for sensor in 0..frames.sensors {
                // Each message's last frame alone is marked as such.
                let last = left.iter().position(|frame| is_marked(frame, ENDS_TRANSFER));
                let last = last.context("a raw message without an end")?;
                let (message, rest) = left.split_at(last + 1);
                expected.raw.insert((stamp.sequence, sensor as u8), message.to_vec());
                left = rest;
            }
            ensure!(left.is_empty(), "more CAN frames than messages");
        }
        Ok(expected)
    }
}

/// Bits of the tail byte (OpenCyphal specification, section 4.2).
const STARTS_TRANSFER: u8 = 0x80;
const ENDS_TRANSFER: u8 = 0x40;

fn is_marked(frame: &CanFrame, bit: u8) -> bool {
    frame.data().last().is_some_and(|tail| tail & bit != 0)
}

fn one(
    machine: &Machine,
    dir: &Path,
    scenario: &Scenario,
    seconds: u32,
    expected: &Expected,
) -> Result<Outcome> {
    let disturbance = scenario.1(seconds.into());
    fs::write(dir.join(BUS_FILE), encode_disturbance(&disturbance)).context(BUS_FILE)?;
    let start = Instant::now();
    machine.run(dir)?;
    let wall_s = start.elapsed().as_secs_f64();
    let read =
        |name| fs::read(dir.join(name)).with_context(|| format!("the emulated program wrote no {name}"));
    let counters = Counters::decode(&read(STATUS_FILE)?).context("no status")?;
    let decided: Vec<Decided> = decode_decided(&read(DECIDED_FILE)?).collect();
    Ok(Outcome {
        bus: scenario.0,
        sensors: expected.sensors,
        frames: expected.slips.len(),
        counters,
        decided: decided.len(),
        queued_us: median_and_worst(decided.iter().map(|decided| decided.queued_us).collect()),
        busy_max_us: decided.iter().map(|decided| decided.done_us).max().unwrap_or_default(),
        arrivals: Arrivals::check(&read(ARRIVED_FILE)?, expected, &disturbance)?,
        wall_s,
        off: !disturbance.dominant_ns.is_empty(),
    })
}

/// What arrived, compared with what should have.
#[derive(Default)]
struct Arrivals {
    slips: usize,
    raw: usize,
    /// CAN frames that are not what this computer makes, or parts of a message.
    wrong: usize,
    /// From the tick to the last bit of the slip message.
    worst_us: u64,
    /// From the end of what kept the node off the bus to the last bit of the first slip message.
    recovery_us: Option<u64>,
}

impl Arrivals {
    fn check(mut log: &[u8], expected: &Expected, disturbance: &Disturbance) -> Result<Self> {
        let mut bus = Self::default();
        let mut receiver = Receiver::new(NODE);
        let mut message = Vec::new();
        while !log.is_empty() {
            let arrived = decode_arrived(&mut log).context("the log of the bus ends inside a frame")?;
            match arrived.slot {
                TxSlot::Slip => bus.slip(&arrived, expected, disturbance),
                TxSlot::Raw => {
                    if is_marked(&arrived.frame, STARTS_TRANSFER) {
                        message.clear();
                        // Transfer identifiers come again after 32, and a receiver that knows no time takes a transfer
                        // after a long silence for a repeated one.
                        receiver = Receiver::new(NODE);
                    }
                    message.push(arrived.frame);
                    let is_right = match receiver.accept(&arrived.frame) {
                        Ok(None) => continue,
                        Ok(Some(Received::Raw(raw))) => {
                            expected.raw.get(&(raw.sequence, raw.sensor)) == Some(&message)
                        }
                        Ok(Some(Received::Slip(_))) | Err(_) => false,
                    };
                    bus.raw += usize::from(is_right);
                    bus.wrong += usize::from(!is_right);
                }
                TxSlot::Service => bus.wrong += 1,
            }
        }
        Ok(bus)
    }

    fn slip(&mut self, arrived: &Arrived, expected: &Expected, disturbance: &Disturbance) {
        let message =
            arrived.frame.data().split_last().and_then(|(_, fields)| SlipMessage::decode(NODE, fields).ok());
        let sequence = message.map(|message| message.sequence as usize);
        let Some(sequence) = sequence.filter(|&n| expected.slips.get(n) == Some(&arrived.frame)) else {
            self.wrong += 1;
            return;
        };
        self.slips += 1;
        let age_us = (arrived.at_ns / 1000).saturating_sub(expected.stamps[sequence].timestamp_us);
        self.worst_us = self.worst_us.max(age_us);
        let off = &disturbance.dominant_ns;
        if !off.is_empty() && arrived.at_ns > off.end && self.recovery_us.is_none() {
            self.recovery_us = Some((arrived.at_ns - off.end) / 1000);
        }
    }
}

impl Outcome {
    fn failures(&self) -> Vec<String> {
        let Self { frames, counters, arrivals, off, .. } = self;
        let bar = BARS_US.iter().find(|(sensors, _)| *sensors == self.sensors).map_or(0, |bar| bar.1);
        let slips = arrivals.slips + counters.replaced_slips as usize;
        let raw = arrivals.raw + (counters.dropped_raw + counters.broken_raw + counters.waiting_raw) as usize;
        let made = frames * self.sensors;
        let fits = self.bus != COMPRESSED.0 || counters.dropped_raw == 0;
        let rules = [
            (counters.dropped_frames == 0, format!("{} scans missed", counters.dropped_frames)),
            (counters.late_frames == 0, format!("{} frames late", counters.late_frames)),
            (self.decided == *frames, format!("{} of {frames} frames decided", self.decided)),
            (self.queued_us[1] <= bar, format!("a slip message queued after {} µs", self.queued_us[1])),
            (
                arrivals.wrong == 0,
                format!("{} CAN frames or messages differ from the host's", arrivals.wrong),
            ),
            (slips == *frames, format!("{slips} of {frames} slip messages accounted for")),
            (
                *off || counters.replaced_slips == 0,
                format!("{} slip messages not sent", counters.replaced_slips),
            ),
            (counters.bus_offs == u32::from(*off), format!("{} times off the bus", counters.bus_offs)),
            (*off == arrivals.recovery_us.is_some(), "no slip message after bus-off".to_owned()),
            (counters.broken_raw <= u32::from(*off), format!("{} raw messages cut off", counters.broken_raw)),
            (raw == made, format!("{raw} of {made} raw messages accounted for")),
            (fits, format!("{} compressed raw messages dropped", counters.dropped_raw)),
        ];
        rules.into_iter().filter(|(is_kept, _)| !is_kept).map(|(_, broken)| broken).collect()
    }
}

fn print(outcomes: &[Outcome]) {
    let cells = |outcome: &Outcome| {
        let Outcome { counters, arrivals, queued_us: [median, most], .. } = outcome;
        [
            ("bus", outcome.bus.to_owned()),
            ("sensors", thousands(outcome.sensors)),
            ("frames", thousands(outcome.frames)),
            ("missed", thousands(counters.dropped_frames)),
            ("late", thousands(counters.late_frames)),
            ("queued, median", thousands(*median)),
            ("worst", thousands(*most)),
            ("on the bus", thousands(arrivals.worst_us)),
            ("all done", thousands(outcome.busy_max_us)),
            ("slips", thousands(arrivals.slips)),
            ("replaced", thousands(counters.replaced_slips)),
            ("raw", thousands(arrivals.raw)),
            ("dropped", thousands(counters.dropped_raw + counters.broken_raw)),
            ("differ", thousands(arrivals.wrong)),
        ]
    };
    let rows: Vec<_> = outcomes.iter().map(cells).collect();
    let mut table = Table::new(
        "Real time on the emulated Cortex-M7: 480 instructions are a microsecond (480 MHz at one per cycle, which no \
         core reaches), CAN FD at 1 and 8 Mbit/s with worst stuffing. Times from the frame's tick, µs: slip message \
         queued, its last bit on the bus (worst), inference through with the frame (worst)",
        &rows[0].each_ref().map(|(column, _)| *column),
    );
    rows.into_iter().for_each(|row| table.row(row.map(|(_, cell)| cell)));
    print!("{table}");
    for outcome in outcomes {
        if let Some(us) = outcome.arrivals.recovery_us {
            println!(
                "{}: {} µs off by the node's count, first slip message {} µs after the end of the disturbance, {} raw \
                 message cut off",
                outcome.bus,
                thousands(outcome.counters.bus_off_us),
                thousands(us),
                outcome.counters.broken_raw
            );
        }
        for failure in outcome.failures() {
            println!("FAILED: {}, {} sensors: {failure}", outcome.bus, outcome.sensors);
        }
    }
    let wall_s: f64 = outcomes.iter().map(|outcome| outcome.wall_s).sum();
    println!("{} runs, {wall_s:.0} s of emulation", outcomes.len());
}
