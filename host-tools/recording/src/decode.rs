//! Frames to messages of every node on the bus, and how many were lost.

use std::collections::BTreeMap;

use slipsense::node::{CALIBRATION_LINE, HEARTBEAT_PORT, RECORD_PORT};
use slipsense::params::MAX_SENSORS;
use slipsense::wire::{CanFrame, MessageId, NodeId, Received, Receiver, SlipMessage};

use crate::candump::message_id;

/// `uavcan.node.Heartbeat`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Heartbeat {
    pub uptime_s: u32,
    /// As [`slipsense::health::Condition`].
    pub health: u8,
    /// As [`slipsense::node::Mode`].
    pub mode: u8,
    /// Bits of [`slipsense::node::vendor_status`].
    pub flags: u8,
}

/// A heartbeat and its node.
pub fn heartbeat(frame: &CanFrame) -> Option<(NodeId, Heartbeat)> {
    let id = MessageId::from_can(frame.id()).ok().filter(|id| id.port == HEARTBEAT_PORT)?;
    let (uptime, rest) = frame.data().split_first_chunk()?;
    let &[health, mode, flags, _tail, ..] = rest else { return None };
    Some((id.node, Heartbeat { uptime_s: u32::from_le_bytes(*uptime), health, mode, flags }))
}

/// By which calibration a sensor's array is read, as its node says again and again: node, sensor, and version and name of
/// the calibration, or `none`.
pub fn calibration(frame: &CanFrame) -> Option<(NodeId, usize, &str)> {
    let id = MessageId::from_can(frame.id()).ok().filter(|id| id.port == RECORD_PORT)?;
    // Time, severity, length and text of uavcan.diagnostic.Record, in one frame.
    let text = frame.data().get(9..9 + usize::from(*frame.data().get(8)?))?;
    let line = std::str::from_utf8(text).ok()?.strip_prefix(CALIBRATION_LINE)?;
    let (sensor, calibration) = line.trim_start().split_once(": ")?;
    Some((id.node, sensor.parse().ok().filter(|&sensor| sensor < MAX_SENSORS)?, calibration))
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Decoded {
    pub node: NodeId,
    pub message: Received,
}

/// What came from one node.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Count {
    pub slip: u64,
    /// Slip messages that did not come, by the numbers of those that did.
    pub slip_lost: u64,
    pub raw: u64,
    /// Raw messages that did not come, by their transfer identifiers: right while fewer than 32 in a row are lost.
    /// One that the module itself gave up on a full bus is among them; what is lost at a start of the module is not.
    pub raw_lost: u64,
    /// CAN frames that fit no transfer, damaged transfers and messages that do not decode.
    pub errors: u64,
    /// Starts of the module, which it counts; without its supply it forgets them, and the numbers of its frames go back.
    pub restarts: u64,
}

struct Node {
    receiver: Box<Receiver>,
    /// Start of the module and number of the frame, of the last slip message.
    last: Option<(u8, u32)>,
    count: Count,
}

/// Puts the slip and raw messages of all nodes together.
#[derive(Default)]
pub struct Decoder {
    nodes: BTreeMap<u8, Node>,
    /// Frames of other messages.
    pub others: u64,
}

impl Decoder {
    pub fn new() -> Self {
        Self::default()
    }

    /// Take a frame; `Some` when it completes a message.
    pub fn accept(&mut self, frame: &CanFrame) -> Option<Decoded> {
        let Some(id) = message_id(frame) else {
            self.others += 1;
            return None;
        };
        let node = self.nodes.entry(id.node.get()).or_insert_with(|| Node {
            receiver: Box::new(Receiver::new(id.node)),
            last: None,
            count: Count::default(),
        });
        let Ok(received) = node.receiver.accept(frame) else {
            node.count.errors += 1;
            return None;
        };
        let message = received?;
        match &message {
            Received::Slip(slip) => node.slip(slip),
            Received::Raw(_) => node.count.raw += 1,
        }
        node.count.raw_lost = node.receiver.missed_raw().into();
        Some(Decoded { node: id.node, message })
    }

    /// What came from each node, by address.
    pub fn counts(&self) -> BTreeMap<u8, Count> {
        self.nodes.iter().map(|(&node, state)| (node, state.count)).collect()
    }
}

