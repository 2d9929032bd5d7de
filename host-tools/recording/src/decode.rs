//! Frames to messages of every node on the bus, and how many were lost.

use std::collections::BTreeMap;

use slipsense::node::{CALIBRATION_LINE, HEARTBEAT_PORT, RECORD_PORT};
use slipsense::params::MAX_SENSORS;
use slipsense::wire::{
    COMPRESSED_PORT, CanFrame, MessageId, NodeId, RAW_PORT, Received, Receiver, SLIP_1_PORT, SLIP_PORT,
    SlipMessage,
};

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
    /// One that the module itself gave up on a full bus is among them.
    pub raw_lost: u64,
    /// CAN frames that fit no transfer, damaged transfers and messages that do not decode.
    pub errors: u64,
    /// Starts of the module, seen by numbers that begin anew.
    pub restarts: u64,
}

struct Node {
    receiver: Box<Receiver>,
    sequence: Option<u32>,
    /// Slip messages that the receiver has counted as missed.
    slip_missed: u64,
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
        let ours = |id: &MessageId| matches!(id.port, SLIP_PORT | SLIP_1_PORT | RAW_PORT | COMPRESSED_PORT);
        let id = MessageId::from_can(frame.id()).ok().filter(ours);
        let Some(id) = id else {
            self.others += 1;
            return None;
        };
        let node = self.nodes.entry(id.node.get()).or_insert_with(|| Node {
            receiver: Box::new(Receiver::new(id.node)),
            sequence: None,
            slip_missed: 0,
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
        node.count.raw_lost = u64::from(node.receiver.missed()).saturating_sub(node.slip_missed);
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
        if let Some(last) = self.sequence {
            let gap = message.sequence.wrapping_sub(last.wrapping_add(1));
            if gap < u32::MAX / 2 {
                self.count.slip_lost += u64::from(gap);
                // Five bits of transfer identifier are all that the receiver sees.
                self.slip_missed += u64::from(gap % 32);
            } else {
                self.count.restarts += 1;
                // What it counted over the start means nothing.
                self.slip_missed = u64::from(self.receiver.missed()) - self.count.raw_lost;
            }
        }
        self.sequence = Some(message.sequence);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use slipsense::wire::Transmitter;

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
}
