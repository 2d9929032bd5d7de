//! A frame on the wires, from its start to what the error counters make of its end (RM0433, error management).

use rigless::device::DeviceContext as Context;
use rigless::soc::stm32h743::generated::fdcan1::Register;
use rigless::time::VirtualNanos;
use slipsense_can_sim::{ErrorState, Field, Frame, Outcome};

use super::registers::{ACK_ERROR, BIT0_ERROR, cccr, interrupt, psr};
use super::wire::{MCU, PEER};
use super::{Fdcan, InFlight};

impl Fdcan {
    pub(super) fn schedule_start(&mut self, context: &mut Context<'_>) {
        if !self.running() || self.in_flight.is_some() {
            return;
        }
        let offered = self.offer().is_some();
        let Some(at) = self.wire_at_rx().next_start(context.now().0, offered) else { return };
        if self.start.is_none_or(|(_, planned)| at < planned) {
            self.start = Some((context.schedule(VirtualNanos(at)), at));
        }
    }

    pub(super) fn start_frame(&mut self, context: &mut Context<'_>) {
        let mine = self.offer();
        let timestamp = self.timestamp(context.now().0);
        let offered = mine.as_ref().map(|(_, frame)| frame);
        let Some((attempt, frame)) = self.wire_at_rx_mut().start(context.now().0, offered) else {
            self.schedule_start(context);
            return;
        };
        let buffer = mine.map(|(buffer, _)| buffer).filter(|_| attempt.node == MCU);
        if let Some(buffer) = buffer
            && self.requested[buffer as usize].0.as_ref().map(Frame::data) != Some(frame.data())
        {
            context.tell("FDCAN_TXBRP", "a Tx buffer was changed after its transmission was requested");
        }
        let event = context.schedule(VirtualNanos(self.wire_at_rx().ns(attempt.end)));
        self.in_flight = Some(InFlight { attempt, frame, buffer, timestamp, event });
    }

    pub(super) fn end_frame(&mut self, flight: InFlight, context: &mut Context<'_>) {
        let looped = self.loops();
        let sent = flight.attempt.outcome == Outcome::Sent;
        if looped && !self.has(cccr::MON) {
            // External loop back: others see what it sends, and it takes no notice of them. That they may send at the
            // same time is not modelled.
            self.wire.log.extend(self.inside.log.last().cloned());
        }
        if let Some(buffer) = flight.buffer {
            self.end_own(buffer, sent, context);
        }
        if sent && (flight.attempt.node == PEER || looped) {
            self.receive(&flight.frame, flight.timestamp, context);
        }
        self.update_status(&flight);
        self.schedule_start(context);
    }

    fn update_status(&mut self, flight: &InFlight) {
        let mut status = self.get(Register::FdcanPsr);
        let code = match flight.attempt.outcome {
            Outcome::Sent => 0,
            Outcome::NotAcknowledged => ACK_ERROR,
            Outcome::Error(_) => BIT0_ERROR,
        };
        let format = flight.frame.format();
        let in_data = format.switches()
            && matches!(flight.attempt.outcome, Outcome::Error(field) if field >= Field::Data && field < Field::AckSlot);
        let (last, error) = if in_data { (psr::DLEC, interrupt::PED) } else { (psr::LEC, interrupt::PEA) };
        status = last.set(status, code);
        if code != 0 {
            self.raise(error.mask());
        }
        if (flight.attempt.node == PEER || self.loops()) && format.is_fd() {
            status |= psr::REDL.mask() | if format.switches() { psr::RBRS.mask() } else { 0 };
        }
        self.set(Register::FdcanPsr, status);
        self.update_counters();
    }

    /// ECR, and the flags of PSR and IR that follow the counters.
    fn update_counters(&mut self) {
        let node = *self.wire_at_rx().bus.node(MCU);
        let state = node.state();
        let passive_receiver = node.receive_errors() > 127;
        let counters = u64::from(node.transmit_errors().min(255))
            | u64::from(node.receive_errors().min(127)) << 8
            | u64::from(passive_receiver) << 15;
        self.set(Register::FdcanEcr, counters);
        let is_off = state == ErrorState::BusOff;
        let was_off = psr::BO.is_set(self.get(Register::FdcanPsr));
        for (stands, flag, interrupt) in [
            (state != ErrorState::Active, psr::EP, interrupt::EP),
            (node.warns(), psr::EW, interrupt::EW),
            (is_off, psr::BO, interrupt::BO),
        ] {
            let status = self.get(Register::FdcanPsr);
            if stands != flag.is_set(status) {
                self.set(Register::FdcanPsr, status ^ flag.mask());
                self.raise(interrupt.mask());
            }
        }
        if is_off && !was_off {
            // Bus-off: INIT is set by hardware, and the node stays silent until software clears it.
            self.set_bits(Register::FdcanCccr, cccr::INIT.mask());
            self.start = None;
        }
    }

    pub(super) fn recovery_due(&mut self, context: &mut Context<'_>) {
        self.wire_at_rx_mut().advance(context.now().0);
        if let Some(at) = self.wire_at_rx().returns() {
            self.recovery = Some(context.schedule(VirtualNanos(at)));
            return;
        }
        self.recovery = None;
        self.update_counters();
        self.schedule_start(context);
    }
}
