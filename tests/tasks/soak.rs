//! Hours in a row with faults of sensors, bus, settings and time, and restarts of the board: every slip message is the
//! host's, byte for byte, and arrives or is counted; every raw message that arrives is what the sensors gave; a receiver
//! knows of every loss, and does not believe the first messages after a restart.
//!
//! A day: `SLIPSENSE_SOAK_HOURS=24 cargo test --release -p slipsense --test host soak -- --nocapture`

use std::cell::RefCell;
use std::collections::{BTreeMap, VecDeque};
use std::ops::Range;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slipsense::board::TxSlot;
use slipsense::health::Status;
use slipsense::net::Model;
use slipsense::params::{FRAME_PERIOD_US, FRAME_RATE_HZ, MAX_SENSORS};
use slipsense::pipeline::{FrameStamp, Pipeline};
use slipsense::sensor::{PiezoFrame, SensorReadings};
use slipsense::wire::{
    CanFrame, Check, FlagState, INVALID_OTHER_MODEL, Origin, RawMessage, Received, Receiver, Region,
    SlipMessage, SlipReceiver, Transmitter,
};
use slipsense_can_sim::controller::{Arrived, Bus};

use super::fault_plan::{Effect, FAULTS, Fault, Plan, plain};
use super::world::{BATCH, FRAME_NS, NODE, World, assert_taxels, model_bytes, stamp, tick_ns};

/// Counters start so many frames before they wrap.
const BEFORE_WRAP: u32 = 60 * FRAME_RATE_HZ;
/// Frames from the start of a fault to the start of the next.
const GAP: Range<u32> = FRAME_RATE_HZ..15 * FRAME_RATE_HZ;
/// Frames that a fault lasts.
const LENGTH: Range<u32> = 1..3 * FRAME_RATE_HZ;
/// Frames from one restart to the next; before the first, the counters wrap.
const UPTIME: Range<u32> = 5 * FRAME_RATE_HZ..120 * FRAME_RATE_HZ;
/// From a restart to the first period of the next uptime, as the emulated board takes from its reset.
const BOOT_US: u64 = 73_000;
/// Raw messages that can be under way: queued, or in part on the bus.
const UNDER_WAY: u32 = 8;
/// Frames after the last fault, so that the last slip message arrives.
const QUIET: u32 = 5 * FRAME_RATE_HZ;
/// Frames whose raw messages may still arrive: one that has started waits while the bus is full.
const KEPT: usize = 2 * LENGTH.end as usize;

/// The same frames through the pipeline and the wire, called directly, and the receivers at the other end of the bus.
struct Host<'a> {
    plan: Plan<'a>,
    settings: Plan<'a>,
    /// Frames since the last restart, until the next.
    uptime: Range<u32>,
    /// When it began, on the receivers' clock.
    began_us: u64,
    pipeline: Pipeline<'a>,
    transmitter: Transmitter,
    status: Status,
    read_until_ns: u64,
    /// Slip messages that have not arrived yet.
    slips: VecDeque<(SlipMessage, CanFrame)>,
    kept: VecDeque<(u32, [SensorReadings; MAX_SENSORS])>,
    receiver: Receiver,
    slip_receiver: SlipReceiver,
    /// Sequence number that it accepted last.
    last: Option<u32>,
    arrived_slips: u32,
    /// Raw messages [made](MADE), [arrived](ARRIVED), [in part](IN_PART).
    raw: [u32; 3],
    errors: u32,
    silences: u32,
}

const MADE: usize = 0;
const ARRIVED: usize = 1;
const IN_PART: usize = 2;

impl<'a> Host<'a> {
    /// The board restarts; what it had is gone, and the receivers have noticed nothing yet.
    fn restart(&mut self, model: &'a [u8], uptime: Range<u32>, starts: u8) {
        self.began_us += tick_ns(self.uptime.len() as u32) / 1000 + BOOT_US;
        self.uptime = uptime;
        self.pipeline = Pipeline::new(Model::parse(model).unwrap(), MAX_SENSORS).unwrap();
        self.transmitter = Transmitter::new(NODE);
        self.status = Status { starts, ..Status::new() };
        self.read_until_ns = 0;
        self.slips.clear();
        self.kept.clear();
    }

