//! Rx handling: where a received frame goes, and the two Rx FIFOs (RM0433, Rx handling).

use rigless::device::DeviceContext as Context;
use rigless::soc::FieldSpec;
use rigless::soc::stm32h743::generated::fdcan1::Register;
use slipsense_can_sim::Frame;

use super::Fdcan;
use super::filters::Accepted;
use super::message_ram::Element;
use super::registers::{interrupt, rxfc, rxfs};

/// RXFxC and RXFxS.
const FIFOS: [(Register, Register); 2] =
    [(Register::FdcanRxf0c, Register::FdcanRxf0s), (Register::FdcanRxf1c, Register::FdcanRxf1s)];
/// Fields of RXFxS.
const LEVEL_GET_PUT: [&FieldSpec; 3] = [rxfs::F1FL, rxfs::F1GI, rxfs::F1PI];

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
        let [mut level, mut get, put] = LEVEL_GET_PUT.map(|field| field.get(self.get(status)));
        if size == 0 || level == size && !overwrite {
            self.set_bits(status, rxfs::RF1L.mask());
            self.raise(interrupt::RF0L.mask() << shift);
            return;
        }
        if level == size {
            // Overwrite mode: the oldest goes.
            get = (get + 1) % size;
            level -= 1;
        }
        let element = Element::nth(put as usize, start, self.get(Register::FdcanRxesc) >> shift);
        element.write_rx(&self.ram, frame, index, timestamp);
        level += 1;
        self.show_fifo(fifo, [level, get, (put + 1) % size]);
        let mut flags = interrupt::RF0N.mask();
        flags |= if level == size { interrupt::RF0F.mask() } else { 0 };
        flags |= if level == rxfc::F1WM.get(configured) { interrupt::RF0W.mask() } else { 0 };
        self.raise(flags << shift);
    }

    fn show_fifo(&mut self, fifo: usize, level_get_put: [u64; 3]) {
        let status = FIFOS[fifo].1;
        let full = u64::from(level_get_put[0] == self.fifo_size(fifo));
        let held = rxfs::F1F.set(self.get(status), full);
        let fields = LEVEL_GET_PUT.into_iter().zip(level_get_put);
        self.set(status, fields.fold(held, |held, (field, value)| field.set(held, value)));
    }

    fn fifo_size(&self, fifo: usize) -> u64 {
        rxfc::F1S.get(self.get(FIFOS[fifo].0)).min(64)
    }

    pub(super) fn acknowledge_rx(&mut self, fifo: usize, value: u64, context: &mut Context<'_>) {
        let (size, status) = (self.fifo_size(fifo), self.get(FIFOS[fifo].1));
        let [level, get, put] = LEVEL_GET_PUT.map(|field| field.get(status));
        let index = value & 0x3F;
        let freed = if size == 0 { 0 } else { (index + size - get % size) % size + 1 };
        if size == 0 || index >= size || freed > level {
            context.tell("FDCAN_RXFxA", "an element of the Rx FIFO is acknowledged that it does not hold");
            return;
        }
        self.show_fifo(fifo, [level - freed, (index + 1) % size, put]);
    }
}
