//! Tx handling: buffers, FIFO and queue, cancellation, Tx events (RM0433, Tx handling).

use rigless::device::{DeviceContext, RegisterFile};
use rigless::soc::stm32h743::generated::fdcan1::Register;
use slipsense_can_sim::{ErrorState, Frame};

use super::message_ram::{TxElement, element_bytes, head_word, tail_word};
use super::registers::{cccr, field, interrupt};
use super::wire::MCU;
use super::{Fdcan, InFlight};

impl Fdcan {
    fn tx_layout(registers: &RegisterFile) -> (usize, u32, u32, bool) {
        let txbc = registers.get(Register::FdcanTxbc);
        (
            field(txbc, 2, 14) as usize,
            field(txbc, 16, 6) as u32,
            field(txbc, 24, 6) as u32,
            txbc >> 30 & 1 != 0,
        )
    }

    fn element(&self, buffer: u32, registers: &RegisterFile) -> Option<TxElement> {
        let (start, ..) = Self::tx_layout(registers);
        let bytes = element_bytes(registers.get(Register::FdcanTxesc));
        let control = registers.get(Register::FdcanCccr);
        let passive = self.wire_at_rx(registers).bus().node(MCU).state() == ErrorState::Passive;
        let word = start + buffer as usize * TxElement::words(bytes);
        TxElement::read(&self.ram, word, bytes, control & cccr::FDOE != 0, control & cccr::BRSE != 0, passive)
    }

    pub(super) fn request(
        &mut self,
        value: u64,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        if registers.get(Register::FdcanCccr) & cccr::CCE != 0 {
            context.tell("FDCAN_TXBAR", "a request while CCE is set, and is ignored");
            return;
        }
        let (_, dedicated, queue, queue_mode) = Self::tx_layout(registers);
        let mut pending = registers.get(Register::FdcanTxbrp) as u32;
        for buffer in (0..32).filter(|buffer| value >> buffer & 1 != 0) {
            if buffer >= dedicated + queue {
                context.tell(
                    "FDCAN_TXBAR",
                    "a request for a Tx buffer that TXBC does not configure, and is ignored",
                );
                continue;
            }
            if pending >> buffer & 1 != 0 {
                continue;
            }
            let put = registers.get(Register::FdcanTxfqs) >> 16 & 0x1F;
            if buffer >= dedicated && !queue_mode && u64::from(buffer) != put {
                context
                    .tell("FDCAN_TXBAR", "a request for another element of the Tx FIFO than its put index");
            }
            pending |= 1 << buffer;
            self.requested[buffer as usize] = self.element(buffer, registers);
            self.requested_at[buffer as usize] = context.now().0;
            for register in [Register::FdcanTxbto, Register::FdcanTxbcf] {
                registers.set(register, registers.get(register) & !(1 << buffer));
            }
            registers.set(Register::FdcanTxbrp, pending.into());
            self.update_fifo(registers);
        }
        self.schedule_start(registers, context);
    }

    pub(super) fn cancel(&mut self, value: u64, registers: &mut RegisterFile) {
        let pending = registers.get(Register::FdcanTxbrp);
        for buffer in (0..32u32).filter(|buffer| value >> buffer & 1 != 0 && pending >> buffer & 1 != 0) {
            if self.in_flight.as_ref().is_some_and(|flight| flight.buffer == Some(buffer)) {
                // It goes on; TXBCF is set when it ends, with TXBTO if it went through.
                self.cancelled |= 1 << buffer;
            } else {
                self.withdraw(buffer, registers);
            }
        }
    }

    fn withdraw(&mut self, buffer: u32, registers: &mut RegisterFile) {
        registers.set(Register::FdcanTxbrp, registers.get(Register::FdcanTxbrp) & !(1 << buffer));
        registers.set(Register::FdcanTxbcf, registers.get(Register::FdcanTxbcf) | 1 << buffer);
        if registers.get(Register::FdcanTxbcie) >> buffer & 1 != 0 {
            self.raise(interrupt::TCF, registers);
        }
        self.update_fifo(registers);
    }

    /// TXFQS: fill level and indices. FIFO: elements are used in turn. Queue: the put index is the lowest free
    /// buffer, get index and level read 0.
    pub(super) fn update_fifo(&mut self, registers: &mut RegisterFile) {
        let (_, dedicated, size, queue_mode) = Self::tx_layout(registers);
        let pending = registers.get(Register::FdcanTxbrp) >> dedicated & ((1 << size) - 1);
        let full = u64::from(size > 0 && pending.count_ones() == size) << 21;
        if queue_mode || size == 0 {
            let put = dedicated + (!pending).trailing_zeros().min(size.max(1) - 1);
            registers.set(Register::FdcanTxfqs, full | u64::from(put) << 16);
            return;
        }
        // Cancelled elements at the head are passed over; an empty FIFO stays where it is.
        while pending != 0 && pending >> self.tx_get & 1 == 0 {
            self.tx_get = (self.tx_get + 1) % size;
        }
        let used = pending.count_ones();
        let put = if pending == 0 { self.tx_get } else { (self.tx_get + used) % size };
        let indices = u64::from(dedicated + put) << 16 | u64::from(dedicated + self.tx_get) << 8;
        registers.set(Register::FdcanTxfqs, full | indices | u64::from(size - used));
    }

