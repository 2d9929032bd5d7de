//! Several nodes on one pair of wires: who sends, what becomes of it, when the bus is free again.

use crate::confinement::{ErrorState, FaultConfinement, RECOVERY_BITS};
use crate::frame::Frame;
use crate::timing::Timing;
use crate::wire_bits::{Field, Rate, wire_bits};

const ERROR_FLAG: u32 = 6;
/// The others' flags start at the sixth bit of the first at the latest.
const ECHOED_FLAG: u32 = 6;
const ERROR_DELIMITER: u32 = 8;
/// What an error-passive transmitter waits beyond the intermission.
const SUSPEND: u32 = 8;

/// Two nodes sent the same arbitration field at once, which no bus may have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Collision {
    /// The nodes, by index.
    pub nodes: (usize, usize),
}

/// What is done to one attempt to send.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Disturbance {
    /// Bit of the frame, counted from start of frame with stuff bits, that arrives wrong everywhere. Beyond the
    /// end of the frame nothing happens.
    pub wrong_bit: Option<u32>,
    pub no_acknowledge: bool,
}

/// How an attempt ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Every other node on the bus has the frame.
    Sent,
    NotAcknowledged,
    /// Stopped by an error flag in this field.
    Error(Field),
}

/// An attempt to send a frame, in cycles of the bus's clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Attempt {
    pub node: usize,
    pub start: u64,
    /// End of frame, or of the error delimiter.
    pub end: u64,
    pub outcome: Outcome,
}

/// A bus with `N` nodes that all hear each other. Time is in cycles of `timing`'s clock, and never goes back.
#[derive(Clone, Debug)]
pub struct Bus<const N: usize> {
    timing: Timing,
    nodes: [FaultConfinement; N],
    /// From when each node may start a frame.
    ready: [u64; N],
    /// When each bus-off node may return; `u64::MAX` until its software asks.
    returns: [u64; N],
}

impl<const N: usize> Bus<N> {
    /// A quiet bus. All nodes are there and acknowledge.
    pub const fn new(timing: Timing) -> Self {
        Self { timing, nodes: [FaultConfinement::new(); N], ready: [0; N], returns: [u64::MAX; N] }
    }

    pub const fn timing(&self) -> &Timing {
        &self.timing
    }

    /// Other bit timings, as when a node's are set after reset. Counters stay; the bus is free from `now` on.
    pub fn set_timing(&mut self, timing: Timing, now: u64) {
        self.timing = timing;
        (self.ready, self.returns) = ([now; N], [u64::MAX; N]);
    }

    /// A node that joins has to see 11 recessive bits first: it starts no frame before this cycle.
    pub fn hold(&mut self, node: usize, until: u64) {
        self.ready[node] = self.ready[node].max(until);
    }

    /// When a node that is off may return, as far as is known: frames of others move it. `None`: it is not on its
    /// way.
    pub const fn returns(&self, node: usize) -> Option<u64> {
        match self.returns[node] {
            u64::MAX => None,
            at => Some(at),
        }
    }

    pub const fn node(&self, node: usize) -> &FaultConfinement {
        &self.nodes[node]
    }

    /// The software of a node that is off asks to return: after 128 times 11 recessive bits, of which the idle
    /// bus gives one after the other.
    pub fn request_recovery(&mut self, node: usize, now: u64) {
        if self.nodes[node].state() == ErrorState::BusOff && self.returns[node] == u64::MAX {
            let quiet = now.max(self.ready.iter().copied().filter(|&at| at != u64::MAX).max().unwrap_or(0));
            self.returns[node] = quiet + RECOVERY_BITS * u64::from(self.timing.nominal.cycles());
        }
    }

    /// Nodes whose recovery is over by `now` are back. Every frame in between is an interruption in which only its
    /// end is 11 recessive bits, so [`Self::attempt`] moves the return by the time that the frame took.
    pub fn advance(&mut self, now: u64) {
        for node in 0..N {
            if self.returns[node] <= now {
                self.nodes[node].recovered();
                self.ready[node] = self.returns[node];
                self.returns[node] = u64::MAX;
            }
        }
    }

    /// May this node start a frame at some time, and from when?
    pub fn ready(&self, node: usize) -> Option<u64> {
        (self.nodes[node].state() != ErrorState::BusOff).then_some(self.ready[node])
    }