impl Node {
    fn slip(&mut self, message: &SlipMessage) {
        self.count.slip += 1;
        if let Some((starts, last)) = self.last.replace((message.starts, message.sequence)) {
            let gap = message.sequence.wrapping_sub(last.wrapping_add(1));
            if starts == message.starts && gap < u32::MAX / 2 {
                self.count.slip_lost += u64::from(gap);
            } else {
                self.count.restarts += 1;
                self.receiver.restart_raw();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use slipsense::sensor::SensorInput;
    use slipsense::wire::{RawBuffer, RawFrame, Transmitter};

    fn slips(numbers: impl IntoIterator<Item = u32>) -> Count {
        let mut decoder = Decoder::new();
        for sequence in numbers {
            let message = SlipMessage { sequence, sensors: 1, ..SlipMessage::default() };
            let mut transmitter = Transmitter::new(NodeId::DEFAULT);
            for _ in 0..sequence % 32 {
                transmitter.slip(&message);
            }
            decoder.accept(&transmitter.slip(&message));
        }
        decoder.counts()[&42]
    }

    #[test]
    fn lost_slip_messages_are_counted_by_their_numbers_and_a_restart_is_none() {
        let none = Count { slip: 100, ..Count::default() };
        assert_eq!(slips(0..100), none);
        assert_eq!(
            slips((0..100).filter(|n| !(10..75).contains(n))),
            Count { slip: 35, slip_lost: 65, ..none }
        );
        assert_eq!(slips((u32::MAX - 4..=u32::MAX).chain(0..5)), Count { slip: 10, ..none });
        assert_eq!(slips((500..510).chain(0..10)), Count { slip: 20, restarts: 1, ..none });
    }

    /// What comes of starts of a module: how often it has started, the frames that it has not dropped, and of these those
    /// whose raw message is lost.
    fn starts(starts: &[(u8, &[u32], &[u32])]) -> Count {
        let (mut decoder, mut buffer) = (Decoder::new(), RawBuffer::new());
        for &(starts, sequences, lost) in starts {
            let mut transmitter = Transmitter::new(NodeId::DEFAULT);
            for &sequence in sequences {
                let message = SlipMessage { sequence, starts, sensors: 1, ..SlipMessage::default() };
                decoder.accept(&transmitter.slip(&message));
                let input = SensorInput { piezo: None, xl: Some(&[[1, 2, 3]]), xl_end: sequence };
                let raw = RawFrame { timestamp_us: 0, sequence, sensor: 0, health: 0, input };
                let kept = transmitter.raw(&raw, &mut buffer).filter(|_| !lost.contains(&sequence));
                kept.for_each(|frame| _ = decoder.accept(&frame));
            }
        }
        decoder.counts()[&42]
    }

    #[test]
    fn raw_messages_are_counted_apart_from_slip_messages_and_from_start_to_start() {
        let numbers: Vec<u32> = (0..100).collect();
        let none = Count { slip: 200, raw: 200, restarts: 1, ..Count::default() };
        // The second time its supply went, and with it the count of its starts.
        for second in [2, 1] {
            assert_eq!(starts(&[(1, &numbers, &[]), (second, &numbers, &[])]), none);
        }
        assert_eq!(
            starts(&[(1, &numbers, &[]), (2, &numbers[1..], &[])]),
            Count { slip: 199, raw: 199, ..none }
        );
        let lost = Count { raw: 196, raw_lost: 4, ..none };
        assert_eq!(starts(&[(1, &numbers, &[7, 8]), (2, &numbers, &[50, 60])]), lost);
        // Numbers that go on from those of the start before.
        let more = Count { slip: 70, raw: 70, ..none };
        assert_eq!(starts(&[(1, &numbers[..20], &[]), (2, &numbers[50..], &[])]), more);
    }

    #[test]
    fn frames_that_the_module_drops_hide_no_lost_raw_message() {
        let kept: Vec<u32> = (0..100).filter(|n| !(10..20).contains(n)).collect();
        let count = Count { slip: 90, slip_lost: 10, raw: 87, raw_lost: 3, ..Count::default() };
        assert_eq!(starts(&[(1, &kept, &[30, 31, 32])]), count);
    }
}
