//! Tx handling: the queue and cancellation (RM0433, Tx handling).

use rigless::device::DeviceContext as Context;
use rigless::soc::stm32h743::generated::fdcan1::Register as R;
use slipsense_can_sim::{ErrorState, Frame};

use super::Fdcan;
use super::message_ram::{Element, TX_EVENT};
use super::registers::{cccr, interrupt, txbc};
use super::wire::MCU;

impl Fdcan {
    /// Buffers of the queue.
    fn queue(&self) -> u32 {
        txbc::TFQS.get(self.get(R::FdcanTxbc)) as u32
    }

    fn element(&self, buffer: u32) -> Element {
        let start = txbc::TBSA.get(self.get(R::FdcanTxbc)) as usize;
        Element::nth(buffer as usize, start, self.get(R::FdcanTxesc))
    }

    fn frame(&self, buffer: u32) -> Option<Frame> {
        let passive = self.wire_at_rx().bus.node(MCU).state() == ErrorState::Passive;
        self.element(buffer).read_tx(&self.ram, self.has(cccr::FDOE), self.has(cccr::BSE), passive)
    }

    pub(super) fn request(&mut self, value: u64, context: &mut Context<'_>) {
        if self.has(cccr::CCE) {
            context.tell("FDCAN_TXBAR", "a request while CCE is set, and is ignored");
            return;
        }
        let txbc = self.get(R::FdcanTxbc);
        if txbc::NDTB.is_set(txbc) || !txbc::TFQM.is_set(txbc) || self.has(cccr::DAR) {
            context.tell("FDCAN_TXBAR", "dedicated buffers, a Tx FIFO or DAR, and there is no model of them");
        }
        for buffer in (0..32).filter(|buffer| value >> buffer & 1 != 0) {
            if buffer >= self.queue() {
                context.tell(
                    "FDCAN_TXBAR",
                    "a request for a Tx buffer that TXBC does not configure, and is ignored",
                );
                continue;
            }
            if self.get(R::FdcanTxbrp) >> buffer & 1 != 0 {
                continue;
            }
            if self.ram.read(self.element(buffer).word + 1).is_some_and(|word| word & TX_EVENT != 0) {
                context.tell("FDCAN_TXBAR", "a request for a Tx event, and there is no model of them");
            }
            self.requested[buffer as usize] = (self.frame(buffer), context.now().0);
            self.clear_bits(R::FdcanTxbto, 1 << buffer);
            self.clear_bits(R::FdcanTxbcf, 1 << buffer);
            self.set_bits(R::FdcanTxbrp, 1 << buffer);
            self.update_queue();
        }
        self.schedule_start(context);
    }

    pub(super) fn cancel(&mut self, value: u64) {
        let asked = value & self.get(R::FdcanTxbrp);
        for buffer in (0..32).filter(|buffer| asked >> buffer & 1 != 0) {
            if self.in_flight.as_ref().is_some_and(|flight| flight.buffer == Some(buffer)) {
                // It goes on; TXBCF is set when it ends, with TXBTO if it went through.
                self.cancelled |= 1 << buffer;
            } else {
                self.close(buffer, false, true);
            }
        }
    }

    /// A request is over.
    fn close(&mut self, buffer: u32, sent: bool, cancelled: bool) {
        self.clear_bits(R::FdcanTxbrp, 1 << buffer);
        for (is_so, flags, enable, interrupt) in [
            (sent, R::FdcanTxbto, R::FdcanTxbtie, interrupt::TC),
            (cancelled, R::FdcanTxbcf, R::FdcanTxbcie, interrupt::TCF),
        ] {
            if is_so {
                self.set_bits(flags, 1 << buffer);
                self.raise(if self.get(enable) >> buffer & 1 != 0 { interrupt.mask() } else { 0 });
            }
        }
        self.update_queue();
    }

    /// TXFQS of a queue: the put index is the lowest free buffer, get index and level read 0.
    pub(super) fn update_queue(&mut self) {
        let size = self.queue();
        let pending = self.get(R::FdcanTxbrp) & ((1 << size) - 1);
        let full = u64::from(size > 0 && pending.count_ones() == size) << 21;
        let put = (!pending).trailing_zeros().min(size.max(1) - 1);
        self.set(R::FdcanTxfqs, full | u64::from(put) << 16);
    }

    /// Tx scan: the whole queue, by identifier; of equal ones the lowest buffer.
    pub(super) fn offer(&self) -> Option<(u32, Frame)> {
        if !self.running() || (self.has(cccr::MON) || self.has(cccr::ASM)) && !self.loops() {
            return None;
        }
        let pending = self.get(R::FdcanTxbrp);
        (0..self.queue())
            .filter(|buffer| pending >> buffer & 1 != 0)
            .filter_map(|buffer| Some((buffer, self.frame(buffer)?)))
            .min_by_key(|(buffer, frame)| (frame.arbitration_field(), *buffer))
    }

    pub(super) fn end_own(&mut self, buffer: u32, sent: bool, context: &Context<'_>) {
        let cancelled = self.cancelled >> buffer & 1 != 0;
        if !sent && !cancelled {
            return;
        }
        self.cancelled &= !(1 << buffer);
        if sent {
            self.requests.push((self.requested[buffer as usize].1, context.now().0));
        }
        self.close(buffer, sent, cancelled);
        self.requested[buffer as usize].0 = None;
    }
}