    /// The next frame on the bus at or after `now`, given what each node has to send from `now` on. All that may
    /// start at the first possible instant compete. `None`: nobody can send. Two nodes of equal arbitration field
    /// destroy each other's frames for ever, so that is an error.
    pub fn attempt(
        &mut self,
        now: u64,
        offered: &[Option<&Frame>; N],
        disturbance: Disturbance,
    ) -> Result<Option<Attempt>, Collision> {
        self.advance(now);
        let able = |node: usize| offered[node].and(self.ready(node)).map(|ready| ready.max(now));
        let Some(start) = (0..N).filter_map(able).min() else { return Ok(None) };
        let competing = (0..N).filter(|&node| able(node) == Some(start));
        let mut fields = competing.filter_map(|node| Some((offered[node]?.arbitration_field(), node)));
        // The lowest arbitration field goes on.
        let Some((field, node)) = fields.clone().min() else { return Ok(None) };
        if let Some((_, other)) = fields.find(|&(equal, other)| equal == field && other != node) {
            return Err(Collision { nodes: (node, other) });
        }
        let Some(frame) = offered[node] else { return Ok(None) };
        Ok(Some(self.send(node, start, frame, disturbance)))
    }

    fn send(&mut self, node: usize, start: u64, frame: &Frame, disturbance: Disturbance) -> Attempt {
        let hears = |other: usize| other != node && self.ready(other).is_some();
        let acknowledged = !disturbance.no_acknowledge && (0..N).any(hears);
        let mut end = start;
        let mut outcome = Outcome::Sent;
        let mut index = 0;
        wire_bits(frame, |bit| {
            if outcome != Outcome::Sent {
                return;
            }
            end += u64::from(self.timing.bit(bit.rate));
            if disturbance.wrong_bit == Some(index) {
                outcome = Outcome::Error(bit.field);
                // The error flag starts with the next bit, at the nominal rate from this bit's sample point on.
                if matches!(bit.rate, Rate::Data | Rate::ToData) {
                    let (nominal, data) = (self.timing.nominal, self.timing.data);
                    end = end - u64::from(data.after_sample()) + u64::from(nominal.after_sample());
                }
            } else if bit.field == Field::AckSlot && !acknowledged {
                outcome = Outcome::NotAcknowledged;
            }
            index += 1;
        });
        let passive = self.nodes[node].state() == ErrorState::Passive;
        if outcome != Outcome::Sent {
            // Six equal bits break the others' stuffing rule, and they answer with a flag of their own. Nobody answers
            // a passive flag after a missing acknowledge: to the others it is the end of a good frame.
            let silent = passive && outcome == Outcome::NotAcknowledged;
            let answered = !silent && (0..N).any(hears);
            let flags = if answered { ERROR_FLAG + ECHOED_FLAG } else { ERROR_FLAG };
            end += self.nominal(flags + ERROR_DELIMITER);
        }
        self.count(node, outcome);
        self.occupy(node, start, end);
        Attempt { node, start, end, outcome }
    }

    fn count(&mut self, sender: usize, outcome: Outcome) {
        for node in 0..N {
            if node != sender && self.ready(node).is_none() {
                continue;
            }
            let counters = &mut self.nodes[node];
            match (outcome, node == sender) {
                (Outcome::Sent, true) => counters.transmitted(),
                (Outcome::Sent, false) => counters.received(),
                (Outcome::NotAcknowledged, true) => counters.not_acknowledged(),
                (Outcome::NotAcknowledged, false) => {}
                (Outcome::Error(_), true) => counters.transmit_error(),
                (Outcome::Error(_), false) => counters.receive_error(),
            }
        }
    }

    fn occupy(&mut self, sender: usize, start: u64, end: u64) {
        let free = end + self.timing.intermission();
        for (node, ready) in self.ready.iter_mut().enumerate() {
            let passive = self.nodes[node].state() == ErrorState::Passive;
            let suspend = if node == sender && passive { SUSPEND } else { 0 };
            *ready = free + u64::from(suspend) * u64::from(self.timing.nominal.cycles());
        }
        // ACK delimiter, end of frame and intermission of a frame are 11 recessive bits, one step of the way back.
        let step = self.nominal(11);
        for returns in self.returns.iter_mut().filter(|at| **at != u64::MAX) {
            *returns += (free - start).saturating_sub(step);
        }
    }

    fn nominal(&self, bits: u32) -> u64 {
        u64::from(bits) * u64::from(self.timing.nominal.cycles())
    }
}
