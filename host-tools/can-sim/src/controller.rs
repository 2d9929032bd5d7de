//! A CAN FD bus in virtual time, as the scheduler above the hardware sees it: three slots, arbitration by
//! identifier, and what can go wrong on a bus.
//!
//! The bus carries one frame at a time. Whenever it is free, of all frames that wait, ours and other nodes', the
//! smallest identifier goes. Other nodes' frames are full ones, evenly spread, of an identifier between the slip
//! message's and the raw messages': a bus that they fill leaves the raw messages nothing.
//!
//! Simplified: a destroyed frame is destroyed at its end, receive errors are not counted, and every frame has the
//! stuff bits of the worst case.
mod times;

use core::ops::Range;

use slipsense::board::TxSlot;
use slipsense::health::{CanState, CanStatus};
use slipsense::wire::{CanFrame, MessageId, NodeId, Priority};

use crate::{ErrorState, FaultConfinement};
pub use crate::{Timing, TimingError};
use times::Times;

/// What goes on besides our frames. Times are nanoseconds since start.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Disturbance {
    /// Share of the bus's time that other nodes' frames ask for, percent.
    pub foreign_load_percent: u64,
    /// Every n-th of our transmissions is destroyed by an error; 0: none.
    pub error_every: u32,
    /// Nobody acknowledges.
    pub silent_ns: Range<u64>,
    /// The bus is held dominant: the node goes off it at once, and rejoins after the end.
    pub dominant_ns: Range<u64>,
}

/// A frame of ours that has arrived.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Arrived {
    /// When its last bit had gone, nanoseconds.
    pub at_ns: u64,
    pub handed_over_ns: u64,
    pub slot: TxSlot,
    pub frame: CanFrame,
}

/// Data of other nodes' frames, bytes.
const FOREIGN_BYTES: usize = 64;
const FOREIGN_ID: u32 =
    MessageId { priority: Priority::Nominal, port: 1000, node: NodeId::new(1).unwrap() }.to_can();

#[derive(Clone, Copy, Debug)]
struct Slot {
    frame: CanFrame,
    since_ns: u64,
    taken_back: bool,
}

#[derive(Clone, Copy, Debug)]
struct OnWire {
    /// Of our frame; `None`: it is another node's.
    slot: Option<TxSlot>,
    ends_ns: u64,
    /// How its failure counts; `None`: it arrives.
    fault: Option<fn(&mut FaultConfinement)>,
}

/// The bus and our node's hardware on it.
#[derive(Clone, Debug)]
pub struct Bus {
    times: Times,
    disturbance: Disturbance,
    slots: [Option<Slot>; TxSlot::ALL.len()],
    /// Has the slot's last frame arrived?
    sent: [bool; TxSlot::ALL.len()],
    wire: Option<OnWire>,
    free_ns: u64,
    /// When the next frame of another node is there to be sent.
    foreign_ns: u64,
    transmissions: u32,
    confinement: FaultConfinement,
    /// The node takes no part before.
    off_until_ns: Option<u64>,
    was_dominant: bool,
}

impl Bus {
    /// At time 0, without a frame.
    pub fn new(timing: &Timing, disturbance: Disturbance) -> Self {
        Self {
            times: Times::new(timing),
            disturbance,
            slots: [None; TxSlot::ALL.len()],
            sent: [false; TxSlot::ALL.len()],
            wire: None,
            free_ns: 0,
            foreign_ns: 0,
            transmissions: 0,
            confinement: FaultConfinement::new(),
            off_until_ns: None,
            was_dominant: false,
        }
    }

    /// From now on this goes on besides our frames, instead of what did.
    pub fn disturb(&mut self, disturbance: Disturbance) {
        self.disturbance = disturbance;
        self.was_dominant = false;
    }

    pub const fn is_free(&self, tx_slot: TxSlot) -> bool {
        self.slots[tx_slot as usize].is_none()
    }

    /// Has the slot's last frame arrived, even if it was to be taken back?
    pub const fn has_sent(&self, tx_slot: TxSlot) -> bool {
        self.sent[tx_slot as usize]
    }

    /// Put a frame in; the slot must be free.
    pub fn put(&mut self, tx_slot: TxSlot, frame: &CanFrame, now_ns: u64) {
        debug_assert!(self.is_free(tx_slot), "{tx_slot:?} still holds a frame");
        self.slots[tx_slot as usize] = Some(Slot { frame: *frame, since_ns: now_ns, taken_back: false });
        self.sent[tx_slot as usize] = false;
    }

    /// Take a frame back: at once, or when its transmission under way has failed.
    pub fn withdraw(&mut self, tx_slot: TxSlot) {
        let slot = &mut self.slots[tx_slot as usize];
        match (&self.wire, slot.as_mut()) {
            (Some(OnWire { slot: Some(on_wire), .. }), Some(held)) if *on_wire == tx_slot => {
                held.taken_back = true;
            }
            _ => *slot = None,
        }
    }

    pub fn status(&self) -> CanStatus {
        let state = match self.confinement.state() {
            _ if self.off_until_ns.is_some() => CanState::BusOff,
            ErrorState::BusOff => CanState::BusOff,
            ErrorState::Passive => CanState::ErrorPassive,
            ErrorState::Active if self.confinement.warns() => CanState::Warning,
            ErrorState::Active => CanState::ErrorActive,
        };
        let counter = |count: u16| count.min(255) as u8;
        CanStatus {
            state,
            transmit_errors: counter(self.confinement.transmit_errors()),
            receive_errors: counter(self.confinement.receive_errors()),
        }
    }

