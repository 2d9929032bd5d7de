//! The FDCAN of the STM32H743, which the emulator has no model of.
//!
//! Written from RM0433 (chapter FDCAN; section titles beside each behaviour, as remembered, since neither manual nor
//! M_CAN's could be had here) and from what embassy-stm32 0.6 programs; frame times, arbitration and error counters
//! are `slipsense-can-sim`'s.
//!
//! | covered | section |
//! |---|---|
//! | INIT, CCE, protected registers; what CCE resets | software initialization |
//! | bit timings, FDOE, BRSE, MON, ASM, both loop-back modes | operating modes, test modes |
//! | Tx queue, cancellation | Tx handling |
//! | filters, Rx FIFOs | Rx handling |
//! | IR, IE, ILS, ILE, TXBTIE, TXBCIE | interrupt registers |
//! | ECR, PSR, bus-off and recovery | error management |
//! | TSCV from nominal bit times | timestamp generation |
//!
//! Not covered, because no program of ours and not embassy's driver uses them: Tx FIFO, dedicated buffers, Tx events,
//! DAR, timeout counter, high-priority status, message RAM watchdog, clock stop's handshake time, restricted mode's
//! receive path, time-triggered operation, the clock calibration unit, transceiver delay (the wires have none). An
//! access to those is reported.

mod configuration;
mod filters;
mod flight;
pub mod hostile;
pub mod message_ram;
mod registers;
mod rx;
#[cfg(test)]
mod tests;
mod tx;
pub mod wire;

use rigless::device::{Device, DeviceContext as Context, Level, RegisterFile};
use rigless::soc::stm32h743::generated::fdcan1::Register;
use rigless::soc::{FieldSpec, Layout};
use rigless::time::EventId;
use slipsense_can_sim::{Attempt, Frame, Timing};

use message_ram::MessageRam;
use registers::{Rule, TX_DOMINANT, UNCHANGED, cccr, pins, psr, rule};
use wire::Wire;

#[derive(Debug)]
struct InFlight {
    attempt: Attempt,
    frame: Frame,
    /// The Tx buffer it came from.
    buffer: Option<u32>,
    timestamp: u16,
    event: EventId,
}

#[derive(Debug, Default)]
pub struct Fdcan {
    ram: MessageRam,
    pub wire: Wire,
    /// The wire in a loop-back mode: its own frames.
    inside: Wire,
    clock_hz: u64,
    timing: Option<Timing>,
    in_flight: Option<InFlight>,
    start: Option<(EventId, u64)>,
    recovery: Option<EventId>,
    /// What each buffer held when its transmission was requested, and when that was.
    requested: [(Option<Frame>, u64); 32],
    /// Cancellations asked for while the frame was on the wires.
    cancelled: u64,
    /// When TSCV was last 0.
    timestamp_from: u64,
    lines: [bool; 2],
    /// Every register. The bus reads copies, and lets a write land in them before it comes here.
    registers: Vec<u64>,
    /// For every frame sent: virtual time of its request.
    pub requests: Vec<(u64, u64)>,
}

impl Fdcan {
    /// An instance on wires of its own.
    pub fn new(ram: MessageRam) -> Self {
        Self { ram, registers: registers::reset(), ..Self::default() }
    }

    fn get(&self, register: Register) -> u64 {
        self.registers[register.index()]
    }

    fn set(&mut self, register: Register, value: u64) {
        self.registers[register.index()] = value;
    }

    fn set_bits(&mut self, register: Register, bits: u64) {
        self.set(register, self.get(register) | bits);
    }

    fn clear_bits(&mut self, register: Register, bits: u64) {
        self.set(register, self.get(register) & !bits);
    }

    /// Gives the bus its copies.
    pub fn show(&self, registers: &mut RegisterFile) {
        Register::ALL.into_iter().for_each(|register| registers.set(register, self.get(register)));
    }

    /// The end of every call.
    fn settle(&mut self, registers: &mut RegisterFile, context: &mut Context<'_>) {
        self.drive_lines(context);
        self.show(registers);
    }

    /// A bit of CCCR.
    fn has(&self, control: &FieldSpec) -> bool {
        control.is_set(self.get(Register::FdcanCccr))
    }

    fn running(&self) -> bool {
        !self.has(cccr::INIT) && !self.has(cccr::CSA) && self.timing.is_some()
    }

    /// Test modes: in loop back RX is fed from TX inside the instance, and the pin is not read.
    fn loops(&self) -> bool {
        self.has(cccr::TEST) && pins::LBCK.is_set(self.get(Register::FdcanTest))
    }

    fn wire_at_rx(&self) -> &Wire {
        if self.loops() { &self.inside } else { &self.wire }
    }

    fn wire_at_rx_mut(&mut self) -> &mut Wire {
        if self.loops() { &mut self.inside } else { &mut self.wire }
    }