    /// Tx scan: dedicated buffers and the FIFO's first, or the whole queue, by identifier; of equal ones the lowest
    /// buffer.
    pub(super) fn offer(&self, registers: &RegisterFile) -> Option<(u32, Frame)> {
        if !self.running(registers)
            || registers.get(Register::FdcanCccr) & (cccr::MON | cccr::ASM) != 0 && !Self::loops(registers)
        {
            return None;
        }
        let (_, dedicated, size, queue_mode) = Self::tx_layout(registers);
        let pending = registers.get(Register::FdcanTxbrp) as u32;
        let in_turn = |buffer: u32| buffer < dedicated || queue_mode || buffer == dedicated + self.tx_get;
        (0..dedicated + size)
            .filter(|&buffer| pending >> buffer & 1 != 0 && in_turn(buffer))
            .filter_map(|buffer| Some((buffer, self.element(buffer, registers)?.frame)))
            .min_by_key(|(buffer, frame)| (frame.arbitration_field(), *buffer))
    }

    pub(super) fn end_own(
        &mut self,
        buffer: u32,
        sent: bool,
        flight: &InFlight,
        registers: &mut RegisterFile,
        context: &DeviceContext<'_>,
    ) {
        let cancelled = self.cancelled >> buffer & 1 != 0;
        // Disabled automatic retransmission: one attempt, as if cancelled.
        let once = registers.get(Register::FdcanCccr) & cccr::DAR != 0;
        if !sent && !cancelled && !once {
            return;
        }
        self.cancelled &= !(1 << buffer);
        registers.set(Register::FdcanTxbrp, registers.get(Register::FdcanTxbrp) & !(1 << buffer));
        if sent {
            self.requests.push((self.requested_at[buffer as usize], context.now().0));
            registers.set(Register::FdcanTxbto, registers.get(Register::FdcanTxbto) | 1 << buffer);
            if registers.get(Register::FdcanTxbtie) >> buffer & 1 != 0 {
                self.raise(interrupt::TC, registers);
            }
        }
        if cancelled || once {
            registers.set(Register::FdcanTxbcf, registers.get(Register::FdcanTxbcf) | 1 << buffer);
            if registers.get(Register::FdcanTxbcie) >> buffer & 1 != 0 {
                self.raise(interrupt::TCF, registers);
            }
        }
        let (_, dedicated, size, queue_mode) = Self::tx_layout(registers);
        if buffer >= dedicated && !queue_mode && size > 0 {
            self.tx_get = (buffer - dedicated + 1) % size;
            if registers.get(Register::FdcanTxbrp) >> dedicated & ((1 << size) - 1) == 0 {
                self.raise(interrupt::TFE, registers);
            }
        }
        self.update_fifo(registers);
        let event = self.requested[buffer as usize].take().filter(|element| sent && element.event);
        if let Some(element) = event {
            self.store_event(&element, flight.timestamp, registers);
        }
    }

    fn store_event(&mut self, element: &TxElement, timestamp: u16, registers: &mut RegisterFile) {
        let txefc = registers.get(Register::FdcanTxefc);
        let (start, size) = (field(txefc, 2, 14) as usize, field(txefc, 16, 6) as u32);
        let mut status = registers.get(Register::FdcanTxefs);
        let level = field(status, 0, 6) as u32;
        if size == 0 || level == size {
            // Full: the new event is lost.
            registers.set(Register::FdcanTxefs, status | 1 << 25);
            self.raise(interrupt::TEFL, registers);
            return;
        }
        let word = start + 2 * self.event_put as usize;
        // ET 1: a Tx event.
        let second = u32::from(element.marker) << 24 | 1 << 22 | tail_word(&element.frame, timestamp);
        self.ram.write(word, head_word(&element.frame));
        self.ram.write(word + 1, second);
        self.event_put = (self.event_put + 1) % size;
        let level = level + 1;
        status = u64::from(level) | u64::from(self.event_get) << 8 | u64::from(self.event_put) << 16;
        registers.set(Register::FdcanTxefs, status | u64::from(level == size) << 24);
        let mut flags = interrupt::TEFN;
        flags |= if level == size { interrupt::TEFF } else { 0 };
        flags |= if u64::from(level) == field(txefc, 24, 6) { interrupt::TEFW } else { 0 };
        self.raise(flags, registers);
    }

    pub(super) fn acknowledge_events(
        &mut self,
        value: u64,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        let size = field(registers.get(Register::FdcanTxefc), 16, 6) as u32;
        let level = field(registers.get(Register::FdcanTxefs), 0, 6) as u32;
        let index = (value & 0x1F) as u32;
        let freed = if size == 0 { 0 } else { (index + size - self.event_get % size) % size + 1 };
        if size == 0 || index >= size || freed > level {
            context.tell("FDCAN_TXEFA", "a Tx event is acknowledged that the FIFO does not hold");
            return;
        }
        self.event_get = (index + 1) % size;
        let indices = u64::from(self.event_get) << 8 | u64::from(self.event_put) << 16;
        registers.set(Register::FdcanTxefs, u64::from(level - freed) | indices);
    }
}
