//! From the messages that wait to the bus: which frame the hardware gets next.
//!
//! The hardware holds one frame of each slot, so what goes next is decided as late as can be: a slip message waits for the
//! frame that is on the wire and for nothing else of this node. A slot is filled again within the time that CAN leaves
//! between frames, about 3 µs at 1 Mbit/s, so one raw frame at a time does not leave the bus idle.
//!
//! A heartbeat overtakes all other service frames, the one that the hardware holds included: whoever fills the bus with
//! frames of higher priority than an answer must not silence it.
//!
//! Off the bus, only the newest slip message is kept; service frames wait, raw messages are dropped. A slip message
//! that the hardware could not send before the next one came is taken back: nobody gets an old one later.

use embassy_futures::select::select;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_sync::zerocopy_channel::Receiver;

use super::{Shared, Task};
use crate::board::{CanTransmit, Clock, TxSlot};
use crate::health::{CanState, CanStatus};
use crate::wire::{CanFrame, RawTransfer};

/// The transmit task. It belongs on an executor above inference, which would leave the bus idle for a whole step of
/// the pipeline otherwise.
pub struct Transmission<'a, M: RawMutex, T, C> {
    /// The bus.
    pub bus: T,
    clock: C,
    shared: &'a Shared<M>,
    raw: Receiver<'a, M, RawTransfer>,
    /// Has the first CAN frame of the first raw message gone?
    begun: bool,
    /// Was the slip message that the hardware holds, or held, taken back?
    slip_given_up: bool,
    /// The service frame, but for heartbeats, that has not gone yet; does the hardware hold it, and was it taken back?
    service: Option<CanFrame>,
    service_held: bool,
    service_given_up: bool,
    /// When the node was seen to be off the bus; `None` once a slip message has been handed over since.
    off_since_us: Option<u64>,
    status: CanStatus,
}

impl<'a, M: RawMutex, T: CanTransmit, C: Clock> Transmission<'a, M, T, C> {
    /// Before the first message. `raw` is the other end of inference's queue.
    pub fn new(bus: T, clock: C, shared: &'a Shared<M>, raw: Receiver<'a, M, RawTransfer>) -> Self {
        Self {
            bus,
            clock,
            shared,
            raw,
            begun: false,
            slip_given_up: false,
            service: None,
            service_held: false,
            service_given_up: false,
            off_since_us: None,
            status: CanStatus::default(),
        }
    }

    /// Raw messages that wait or are under way.
    pub fn waiting_raw(&self) -> usize {
        self.raw.len()
    }

    /// Transmit for ever.
    pub async fn run(&mut self) -> ! {
        loop {
            self.serve().await;
        }
    }

    /// Hand over what there is room for, then wait until there is more or the bus has changed.
    pub async fn serve(&mut self) {
        self.shared.progress.made(Task::Transmit);
        self.update_bus_status();
        if self.status.state == CanState::BusOff {
            self.drop_raw();
        } else if self.fill_slots() {
            return;
        }
        select(self.bus.changed(), self.shared.wait_tx()).await;
    }

    fn update_bus_status(&mut self) {
        let status = self.bus.status();
        if status == self.status {
            return;
        }
        let dropped_off = status.state == CanState::BusOff && self.status.state != CanState::BusOff;
        self.status = status;
        self.shared.update_status(|shared| {
            shared.can = status;
            if dropped_off {
                shared.bus_offs = shared.bus_offs.saturating_add(1);
            }
        });
        if dropped_off {
            // A second time before a slip message could go belongs to the first.
            self.off_since_us.get_or_insert(self.clock.now_us());
            self.give_up_all();
        }
    }

    /// Take back what the hardware holds.
    fn give_up_all(&mut self) {
        self.slip_given_up |= !self.bus.is_free(TxSlot::Slip);
        // With the one that made way for a heartbeat.
        let waits = self.service.take().is_some() && !core::mem::take(&mut self.service_held);
        let lost = u32::from(waits) + u32::from(!self.bus.is_free(TxSlot::Service));
        self.shared.update_status(|status| status.lost_services = status.lost_services.saturating_add(lost));
        self.service_given_up = false;
        TxSlot::ALL.iter().for_each(|&slot| self.bus.withdraw(slot));
    }

