//! How much of a bus modules take, and how long a slip message waits on it.
//!
//! Frames are counted bit by bit by [`crate`], stuff bits included: those of given frames exactly,
//! and the longest that any data could make. The wait is calculated (one frame of lower priority that has just begun,
//! then every slip message of a smaller identifier) and simulated on the same crate's bus.
//!
//! Other nodes' frames are full ones whose identifiers lie between the slip and the raw messages'. Traffic above the
//! slip message, an emergency stop for example, is left out, and so are heartbeats and service calls.

use crate::{Bus, Disturbance, Format, Frame, Id, Timing, dlc_of, worst_case};
use slipsense::params::{FRAME_RATE_HZ, MAX_SENSORS, XL_RATE_HZ};
use slipsense::sensor::{PiezoFrame, SensorInput};
use slipsense::wire::{
    COMPRESSED_PORT, CanFrame, FD_LENGTHS, MessageId, NodeId, Priority, RAW_PORT, RAW_PRIORITY, RAW_XL_MAX,
    RawBuffer, RawForm, RawFrame, SLIP_PORT, SlipMessage, Transmitter,
};

/// Clock that the bit rates are divided from, Hz: the boards' FDCAN kernel clock.
pub const CLOCK_HZ: u32 = 80_000_000;
/// Nodes on one bus, at most.
pub const NODES_MAX: usize = 8;
/// Largest bit rate of the arbitration phase, bit/s (ISO 11898-2:2016).
pub const NOMINAL_BPS_MAX: u32 = 1_000_000;
/// Largest bit rate of the data phase in a plan, bit/s: CAN FD SIC transceivers' (CiA 601-4).
pub const DATA_BPS_MAX: u32 = 8_000_000;
/// Samples that a frame brings at most from a part whose clock is 3 % fast.
pub const SAMPLES_TYPICAL_MAX: usize = (XL_RATE_HZ * 103 / 100).div_ceil(FRAME_RATE_HZ) as usize;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Plan {
    /// Modules on the bus, 1 to [`NODES_MAX`], at addresses from the default one up.
    pub nodes: usize,
    /// Sensors of each, 1 to 3.
    pub sensors: usize,
    /// Raw messages of every n-th frame; 0: none.
    pub raw_every: u32,
    /// How raw messages go, for the worst case; compressed, that of data which no coder makes shorter.
    pub raw_form: RawForm,
    /// Accelerometer samples in each raw message, for the worst case; at most [`RAW_XL_MAX`].
    pub samples: usize,
    /// What other nodes ask for, percent of the bus's time.
    pub foreign_percent: u32,
}

/// Frames that modules have sent, or could have: what a typical load is taken from.
#[derive(Clone, Debug, Default)]
pub struct Sample {
    slip: Vec<Frame>,
    /// Frames of raw messages, in their order.
    raw: Vec<Frame>,
    raw_messages: u32,
}

impl Sample {
    /// Add a frame; frames of other messages are passed over.
    pub fn push(&mut self, frame: &CanFrame) {
        let Ok(model) = Frame::new(Id::Extended(frame.id()), Format::FD, frame.data()) else { return };
        match MessageId::from_can(frame.id()).map(|id| id.port) {
            Ok(SLIP_PORT) => self.slip.push(model),
            Ok(RAW_PORT | COMPRESSED_PORT) => {
                self.raw_messages += u32::from(frame.ends_transfer());
                self.raw.push(model);
            }
            _ => {}
        }
    }

    /// Are there both kinds of message?
    pub fn is_complete(&self) -> bool {
        !self.slip.is_empty() && self.raw_messages > 0
    }
}

/// Shares of the bus's time, percent. Above 100 together the raw messages lose.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Load {
    pub slip_percent: f64,
    pub raw_percent: f64,
    pub foreign_percent: f64,
    pub total_percent: f64,
}

/// The longest time from a slip message's handing over to the end of its frame, microseconds.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Latency {
    /// By formula.
    pub calculated_us: f64,
    /// The longest of [`SIMULATED_PERIODS`] frame periods on the modelled bus, always full.
    pub simulated_us: f64,
}

