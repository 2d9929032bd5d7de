//! The pair of wires at one FDCAN, the node at its far end, and what is done to them.

use std::collections::VecDeque;

use slipsense::wire::{CanFrame, ServiceRole, TransferId};
use slipsense_can_sim::{
    Attempt, BitTiming, Bus, Disturbance, Format, Frame, FrameBits, Id, Outcome, Timing,
};

use super::hostile::Hostile;
use crate::bench::mix;
use crate::fault_injection::{Faults, Kind};

/// The FDCAN among the two nodes.
pub const MCU: usize = 0;
/// Identifier of the frames that flood the bus: between the slip message's priority and the raw frames'.
const FLOOD_ID: u32 = 0x0C00_0001;
/// Everybody else, as one node.
pub const PEER: usize = 1;

#[derive(Clone, Debug)]
pub struct Logged {
    pub node: usize,
    /// Start of frame and end of frame or error delimiter, virtual nanoseconds.
    pub start_ns: u64,
    pub end_ns: u64,
    pub outcome: Outcome,
    pub frame: Frame,
}

impl Logged {
    /// The board sent it, and it arrived.
    pub fn is_of_board(&self) -> bool {
        self.node == MCU && self.outcome == Outcome::Sent
    }

    /// The port of a message or of a request. None that matters here is of both.
    pub fn port(&self) -> Option<u16> {
        match TransferId::from_can(can_frame(&self.frame)?.id()).ok()? {
            TransferId::Message(id) => Some(id.port),
            TransferId::Service(id) => (id.role == ServiceRole::Request).then_some(id.port),
            TransferId::Anonymous(_) => None,
        }
    }
}

/// A frame of the bus as the product's own library knows it.
pub fn can_frame(frame: &Frame) -> Option<CanFrame> {
    match frame.id() {
        Id::Extended(id) => CanFrame::new(id, frame.data()).ok(),
        Id::Standard(_) => None,
    }
}

#[derive(Debug)]
pub struct Wire {
    pub bus: Bus<2>,
    pub faults: Faults,
    /// RX follows TX.
    pub has_transceiver: bool,
    /// Frames that the peer sends, each not before its time, in order.
    pub peer_queue: VecDeque<(u64, Frame)>,
    pub log: Vec<Logged>,
    hostile: Hostile,
    random: u64,
}

/// Does another node have something to send whenever the bus is free?
fn never_rests(kind: Kind) -> bool {
    matches!(kind, Kind::Flood | Kind::Hostile)
}

/// Until software sets another; never used for a frame.
const UNSET: Timing = Timing {
    clock_hz: 1_000_000_000,
    nominal: BitTiming { prescaler: 1, seg1: 1, seg2: 1 },
    data: BitTiming { prescaler: 1, seg1: 1, seg2: 1 },
};

impl Default for Wire {
    fn default() -> Self {
        Self {
            bus: Bus::new(UNSET),
            faults: Faults::default(),
            has_transceiver: true,
            peer_queue: VecDeque::new(),
            log: Vec::new(),
            hostile: Hostile::default(),
            random: 0x9E37_79B9_7F4A_7C15,
        }
    }
}

impl Wire {
    fn cycles(&self, now_ns: u64) -> u64 {
        (u128::from(now_ns) * u128::from(self.bus.timing().clock_hz) / 1_000_000_000) as u64
    }

    /// Virtual nanoseconds of an instant of the bus.
    pub fn ns(&self, cycles: u64) -> u64 {
        self.bus.timing().ns(cycles)
    }

    /// The FDCAN starts with these timings and joins after 11 recessive bits; a node that was off first waits for
    /// its recovery. The peer has the same timings. Returns when the recovery is over, if one is due.
    pub fn join(&mut self, now_ns: u64, timing: Timing) -> Option<u64> {
        if *self.bus.timing() != timing {
            self.bus.set_timing(timing, 0);
        }
        let now = self.cycles(now_ns);
        self.bus.hold(MCU, now + 11 * u64::from(timing.nominal.cycles()));
        self.bus.request_recovery(MCU, now);
        self.returns()
    }