    /// Let time pass; `arrived` gets every frame of ours that arrives meanwhile.
    pub fn advance(&mut self, now_ns: u64, mut arrived: impl FnMut(Arrived)) {
        loop {
            self.hold_dominant(now_ns);
            if let Some(until) = self.off_until_ns.filter(|&until| until <= now_ns) {
                self.off_until_ns = None;
                self.confinement.recovered();
                self.free_ns = self.free_ns.max(until);
            }
            match self.wire {
                Some(wire) if wire.ends_ns > now_ns => return,
                Some(wire) => {
                    self.wire = None;
                    self.free_ns = wire.ends_ns;
                    if let Some(tx_slot) = wire.slot {
                        self.ended(tx_slot, wire, &mut arrived);
                    }
                }
                None => {
                    let Some((starts_ns, slot)) = self.next_start().filter(|&(starts, _)| starts <= now_ns)
                    else {
                        return;
                    };
                    self.start(slot, starts_ns);
                }
            }
        }
    }

    /// When something happens next of which our node notices anything, if nothing is put in before.
    pub fn next_event_ns(&self) -> Option<u64> {
        let dominant = Some(self.disturbance.dominant_ns.start)
            .filter(|_| !self.was_dominant && !self.disturbance.dominant_ns.is_empty());
        let pending = self.slots.iter().any(Option::is_some);
        let traffic = match self.wire {
            Some(wire) => Some(wire.ends_ns),
            None => self.next_start().map(|(starts_ns, _)| starts_ns),
        };
        [dominant, self.off_until_ns, traffic.filter(|_| pending)].into_iter().flatten().min()
    }

    fn hold_dominant(&mut self, now_ns: u64) {
        let Range { start, end } = self.disturbance.dominant_ns;
        if self.was_dominant || start >= end || now_ns < start {
            return;
        }
        if self.wire.is_some_and(|wire| wire.ends_ns <= start) {
            // What ends before is ended first.
            return;
        }
        self.was_dominant = true;
        self.wire = None;
        self.free_ns = end;
        self.foreign_ns = self.foreign_ns.max(end);
        self.off_until_ns = Some(end + self.recovery_ns());
    }

    fn recovery_ns(&self) -> u64 {
        self.times.recovery(self.disturbance.foreign_load_percent, FOREIGN_BYTES)
    }

    /// When the next frame starts, and from which of our slots; `None`: another node's.
    fn next_start(&self) -> Option<(u64, Option<TxSlot>)> {
        let foreign = (self.disturbance.foreign_load_percent > 0).then(|| self.foreign_ns.max(self.free_ns));
        let ready = |slot: &Slot| slot.since_ns.max(self.free_ns).max(self.off_until_ns.unwrap_or(0));
        let own = self.slots.iter().flatten().map(ready).min();
        let starts_ns = [foreign, own].into_iter().flatten().min()?;
        let slots = TxSlot::ALL
            .iter()
            .zip(&self.slots)
            .filter_map(|(&tx_slot, slot)| Some((tx_slot, slot.as_ref()?)));
        let waiting = slots.filter(|(_, slot)| ready(slot) <= starts_ns);
        let first = waiting.min_by_key(|(_, slot)| slot.frame.id());
        let foreign_waits = foreign.is_some_and(|ready| ready <= starts_ns);
        let goes = first.filter(|(_, slot)| !foreign_waits || slot.frame.id() < FOREIGN_ID);
        Some((starts_ns, goes.map(|(tx_slot, _)| tx_slot)))
    }

    fn start(&mut self, slot: Option<TxSlot>, starts_ns: u64) {
        let (bytes, fault) = match slot {
            None => {
                let period = self.times.frame(FOREIGN_BYTES) * 100 / self.disturbance.foreign_load_percent;
                self.foreign_ns = self.foreign_ns.max(starts_ns.saturating_sub(period)) + period;
                (FOREIGN_BYTES, None)
            }
            Some(tx_slot) => {
                self.transmissions = self.transmissions.wrapping_add(1);
                let every = self.disturbance.error_every;
                let fault: Option<fn(&mut FaultConfinement)> =
                    if self.disturbance.silent_ns.contains(&starts_ns) {
                        Some(FaultConfinement::not_acknowledged)
                    } else if self.transmissions.checked_rem(every) == Some(0) {
                        Some(FaultConfinement::transmit_error)
                    } else {
                        None
                    };
                let bytes = self.slots[tx_slot as usize].as_ref().map_or(0, |slot| slot.frame.data().len());
                (bytes, fault)
            }
        };
        let error_ns = if fault.is_some() { self.times.error() } else { 0 };
        let ends_ns = starts_ns + self.times.frame(bytes) + error_ns;
        self.wire = Some(OnWire { slot, ends_ns, fault });
    }

    fn ended(&mut self, tx_slot: TxSlot, wire: OnWire, arrived: &mut impl FnMut(Arrived)) {
        let Some(slot) = self.slots[tx_slot as usize] else { return };
        match wire.fault {
            None => {
                self.confinement.transmitted();
                self.slots[tx_slot as usize] = None;
                self.sent[tx_slot as usize] = true;
                let Slot { frame, since_ns: handed_over_ns, .. } = slot;
                arrived(Arrived { at_ns: wire.ends_ns, handed_over_ns, slot: tx_slot, frame });
            }
            Some(fault) => {
                fault(&mut self.confinement);
                if slot.taken_back {
                    self.slots[tx_slot as usize] = None;
                }
                if self.confinement.state() == ErrorState::BusOff {
                    self.off_until_ns = Some(wire.ends_ns + self.recovery_ns());
                }
            }
        }
    }
}