/// What a plan means at one pair of bit rates.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct BusLoad {
    pub nominal_bps: u32,
    pub data_bps: u32,
    /// With the sample's frames, to the bit.
    pub exact: Load,
    /// With the most stuff bits that any data could need.
    pub worst: Load,
    /// Of the module with the largest address, on a bus full of the sample's frames.
    pub latency_exact: Latency,
    /// The same with the data of every frame chosen so that it is longest.
    pub latency_worst: Latency,
}

pub const SIMULATED_PERIODS: u32 = 1440;

/// Calculate and simulate. `sample` must be [complete](Sample::is_complete).
pub fn plan(plan: &Plan, sample: &Sample, timing: &Timing) -> BusLoad {
    let longest = Longest::new(plan, timing);
    let cycles = |frames: &[Frame]| -> u64 {
        frames.iter().map(|frame| timing.frame(frame) + timing.intermission()).sum()
    };
    let exact = load(
        plan,
        timing,
        cycles(&sample.slip) as f64 / sample.slip.len() as f64,
        cycles(&sample.raw) as f64 / f64::from(sample.raw_messages),
    );
    let worst = load(plan, timing, longest.slip as f64, longest.raw_message as f64);
    let foreign = if plan.foreign_percent > 0 { longest.foreign } else { 0 };
    let latency = |slip_cycles: u64, raw_cycles: u64, slip: &[Frame], raw: &[Frame]| {
        let blocking = foreign.max(if plan.raw_every > 0 { raw_cycles } else { 0 });
        let us = |cycles: u64| timing.ns(cycles) as f64 / 1000.0;
        Latency {
            calculated_us: us(wait(plan, timing, blocking, slip_cycles)),
            simulated_us: us(simulate(plan, timing, slip, raw)),
        }
    };
    let frame_max = |frames: &[Frame]| frames.iter().map(|frame| timing.frame(frame)).max().unwrap_or(0);
    let latency_exact = latency(frame_max(&sample.slip), frame_max(&sample.raw), &sample.slip, &sample.raw);
    let longest_slip = longest_frame(slip_id(0), 64, timing);
    let longest_raw = longest_frame(raw_id(plan, 0), longest.raw_bytes, timing);
    let slip_cycles = longest.slip - timing.intermission();
    let latency_worst = latency(slip_cycles, longest.raw_frame, &[longest_slip], &[longest_raw]);
    let [nominal_bps, data_bps] = [timing.nominal, timing.data].map(|bit| timing.clock_hz / bit.cycles());
    BusLoad { nominal_bps, data_bps, exact, worst, latency_exact, latency_worst }
}

fn load(plan: &Plan, timing: &Timing, slip_cycles: f64, raw_cycles: f64) -> Load {
    let per_second = f64::from(FRAME_RATE_HZ) * plan.nodes as f64;
    let percent = |cycles_per_s: f64| 100.0 * cycles_per_s / f64::from(timing.clock_hz);
    let raw_rate = match plan.raw_every {
        0 => 0.0,
        every => per_second * plan.sensors as f64 / f64::from(every),
    };
    let (slip_percent, raw_percent) = (percent(per_second * slip_cycles), percent(raw_rate * raw_cycles));
    let foreign_percent = f64::from(plan.foreign_percent);
    let total_percent = slip_percent + raw_percent + foreign_percent;
    Load { slip_percent, raw_percent, foreign_percent, total_percent }
}

/// Longest frames whatever their data, cycles; messages with their intermissions, frames without.
struct Longest {
    slip: u64,
    raw_message: u64,
    raw_frame: u64,
    /// Data of that.
    raw_bytes: usize,
    foreign: u64,
}