    /// When the FDCAN's recovery from bus-off is over, as far as is known.
    pub fn returns(&self) -> Option<u64> {
        self.bus.returns(MCU).map(|at| self.ns(at))
    }

    /// Lets time pass without a frame, so that a recovery ends.
    pub fn advance(&mut self, now_ns: u64) {
        let now = self.cycles(now_ns);
        self.bus.advance(now);
    }

    /// The node that sends without a pause, if there is one.
    fn busy_peer(&self, now_ns: u64) -> Option<Kind> {
        self.faults.active(now_ns).find(|kind| never_rests(*kind))
    }

    /// When a frame may start that the FDCAN offers or not from `now_ns` on: the earliest instant at which the bus
    /// is free for somebody who has something to send.
    pub fn next_start(&self, now_ns: u64, offered: bool) -> Option<u64> {
        let mine = if offered { self.bus.ready(MCU) } else { None };
        let mine = mine.map(|ready| self.ns(ready).max(now_ns));
        let free = self.bus.ready(PEER).map_or(0, |ready| self.ns(ready)).max(now_ns);
        let due = self.peer_queue.front().map(|(at, _)| (*at).max(free));
        let next = || self.faults.after(free).iter().find(|fault| never_rests(fault.kind));
        let busy =
            if self.busy_peer(free).is_some() { Some(free) } else { next().map(|fault| fault.when.start) };
        [mine, due, busy].into_iter().flatten().min()
    }

    pub fn start(&mut self, now_ns: u64, mine: Option<&Frame>) -> Option<(Attempt, Frame)> {
        let due = self.peer_queue.front().filter(|(at, _)| *at <= now_ns).map(|(_, frame)| *frame);
        let busy = self.busy_peer(now_ns).filter(|_| due.is_none());
        let theirs = match busy {
            Some(Kind::Hostile) => self.hostile.front(),
            Some(_) => Frame::new(Id::Extended(FLOOD_ID), Format::FD, &[0x55; 64]).ok(),
            None => due,
        };
        let now = self.cycles(now_ns);
        // Who is not ready now does not compete; the bus would otherwise make the frame wait for them.
        let ready =
            |node, frame: Option<Frame>| frame.filter(|_| self.bus.ready(node).is_some_and(|at| at <= now));
        let (mine, theirs) = (ready(MCU, mine.copied()), ready(PEER, theirs));
        let longest =
            [&mine, &theirs].into_iter().flatten().map(|frame| FrameBits::of(frame).total()).max()?;
        let disturbance = self.disturbance(now_ns, longest);
        let attempt = self.bus.attempt(now, &[mine.as_ref(), theirs.as_ref()], disturbance).ok()??;
        let frame = if attempt.node == MCU { mine? } else { theirs? };
        if attempt.node == PEER && attempt.outcome == Outcome::Sent {
            match busy {
                Some(Kind::Hostile) => self.hostile.sent(),
                Some(_) => {}
                None => _ = self.peer_queue.pop_front(),
            }
        }
        self.log.push(Logged {
            node: attempt.node,
            start_ns: now_ns,
            end_ns: self.ns(attempt.end),
            outcome: attempt.outcome,
            frame,
        });
        Some((attempt, frame))
    }

    fn disturbance(&mut self, now_ns: u64, bits: u32) -> Disturbance {
        let faults: Vec<Kind> = self.faults.active(now_ns).collect();
        let mut disturbance = Disturbance::default();
        for fault in faults {
            match fault {
                Kind::NoAcknowledge => disturbance.no_acknowledge = true,
                Kind::ErrorFrames { per_million } if self.below(1_000_000) < per_million => {
                    disturbance.wrong_bit = Some(self.below(bits));
                }
                _ => {}
            }
        }
        disturbance
    }

    /// Splitmix64: any generator will do, every run draws the same.
    fn below(&mut self, bound: u32) -> u32 {
        self.random = self.random.wrapping_add(0x9E37_79B9_7F4A_7C15);
        (mix(self.random) % u64::from(bound)) as u32
    }
}