    fn raise(&mut self, bits: u64) {
        self.set_bits(Register::FdcanIr, bits);
    }

    /// Interrupt registers: a line is high while a flag stands that is enabled and selected for it.
    fn drive_lines(&mut self, context: &mut Context<'_>) {
        let pending = self.get(Register::FdcanIr) & self.get(Register::FdcanIe);
        let (select, enable) = (self.get(Register::FdcanIls), self.get(Register::FdcanIle));
        for line in 0..self.lines.len() {
            let mine = if line == 0 { pending & !select } else { pending & select };
            let high = mine != 0 && enable >> line & 1 != 0;
            if high != self.lines[line] {
                self.lines[line] = high;
                context.interrupt(line, Level::from(high));
            }
        }
    }
}

impl Device for Fdcan {
    type Register = Register;

    fn read(
        &mut self,
        register: Register,
        file: &mut RegisterFile,
        context: &mut Context<'_>,
    ) -> Option<u64> {
        let value = self.get(register);
        match register {
            Register::FdcanTscv => Some(self.timestamp(context.now().0).into()),
            // TX under software's control; a transceiver carries its level to RX.
            Register::FdcanTest => {
                let low = self.wire.has_transceiver && pins::TX.get(value) == TX_DOMINANT;
                Some(pins::RX.set(value, u64::from(!low)))
            }
            // Reading clears its flags: LEC and DLEC go to "no change", the receive flags and PXE to 0, CEL
            // to 0 (protocol status register, error counter register).
            Register::FdcanPsr => {
                let flags = [psr::RESI, psr::RBRS, psr::REDL, psr::PXE];
                let cleared = flags.iter().fold(value, |value, flag| flag.set(value, 0));
                self.set(register, psr::DLEC.set(psr::LEC.set(cleared, UNCHANGED), UNCHANGED));
                self.settle(file, context);
                Some(value)
            }
            _ => {
                if rule(register).is_none() {
                    context
                        .tell("FDCAN_TT", "a time-triggered register is read, and there is no model of it");
                }
                None
            }
        }
    }

    fn write(&mut self, register: Register, value: u64, file: &mut RegisterFile, context: &mut Context<'_>) {
        use Register as R;
        let old = self.get(register);
        match rule(register) {
            None => {
                context.tell("FDCAN_TT", "a time-triggered register is written, and there is no model of it");
            }
            Some(Rule::Special) => {}
            Some(Rule::Bits(mask)) => self.set(register, value & mask),
            Some(Rule::Protected(mask)) => {
                if self.has(cccr::INIT) && self.has(cccr::CCE) {
                    self.set(register, value & mask);
                } else if value & mask != old {
                    context.tell(register.spec().name, "written without CCE and INIT, and is ignored");
                }
            }
        }
        match register {
            R::FdcanCccr => self.write_cccr(value, old, context),
            R::FdcanTest => {
                let new = if self.has(cccr::TEST) { value & 0x70 } else { old };
                if new != value & 0x70 {
                    context.tell("FDCAN_TEST", "written without CCCR.TEST, and is ignored");
                }
                self.set(register, new);
            }
            R::FdcanIr => self.clear_bits(register, value),
            R::FdcanTscv => self.timestamp_from = context.now().0,
            R::FdcanRxf0a => self.acknowledge_rx(0, value, context),
            R::FdcanRxf1a => self.acknowledge_rx(1, value, context),
            R::FdcanTxbar => self.request(value, context),
            R::FdcanTxbcr => self.cancel(value),
            _ => {}
        }
        self.settle(file, context);
    }

    fn on_event(&mut self, event: EventId, file: &mut RegisterFile, context: &mut Context<'_>) {
        if self.start.is_some_and(|(planned, _)| planned == event) {
            self.start = None;
            self.start_frame(context);
        } else if let Some(flight) = self.in_flight.take_if(|flight| flight.event == event) {
            self.end_frame(flight, context);
        } else if self.recovery == Some(event) {
            self.recovery_due(context);
        }
        self.settle(file, context);
    }

    fn on_clock(&mut self, hz: u64, _: &mut RegisterFile, context: &mut Context<'_>) {
        if hz != self.clock_hz && self.running() {
            context.tell("FDCAN_CCCR", "the kernel clock changes while the node is on the bus");
        }
        self.clock_hz = hz;
    }

    fn reset(&mut self) {
        let (wire, requests) = (std::mem::take(&mut self.wire), std::mem::take(&mut self.requests));
        *self = Self { wire, clock_hz: self.clock_hz, requests, ..Self::new(self.ram.clone()) };
    }

    fn reset_line(&mut self, file: &mut RegisterFile, context: &mut Context<'_>) {
        Device::reset(self);
        self.settle(file, context);
    }
}