impl Longest {
    fn new(plan: &Plan, timing: &Timing) -> Self {
        let of = |id: u32, bytes: usize| {
            let dlc = dlc_of(bytes, true).unwrap_or(15);
            worst_case(Some(Id::Extended(id)), true, Format::FD, dlc, timing)
        };
        let nodes = 0..plan.nodes;
        let slip = nodes.clone().map(|node| of(slip_id(node), 64)).max().unwrap_or(0) + timing.intermission();
        let lengths = raw_lengths(plan);
        let raw_bytes = lengths.iter().copied().max().unwrap_or(0);
        let raw_message = |node: usize| {
            lengths.iter().map(|&bytes| of(raw_id(plan, node), bytes) + timing.intermission()).sum::<u64>()
        };
        Self {
            slip,
            raw_message: nodes.clone().map(raw_message).max().unwrap_or(0),
            raw_frame: nodes.map(|node| of(raw_id(plan, node), raw_bytes)).max().unwrap_or(0),
            raw_bytes,
            foreign: worst_case(None, true, Format::FD, 15, timing),
        }
    }
}

/// Bytes of the frames of the longest raw message with the plan's samples.
fn raw_lengths(plan: &Plan) -> Vec<usize> {
    // MurmurHash3's last step: bits that no coder of differences makes anything of.
    let noise = |index: usize| {
        let mix = |bits: u32, shift: u32, factor: u32| (bits ^ bits >> shift).wrapping_mul(factor);
        let bits = mix(mix(index as u32 + 1, 16, 0x85EB_CA6B), 13, 0xC2B2_AE35);
        bits ^ bits >> 16
    };
    let piezo = PiezoFrame::from_scan(std::array::from_fn(|index| (noise(index) >> 20) as u16));
    let xl: [_; RAW_XL_MAX] =
        std::array::from_fn(|index| std::array::from_fn(|axis| (noise(3 * index + axis) >> 16) as i16));
    let input = SensorInput { piezo: Some(&piezo), xl: Some(&xl[..plan.samples.min(RAW_XL_MAX)]), xl_end: 0 };
    let frame = RawFrame { timestamp_us: 0, sequence: 0, sensor: 0, health: 0, input };
    Transmitter::new(NodeId::DEFAULT)
        .raw_as(plan.raw_form, &frame, &mut RawBuffer::new())
        .map(|frame| frame.data().len())
        .collect()
}

fn address(node: usize) -> NodeId {
    NodeId::new(NodeId::DEFAULT.get() + node as u8).unwrap_or(NodeId::DEFAULT)
}

fn slip_id(node: usize) -> u32 {
    Transmitter::new(address(node)).slip(&SlipMessage::default()).id()
}

fn raw_id(plan: &Plan, node: usize) -> u32 {
    let port = match plan.raw_form {
        RawForm::Plain => RAW_PORT,
        RawForm::Compressed(_) => COMPRESSED_PORT,
    };
    MessageId { priority: RAW_PRIORITY, port, node: address(node) }.to_can()
}

/// Cycles from handing over to end of frame, of the module whose slip messages have the largest identifier.
fn wait(plan: &Plan, timing: &Timing, blocking: u64, slip: u64) -> u64 {
    // A frame handed over before another's start of frame competes with it; so the blocking one has begun.
    let bit = u64::from(timing.nominal.cycles());
    let begun = if blocking > 0 { blocking + timing.intermission() - bit } else { 0 };
    let period = u64::from(timing.clock_hz / FRAME_RATE_HZ);
    let ahead = (plan.nodes - 1) as u64 * (slip + timing.intermission());
    // Each of the others' slip messages goes once, unless the wait outlasts a period.
    let mut start = begun + ahead;
    for _ in 0..100 {
        let next = begun + ahead * (start / period + 1);
        if next == start {
            break;
        }
        start = next;
    }
    start + slip
}

/// The frame of this identifier and length that takes longest, found by trial: once the first byte has ended the
/// header's run, four equal bits after each stuff bit bring the next.
fn longest_frame(id: u32, bytes: usize, timing: &Timing) -> Frame {
    let candidates = (0..=255u8).flat_map(|first| {
        (0..8u32).filter_map(move |phase| {
            let mut data = [0x0Fu8.rotate_left(phase); 64];
            data[0] = first;
            Frame::new(Id::Extended(id), Format::FD, &data[..bytes]).ok()
        })
    });
    candidates.max_by_key(|frame| timing.frame(frame)).expect("a length of CAN FD, not 0")
}

