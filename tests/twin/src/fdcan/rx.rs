//! Rx handling: where a received frame goes, and the two Rx FIFOs (RM0433, Rx handling).

use rigless::device::{DeviceContext, RegisterFile};
use rigless::soc::stm32h743::generated::fdcan1::Register;
use slipsense_can_sim::Frame;

use super::Fdcan;
use super::filters::{self, Accepted};
use super::message_ram::{element_bytes, write_rx};
use super::registers::{field, interrupt};

impl Fdcan {
    pub(super) fn receive(&mut self, frame: &Frame, timestamp: u16, registers: &mut RegisterFile) {
        match filters::accept(frame, registers, &self.ram) {
            Accepted::Rejected => {}
            Accepted::Buffer(buffer, index) => {
                let bytes = element_bytes(registers.get(Register::FdcanRxesc) >> 8);
                let start = field(registers.get(Register::FdcanRxbc), 2, 14) as usize;
                let word = start + usize::from(buffer) * (2 + bytes / 4);
                write_rx(&self.ram, word, bytes, frame, Some(index), timestamp);
                let (register, bit) = if buffer < 32 {
                    (Register::FdcanNdat1, buffer)
                } else {
                    (Register::FdcanNdat2, buffer - 32)
                };
                registers.set(register, registers.get(register) | 1 << bit);
                self.raise(interrupt::DRX, registers);
            }
            Accepted::Fifo(fifo, index) => self.store(fifo, frame, index, timestamp, registers),
        }
    }

    fn fifo_registers(fifo: usize) -> (Register, Register) {
        [(Register::FdcanRxf0c, Register::FdcanRxf0s), (Register::FdcanRxf1c, Register::FdcanRxf1s)][fifo]
    }

    fn store(
        &mut self,
        fifo: usize,
        frame: &Frame,
        index: Option<u8>,
        timestamp: u16,
        registers: &mut RegisterFile,
    ) {
        let (configuration, status) = Self::fifo_registers(fifo);
        let configured = registers.get(configuration);
        let (start, size) = (field(configured, 2, 14) as usize, (field(configured, 16, 7) as u32).min(64));
        let overwrite = configured >> 31 & 1 != 0;
        let shift = 4 * fifo as u32;
        let mut level = field(registers.get(status), 0, 7) as u32;
        if size == 0 || level == size && !overwrite {
            registers.set(status, registers.get(status) | 1 << 25);
            self.raise(interrupt::RF0L << shift, registers);
            return;
        }
        if level == size {
            // Overwrite mode: the oldest goes.
            self.rx_get[fifo] = (self.rx_get[fifo] + 1) % size;
            level -= 1;
        }
        let bytes = element_bytes(registers.get(Register::FdcanRxesc) >> shift);
        let word = start + self.rx_put[fifo] as usize * (2 + bytes / 4);
        write_rx(&self.ram, word, bytes, frame, index, timestamp);
        self.rx_put[fifo] = (self.rx_put[fifo] + 1) % size;
        level += 1;
        self.show_fifo(fifo, level, size, registers);
        let mut flags = interrupt::RF0N;
        flags |= if level == size { interrupt::RF0F } else { 0 };
        flags |= if u64::from(level) == field(configured, 24, 7) { interrupt::RF0W } else { 0 };
        self.raise(flags << shift, registers);
    }

    fn show_fifo(&self, fifo: usize, level: u32, size: u32, registers: &mut RegisterFile) {
        let (_, status) = Self::fifo_registers(fifo);
        let lost = registers.get(status) & 1 << 25;
        let indices = u64::from(self.rx_get[fifo]) << 8 | u64::from(self.rx_put[fifo]) << 16;
        registers.set(status, lost | u64::from(level) | indices | u64::from(level == size) << 24);
    }

    pub(super) fn acknowledge_rx(
        &mut self,
        fifo: usize,
        value: u64,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        let (configuration, status) = Self::fifo_registers(fifo);
        let size = (field(registers.get(configuration), 16, 7) as u32).min(64);
        let level = field(registers.get(status), 0, 7) as u32;
        let index = (value & 0x3F) as u32;
        let freed = if size == 0 { 0 } else { (index + size - self.rx_get[fifo] % size) % size + 1 };
        if size == 0 || index >= size || freed > level {
            context.tell("FDCAN_RXFxA", "an element of the Rx FIFO is acknowledged that it does not hold");
            return;
        }
        self.rx_get[fifo] = (index + 1) % size;
        self.show_fifo(fifo, level - freed, size, registers);
    }
}
