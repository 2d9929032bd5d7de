//! Rx handling: where a received frame goes, and the two Rx FIFOs (RM0433, Rx handling).

use rigless::device::DeviceContext as Context;
use rigless::soc::stm32h743::generated::fdcan1::Register;
use slipsense_can_sim::Frame;

use super::Fdcan;
use super::filters::Accepted;
use super::message_ram::Element;
use super::registers::{interrupt, rxfc, rxfs};

/// RXFxC and RXFxS.
const FIFOS: [(Register, Register); 2] =
    [(Register::FdcanRxf0c, Register::FdcanRxf0s), (Register::FdcanRxf1c, Register::FdcanRxf1s)];

impl Fdcan {
    pub(super) fn receive(&mut self, frame: &Frame, timestamp: u16, context: &mut Context<'_>) {
        match self.accept(frame) {
            Accepted::Rejected => {}
            Accepted::Buffer => {
                context
                    .tell("FDCAN_RXBC", "a dedicated Rx buffer is filtered for, and there is no model of it");
            }
            Accepted::Fifo(fifo, index) => self.store(fifo, frame, index, timestamp),
        }
    }

    fn store(&mut self, fifo: usize, frame: &Frame, index: Option<u8>, timestamp: u16) {
        let (configuration, status) = FIFOS[fifo];
        let configured = self.get(configuration);
        let (start, size) = (rxfc::F1SA.get(configured) as usize, self.fifo_size(fifo));
        let overwrite = configured >> 31 & 1 != 0;
        let shift = 4 * fifo as u32;
        let mut level = rxfs::F1FL.get(self.get(status)) as u32;
        if size == 0 || level == size && !overwrite {
            self.set_bits(status, rxfs::RF1L.mask());
            self.raise(interrupt::RF0L.mask() << shift);
            return;
        }
        if level == size {
            // Overwrite mode: the oldest goes.
            self.rx_get[fifo] = (self.rx_get[fifo] + 1) % size;
            level -= 1;
        }
        let put = self.rx_put[fifo] as usize;
        let element = Element::nth(put, start, self.get(Register::FdcanRxesc) >> shift);
        element.write_rx(&self.ram, frame, index, timestamp);
        self.rx_put[fifo] = (self.rx_put[fifo] + 1) % size;
        level += 1;
        self.show_fifo(fifo, level, size);
        let mut flags = interrupt::RF0N.mask();
        flags |= if level == size { interrupt::RF0F.mask() } else { 0 };
        flags |= if u64::from(level) == rxfc::F1WM.get(configured) { interrupt::RF0W.mask() } else { 0 };
        self.raise(flags << shift);
    }

    fn show_fifo(&mut self, fifo: usize, level: u32, size: u32) {
        let status = FIFOS[fifo].1;
        let indices = u64::from(self.rx_get[fifo]) << 8 | u64::from(self.rx_put[fifo]) << 16;
        let full = u64::from(level == size) << 24;
        let lost = self.get(status) & rxfs::RF1L.mask();
        self.set(status, lost | u64::from(level) | indices | full);
    }

    fn fifo_size(&self, fifo: usize) -> u32 {
        (rxfc::F1S.get(self.get(FIFOS[fifo].0)) as u32).min(64)
    }

    pub(super) fn acknowledge_rx(&mut self, fifo: usize, value: u64, context: &mut Context<'_>) {
        let size = self.fifo_size(fifo);
        let level = rxfs::F1FL.get(self.get(FIFOS[fifo].1)) as u32;
        let index = (value & 0x3F) as u32;
        let freed = if size == 0 { 0 } else { (index + size - self.rx_get[fifo] % size) % size + 1 };
        if size == 0 || index >= size || freed > level {
            context.tell("FDCAN_RXFxA", "an element of the Rx FIFO is acknowledged that it does not hold");
            return;
        }
        self.rx_get[fifo] = (index + 1) % size;
        self.show_fifo(fifo, level - freed, size);
    }
}