    /// Raw messages made and arrived, slip messages arrived.
    fn counts(&self) -> [u32; 3] {
        [self.raw[MADE], self.raw[ARRIVED], self.arrived_slips]
    }

    /// Decide a frame as the tasks do, with the settings at the time of the decision: those of the next tick.
    fn frame(&mut self, first_sequence: u32, frame: u32) {
        let mut parts = [const { SensorReadings::new() }; MAX_SENSORS];
        self.plan.readings(self.uptime.start + frame, &mut parts);
        let config = self.settings.config((self.uptime.start + frame + 1).min(self.uptime.end - 1));
        self.pipeline.configure(config.point, &config.masks, config.mountings);
        let output = self.pipeline.step_readings(&mut parts);
        let stamp = stamp(frame);
        let sequence = first_sequence.wrapping_add(frame);
        self.read_until_ns =
            self.read_until_ns.max(tick_ns(frame)) + self.plan.read_ns(self.uptime.start + frame);
        let late = self.read_until_ns / 1000 - stamp.timestamp_us > FRAME_PERIOD_US;
        self.status.late_frames += u32::from(late);
        let mut origin = Origin::new(&self.status, self.status.late_frames, late, config.locked);
        origin.invalid = if config.expected_model.is_some() { INVALID_OTHER_MODEL } else { 0 };
        let message = output.slip_message(FrameStamp { sequence, ..stamp }, &origin);
        self.slips.push_back((message, self.transmitter.slip(&message)));
        if sequence.is_multiple_of(u32::from(config.raw_every)) {
            let delivered = parts.iter().filter(|part| part.piezo_arrived || part.xl_arrived);
            self.raw[MADE] += delivered.count() as u32;
        }
        self.kept.push_back((sequence, parts));
        if self.kept.len() > KEPT {
            self.kept.pop_front();
        }
        assert!(self.slips.len() < 2 * LENGTH.end as usize, "no slip message has arrived for seconds");
    }

    fn arrived(&mut self, arrived: Arrived) {
        match self.receiver.accept(&arrived.frame) {
            Ok(None) => {}
            Ok(Some(Received::Slip(slip))) => {
                assert_eq!(arrived.slot, TxSlot::Slip);
                let host = loop {
                    let (host, frame) = self.slips.pop_front().expect("no slip message but the host's");
                    if host.sequence == slip.sequence {
                        assert_eq!(slip, host);
                        break frame;
                    }
                };
                assert_eq!(arrived.frame, host);
                self.arrived_slips += 1;
                self.check_losses(slip.sequence, arrived.frame.data(), self.began_us + arrived.at_ns / 1000);
            }
            Ok(Some(Received::Raw(message))) => self.raw_message(&message),
            Err(_) => self.errors += 1,
        }
    }

    /// The receiver counts every lost message, or it notices a silence.
    fn check_losses(&mut self, sequence: u32, data: &[u8], now_us: u64) {
        let silent = self.slip_receiver.state(now_us) == FlagState::NoData;
        let lost = self.slip_receiver.lost;
        let check = self.slip_receiver.receive(data, now_us);
        if !matches!(check, Check::Ok | Check::SomeLost) {
            return;
        }
        let gap = self.last.replace(sequence).map_or(0, |last| sequence.wrapping_sub(last) - 1);
        self.silences += u32::from(silent);
        assert!(!silent || self.slip_receiver.state(now_us) != FlagState::Valid, "believed at once");
        let counted = self.slip_receiver.lost.wrapping_sub(lost);
        assert!(silent || counted == gap, "{gap} messages lost unseen before {sequence}");
    }