/// The same data under another identifier.
fn readdressed(frame: &Frame, id: u32) -> Frame {
    Frame::new(Id::Extended(id), Format::FD, frame.data()).unwrap_or(*frame)
}

/// The longest wait of the last module's slip messages on a bus that raw messages and, if there are any, frames of
/// other nodes fill without a pause. Every period all modules hand over their slip message one bit after a frame
/// has begun: the worst instant there is.
fn simulate(plan: &Plan, timing: &Timing, slip: &[Frame], raw: &[Frame]) -> u64 {
    const OTHERS: usize = NODES_MAX;
    let mut bus: Bus<{ NODES_MAX + 1 }> = Bus::new(*timing);
    let foreign_id = MessageId { priority: Priority::Nominal, port: 1000, node: address(NODES_MAX) }.to_can();
    let foreign = longest_frame(foreign_id, 64, timing);
    let bit = u64::from(timing.nominal.cycles());
    let period = u64::from(timing.clock_hz / FRAME_RATE_HZ);
    let mut queued: [Option<(u64, Frame)>; NODES_MAX] = [None; NODES_MAX];
    let (mut now, mut next_tick, mut periods, mut longest, mut sent_raw) = (0, period, 0, 0, 0usize);
    while periods < SIMULATED_PERIODS || queued.iter().any(Option::is_some) {
        // Filling frames: raw ones in turn, others where the plan has any.
        let filling = |node: usize| {
            (plan.raw_every > 0 && node < plan.nodes && !raw.is_empty())
                .then(|| readdressed(&raw[(sent_raw + node) % raw.len()], raw_id(plan, node)))
        };
        let mut frames: [Option<Frame>; NODES_MAX + 1] = core::array::from_fn(filling);
        // In turn with the raw messages, which it would keep off the bus for ever.
        let turn = plan.raw_every == 0 || sent_raw.is_multiple_of(2);
        frames[OTHERS] = (plan.foreign_percent > 0 && turn).then_some(foreign);
        for (frame, queued) in frames.iter_mut().zip(&queued) {
            if let Some((_, slip)) = queued.filter(|&(at, _)| at <= now) {
                *frame = Some(slip);
            }
        }
        let offered = core::array::from_fn(|node| frames[node].as_ref());
        let attempt = bus.attempt(now, &offered, Disturbance::default());
        let handed_over = match attempt.expect("each node has identifiers of its own") {
            // Nothing fills this bus: the slip messages go when they come.
            None => {
                now = next_tick;
                Some(now)
            }
            Some(attempt) => {
                let sent =
                    queued.get_mut(attempt.node).and_then(|queued| queued.take_if(|(at, _)| *at <= now));
                now = attempt.end + timing.intermission();
                if let Some((at, _)) = sent {
                    if attempt.node + 1 == plan.nodes {
                        longest = longest.max(attempt.end - at);
                    }
                    continue;
                }
                sent_raw += 1;
                (attempt.start >= next_tick && periods < SIMULATED_PERIODS).then_some(attempt.start + bit)
            }
        };
        if let Some(at) = handed_over {
            periods += 1;
            next_tick += period;
            for (node, queued) in queued.iter_mut().take(plan.nodes).enumerate() {
                let frame = &slip[(periods as usize + node) % slip.len()];
                *queued = Some((at, readdressed(frame, slip_id(node))));
            }
        }
    }
    longest
}

const _: () = assert!(MAX_SENSORS == 3 && FD_LENGTHS[15] == 64);

#[cfg(test)]
mod tests {
    use super::*;
    use slipsense::wire::{COMPRESSED_FRAME_BYTES, Detail};

    fn timing(data_bps: u32) -> Timing {
        Timing::new(CLOCK_HZ, NOMINAL_BPS_MAX, data_bps).unwrap()
    }

    const ONE: Plan = Plan {
        nodes: 1,
        sensors: 1,
        raw_every: 1,
        raw_form: RawForm::Plain,
        samples: 34,
        foreign_percent: 0,
    };
    const COMPRESSED: Plan = Plan { raw_form: RawForm::Compressed(Detail::All), ..ONE };