    /// Give each free slot its next frame; `false`: there was none to give.
    fn fill_slots(&mut self) -> bool {
        let mut filled = false;
        let service_is_free = self.service_is_free();
        if !self.bus.is_free(TxSlot::Slip) && self.shared.slip_waits() {
            // A frame period has gone by since that one was handed over.
            self.bus.withdraw(TxSlot::Slip);
            self.slip_given_up = true;
        }
        if self.bus.is_free(TxSlot::Slip) {
            if core::mem::take(&mut self.slip_given_up) && !self.bus.has_sent(TxSlot::Slip) {
                self.shared
                    .update_status(|status| status.replaced_slips = status.replaced_slips.saturating_add(1));
            }
            if let Some(slip) = self.shared.take_slip() {
                filled = self.hand_over(TxSlot::Slip, &slip);
                self.back_on_bus();
            }
        }
        filled |= service_is_free && self.fill_service();
        if self.bus.is_free(TxSlot::Raw)
            && let Some(frame) = self.next_raw()
        {
            filled = self.hand_over(TxSlot::Raw, &frame);
        }
        filled
    }

    /// Is the slot of the services free? A frame in it that others keep from the bus makes way for a heartbeat. To be
    /// asked before any slot is filled: the hardware then forgets what it has sent.
    fn service_is_free(&mut self) -> bool {
        if self.service_held && self.shared.heartbeat_waits() && !self.bus.is_free(TxSlot::Service) {
            self.bus.withdraw(TxSlot::Service);
            self.service_given_up = true;
        }
        let is_free = self.bus.is_free(TxSlot::Service);
        if is_free && core::mem::take(&mut self.service_held) {
            let given_up = core::mem::take(&mut self.service_given_up);
            if !given_up || self.bus.has_sent(TxSlot::Service) {
                self.service = None;
            }
        }
        is_free
    }

    /// A heartbeat, the frame that made way for it, or the next.
    fn fill_service(&mut self) -> bool {
        if let Some(heartbeat) = self.shared.take_heartbeat() {
            return self.hand_over(TxSlot::Service, &heartbeat);
        }
        if self.service.is_none() {
            self.service = self.shared.take_service();
        }
        self.service_held = self.service.is_some();
        if let Some(frame) = &self.service {
            self.bus.transmit(TxSlot::Service, frame);
        }
        self.service_held
    }

    fn hand_over(&mut self, slot: TxSlot, frame: &CanFrame) -> bool {
        self.bus.transmit(slot, frame);
        true
    }

    fn back_on_bus(&mut self) {
        if let Some(since) = self.off_since_us.take() {
            let us = self.clock.now_us().saturating_sub(since);
            self.shared.update_status(|status| status.bus_off_us = u32::try_from(us).unwrap_or(u32::MAX));
        }
    }

    /// The next CAN frame of the oldest raw message.
    fn next_raw(&mut self) -> Option<CanFrame> {
        // Twice: a message that is through makes place for the next.
        for _ in 0..2 {
            if let Some(frame) = self.raw.try_receive()?.next_frame() {
                self.begun = true;
                return Some(frame);
            }
            self.raw.receive_done();
            self.begun = false;
        }
        None
    }

    /// Give up all raw messages that wait.
    fn drop_raw(&mut self) {
        let waiting = self.raw.len() as u32;
        if waiting > 0 {
            let broken = u32::from(core::mem::take(&mut self.begun));
            (0..waiting).for_each(|_| self.raw.receive_done());
            self.shared.update_status(|status| {
                status.dropped_raw = status.dropped_raw.saturating_add(waiting - broken);
                status.broken_raw = status.broken_raw.saturating_add(broken);
            });
        }
    }
}