    fn raw_message(&mut self, message: &RawMessage) {
        self.raw[ARRIVED] += 1;
        self.raw[IN_PART] += u32::from(message.region != Region::ALL);
        let age = message.sequence.wrapping_sub(self.kept[0].0);
        let (_, parts) = &self.kept[age as usize];
        let part = &parts[usize::from(message.sensor)];
        if part.xl_arrived {
            let (sent, dropped) = (message.xl.len(), usize::from(message.xl_dropped));
            assert_eq!(sent + dropped, part.xl.len());
            assert_eq!((message.xl.as_slice(), message.xl_end), (&part.xl[dropped..], part.xl_end));
        }
        assert_taxels(
            message,
            if part.piezo_arrived { &part.piezo } else { &const { PiezoFrame::zeroed() } },
        );
    }
}

/// Memory of this process, bytes; 0 where there is no such file.
fn resident_bytes() -> u64 {
    let text = std::fs::read_to_string("/proc/self/statm").unwrap_or_default();
    text.split(' ').nth(1).and_then(|pages| pages.parse::<u64>().ok()).map_or(0, |pages| 4096 * pages)
}

#[test]
fn every_message_of_hours_with_faults_is_the_hosts_or_counted() {
    let asked = std::env::var("SLIPSENSE_SOAK_HOURS").ok();
    let number = |hours: &String| hours.parse::<f64>().expect("SLIPSENSE_SOAK_HOURS is a number");
    let hours = asked.as_ref().map_or(0.08, number);
    let frames = (hours * 3600.0 * f64::from(FRAME_RATE_HZ)) as u32;
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let (mut faults, mut kinds) = (Vec::new(), Vec::new());
    let mut start = rng.random_range(GAP);
    while start + LENGTH.end + QUIET < frames {
        // Each kind once before any comes again.
        if kinds.is_empty() {
            kinds.extend(0..FAULTS.len());
        }
        let kind = kinds.swap_remove(rng.random_range(0..kinds.len()));
        let sensor = rng.random_range(0..MAX_SENSORS);
        faults.push(Fault { kind, sensor, frames: start..start + rng.random_range(LENGTH) });
        start += rng.random_range(GAP);
    }
    let mut uptimes = Vec::new();
    let (mut from, mut length) = (0, 2 * BEFORE_WRAP);
    while from + length + QUIET < frames {
        uptimes.push(from..from + length);
        from += length;
        length = rng.random_range(UPTIME);
    }
    uptimes.push(from..frames);
    let model = model_bytes();
    let plan = || Plan::new(&faults, (BEFORE_WRAP * BATCH).wrapping_neg());
    let host = RefCell::new(Host {
        plan: plan(),
        settings: plan(),
        uptime: uptimes[0].clone(),
        began_us: 0,
        pipeline: Pipeline::new(Model::parse(&model).unwrap(), MAX_SENSORS).unwrap(),
        transmitter: Transmitter::new(NODE),
        status: Status::new(),
        read_until_ns: 0,
        slips: VecDeque::new(),
        kept: VecDeque::new(),
        receiver: Receiver::new(NODE),
        slip_receiver: SlipReceiver::new(NODE),
        last: None,
        arrived_slips: 0,
        raw: [0; 3],
        errors: 0,
        silences: 0,
    });
    let (sensors, settings) = (RefCell::new(plan()), RefCell::new(plan()));
    let (bus, disturbed) = (RefCell::new(plan()), RefCell::new(None));
    let memory = RefCell::new(0);
    let (mut status, mut starts) = (Status::new(), 0);
    let mut gone = [0; 2];
    for (number, uptime) in uptimes.iter().enumerate() {
        let is_last = uptime.end == frames;
        if number > 0 {
            // A supply that fails takes the count of starts with it.
            starts = if rng.random_bool(0.5) { starts + 1 } else { 0 };
            host.borrow_mut().restart(&model, uptime.clone(), starts);
            disturbed.replace(None);
        }
        let first_sequence = if number == 0 { BEFORE_WRAP.wrapping_neg() } else { 0 };
        let mut world = World {
            first_sequence,
            script: &|frame, parts| sensors.borrow_mut().readings(uptime.start + frame, parts),
            read_ns: &|frame| sensors.borrow_mut().read_ns(uptime.start + frame),
            before_tick: &|shared, frame| {
                shared.update_status(|status| status.starts = starts);
                shared.set_config(settings.borrow_mut().config(uptime.start + frame));
                host.borrow_mut().frame(first_sequence, frame);
                if uptime.start + frame == frames / 2 {
                    *memory.borrow_mut() = resident_bytes();
                }
            },
            on_bus: &|frame, controller: &mut Bus| {
                let mut bus = bus.borrow_mut();
                let last = bus
                    .at(uptime.start + frame)
                    .filter(|(_, effect)| matches!(effect, Effect::Bus(_)))
                    .last();
                let start = last.map(|(fault, _)| fault.frames.start);
                if disturbed.replace(start) != start {
                    controller.disturb(match last {
                        Some((fault, Effect::Bus(make))) => {
                            make(tick_ns(frame)..tick_ns(fault.frames.end - uptime.start))
                        }
                        _ => plain(),
                    });
                }
            },
            sink: Some(&|arrived| host.borrow_mut().arrived(arrived)),
            ..World::new(uptime.len() as u32, MAX_SENSORS)
        };
        if !is_last {
            world.afterwards_ns = rng.random_range(0..FRAME_NS);
        }
        let before = host.borrow().counts();
        let ran = world.run().status;
        let host = host.borrow();
        let late = host.status.late_frames - ran.late_frames;
        assert!(ran.dropped_frames == 0 && late <= u32::from(!is_last));
        let [made, arrived, slips]: [u32; 3] = std::array::from_fn(|i| host.counts()[i] - before[i]);
        let raw = made - arrived - ran.dropped_raw - ran.broken_raw;
        let slip = uptime.len() as u32 - slips - ran.replaced_slips;
        // With a restart go what waits, and what is not queued yet of the frame before it.
        let most = if is_last { [0, UNDER_WAY] } else { [3, UNDER_WAY + MAX_SENSORS as u32 + 1] };
        assert!(
            slip <= most[0] && raw <= most[1],
            "{slip} slip, {raw} raw messages are neither here nor counted"
        );
        gone[0] += slip;
        gone[1] += raw;
        status.replaced_slips += ran.replaced_slips;
        status.dropped_raw += ran.dropped_raw;
        status.broken_raw += ran.broken_raw;
        status.bus_offs += ran.bus_offs;
        status.late_frames += ran.late_frames;
    }
    let host = host.into_inner();
    let mut kinds: BTreeMap<&str, u32> = BTreeMap::new();
    faults.iter().for_each(|fault| *kinds.entry(FAULTS[fault.kind].0).or_default() += 1);
    println!(
        "{frames} frames of {MAX_SENSORS} sensors ({:.2} h), {} faults of {} kinds, {} restarts: {} slip messages equal \
         to the host's, {} counted as replaced, {} gone with a restart; {} raw messages \
         equal ({} in part), {} counted as dropped, {} as cut off, {} gone likewise; {} times off the \
         bus, {} late frames, {} silences that the receiver noticed, {} losses that it counted",
        f64::from(frames) / 3600.0 / f64::from(FRAME_RATE_HZ),
        faults.len(),
        kinds.len(),
        uptimes.len() - 1,
        host.arrived_slips,
        status.replaced_slips,
        gone[0],
        host.raw[ARRIVED],
        host.raw[IN_PART],
        status.dropped_raw,
        status.broken_raw,
        gone[1],
        status.bus_offs,
        status.late_frames,
        host.silences,
        host.slip_receiver.lost
    );
    println!("{kinds:?}");
    assert_eq!(kinds.len(), FAULTS.len(), "each kind was met");
    let met = [status.bus_offs, status.replaced_slips, host.slip_receiver.lost, host.silences];
    assert!(uptimes.len() > 1 && !met.contains(&0), "{met:?}");
    assert_eq!(host.errors, 0, "no part of a message");
    if asked.is_some() {
        // Alone in this process.
        let grown = resident_bytes().saturating_sub(memory.into_inner());
        println!("{grown} bytes more than after half of the time");
        assert!(grown < 1 << 20);
    }
}