    fn planned(asked: Plan, data_bps: u32) -> BusLoad {
        plan(&asked, &sample(33), &timing(data_bps))
    }

    fn sample(samples: usize) -> Sample {
        let mut sample = Sample::default();
        let mut transmitter = Transmitter::new(NodeId::DEFAULT);
        let (piezo, xl) = (PiezoFrame::zeroed(), [[-3, 1, 2047]; RAW_XL_MAX]);
        for sequence in 0..10 {
            sample.push(&transmitter.slip(&SlipMessage { sequence, sensors: 1, ..SlipMessage::default() }));
            let input = SensorInput { piezo: Some(&piezo), xl: Some(&xl[..samples]), xl_end: 0 };
            let raw = RawFrame { timestamp_us: 0, sequence, sensor: 0, health: 0, input };
            transmitter.raw(&raw, &mut RawBuffer::new()).for_each(|frame| sample.push(&frame));
        }
        sample
    }

    #[test]
    fn the_longest_frame_by_trial_is_the_worst_case() {
        let ids = [(slip_id(0), 64), (raw_id(&ONE, 0), 64), (slip_id(3), 64), (raw_id(&COMPRESSED, 7), 48)];
        for (id, bytes) in ids {
            let (timing, dlc) = (timing(8_000_000), dlc_of(bytes, true).unwrap());
            let bound = worst_case(Some(Id::Extended(id)), true, Format::FD, dlc, &timing);
            assert_eq!(timing.frame(&longest_frame(id, bytes, &timing)), bound, "{id:X}");
        }
    }

    #[test]
    fn no_simulated_wait_exceeds_the_calculated_one_and_some_come_near() {
        for (nodes, foreign_percent, raw_every) in [(1, 0, 1), (1, 50, 1), (1, 100, 0), (3, 0, 1), (8, 30, 2)]
        {
            for raw_form in [ONE.raw_form, COMPRESSED.raw_form] {
                let asked = Plan { nodes, foreign_percent, raw_every, raw_form, ..ONE };
                for data_bps in [2_000_000, 5_000_000, 8_000_000] {
                    let found = planned(asked, data_bps).latency_worst;
                    assert!(found.simulated_us <= found.calculated_us, "{asked:?}: {found:?}");
                    assert!(found.simulated_us > 0.95 * found.calculated_us, "{asked:?}: {found:?}");
                }
            }
        }
    }

    #[test]
    fn a_bus_without_other_traffic_makes_nobody_wait() {
        let Latency { calculated_us, simulated_us } =
            planned(Plan { raw_every: 0, ..ONE }, 8_000_000).latency_worst;
        assert_eq!(calculated_us, simulated_us);
        assert!((125.0..135.0).contains(&calculated_us), "{calculated_us}");
    }

    #[test]
    fn no_data_make_a_compressed_message_longer_than_plain_by_more_than_its_shorter_frames_cost() {
        let frames = |of: &Plan| raw_lengths(of).len();
        // 1,641 bytes and 2 of CRC by 47, 1,636 and 2 by 63.
        assert_eq!((frames(&COMPRESSED), frames(&ONE)), (35, 26));
        assert_eq!(raw_lengths(&COMPRESSED).iter().max(), Some(&COMPRESSED_FRAME_BYTES));
    }

    #[test]
    fn load_is_proportional_to_what_is_sent() {
        let of = |asked| planned(asked, 8_000_000);
        let one = of(ONE);
        let (two, half) = (of(Plan { sensors: 2, ..ONE }), of(Plan { raw_every: 2, ..ONE }));
        assert!((two.exact.raw_percent - 2.0 * one.exact.raw_percent).abs() < 1e-9);
        assert!((half.worst.raw_percent - 0.5 * one.worst.raw_percent).abs() < 1e-9);
        assert_eq!(half.worst.slip_percent, one.worst.slip_percent);
        // Idle taxels are all stuff bits: 26 frames of 126.5 us and a pause, 240 times a second, and a little less.
        assert!((75.0..81.0).contains(&one.exact.raw_percent), "{one:?}");
        assert!(one.exact.total_percent < one.worst.total_percent);
    }
}
