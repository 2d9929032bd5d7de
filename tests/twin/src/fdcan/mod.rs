//! The FDCAN of the STM32H743, which the emulator has no model of.
//!
//! Written from RM0433 (chapter FDCAN; section titles beside each behaviour, as remembered, since neither manual nor
//! M_CAN's could be had here) and from what embassy-stm32 0.6 programs; frame times, arbitration and error counters
//! are `slipsense-can-sim`'s.
//!
//! | covered | section |
//! |---|---|
//! | INIT, CCE, protected registers; what CCE resets | software initialization |
//! | bit timings, FDOE, BRSE, DAR, MON, ASM, both loop-back modes | operating modes, test modes |
//! | Tx FIFO and queue, dedicated buffers, cancellation, Tx events | Tx handling |
//! | filters, Rx FIFOs, dedicated Rx buffers | Rx handling |
//! | IR, IE, ILS, ILE, TXBTIE, TXBCIE | interrupt registers |
//! | ECR, PSR, bus-off and recovery | error management |
//! | TSCV from nominal bit times | timestamp generation |
//!
//! Not covered: timeout counter, high-priority status, message RAM watchdog, clock stop's handshake time, restricted
//! mode's receive path, time-triggered operation, the clock calibration unit, transceiver delay (the wires have
//! none). An access to those is reported.

mod configuration;
mod filters;
mod flight;
pub mod message_ram;
mod registers;
mod rx;
#[cfg(test)]
mod tests;
mod tx;
pub mod wire;

use rigless::device::{Device, DeviceContext, Level, RegisterFile};
use rigless::soc::Layout;
use rigless::soc::stm32h743::generated::fdcan1::Register;
use rigless::time::EventId;
use slipsense_can_sim::{Attempt, ErrorState, Frame, Timing};

use message_ram::{MessageRam, TxElement};
use registers::{LOOPBACK, RX, Rule, TX_DOMINANT, cccr, field, psr, rule};
use wire::Wire;

/// Places of the two interrupt lines in the instance's list.
const LINES: [usize; 2] = [0, 1];

#[derive(Debug)]
struct InFlight {
    attempt: Attempt,
    frame: Frame,
    /// The Tx buffer it came from.
    buffer: Option<u32>,
    timestamp: u16,
    event: EventId,
}

#[derive(Debug)]
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
    requested: [Option<TxElement>; 32],
    requested_at: [u64; 32],
    /// Next of the Tx FIFO to send, as an offset into it.
    tx_get: u32,
    rx_get: [u32; 2],
    rx_put: [u32; 2],
    event_get: u32,
    event_put: u32,
    /// Cancellations asked for while the frame was on the wires.
    cancelled: u32,
    was: ErrorState,
    /// When TSCV was last 0.
    timestamp_from: u64,
    lines: [bool; 2],
    /// Every register as the last call left it: the bus lets a write land before the model sees it.
    kept: Vec<u64>,
    /// Interrupts raised: rising edges of either line.
    pub interrupts: u64,
    /// For every frame sent: virtual time of its request.
    pub requests: Vec<(u64, u64)>,
}

impl Fdcan {
    /// An instance on wires of its own.
    pub fn new(ram: MessageRam) -> Self {
        Self {
            ram,
            wire: Wire::default(),
            inside: Wire::default(),
            clock_hz: 0,
            timing: None,
            in_flight: None,
            start: None,
            recovery: None,
            requested: [const { None }; 32],
            requested_at: [0; 32],
            tx_get: 0,
            rx_get: [0; 2],
            rx_put: [0; 2],
            event_get: 0,
            event_put: 0,
            cancelled: 0,
            was: ErrorState::Active,
            timestamp_from: 0,
            lines: [false; 2],
            kept: registers::after_reset(),
            interrupts: 0,
            requests: Vec::new(),
        }
    }

    /// Puts reset values into the instance's registers, after the part's own reset.
    pub fn reset_registers(registers: &mut RegisterFile) {
        registers::reset(registers);
    }

    /// What a register held before the write that is being handled.
    fn before(&self, register: Register) -> u64 {
        self.kept[register.index()]
    }

    /// The end of every call.
    fn settle(&mut self, registers: &RegisterFile, context: &mut DeviceContext<'_>) {
        self.drive_lines(registers, context);
        for register in Register::ALL {
            self.kept[register.index()] = registers.get(register);
        }
    }

    fn may_configure(registers: &RegisterFile) -> bool {
        let both = cccr::INIT | cccr::CCE;
        registers.get(Register::FdcanCccr) & both == both
    }

    fn running(&self, registers: &RegisterFile) -> bool {
        registers.get(Register::FdcanCccr) & (cccr::INIT | cccr::CSA) == 0 && self.timing.is_some()
    }

    /// Test modes: in loop back RX is fed from TX inside the instance, and the pin is not read.
    fn loops(registers: &RegisterFile) -> bool {
        registers.get(Register::FdcanCccr) & cccr::TEST != 0
            && registers.get(Register::FdcanTest) & LOOPBACK != 0
    }

    fn wire_at_rx(&self, registers: &RegisterFile) -> &Wire {
        if Self::loops(registers) { &self.inside } else { &self.wire }
    }

    fn heard_mut(&mut self, registers: &RegisterFile) -> &mut Wire {
        if Self::loops(registers) { &mut self.inside } else { &mut self.wire }
    }

    fn raise(&self, bits: u64, registers: &mut RegisterFile) {
        registers.set(Register::FdcanIr, registers.get(Register::FdcanIr) | bits);
    }

    /// Interrupt registers: a line is high while a flag stands that is enabled and selected for it.
    fn drive_lines(&mut self, registers: &RegisterFile, context: &mut DeviceContext<'_>) {
        let pending = registers.get(Register::FdcanIr) & registers.get(Register::FdcanIe);
        let (select, enable) = (registers.get(Register::FdcanIls), registers.get(Register::FdcanIle));
        for (line, place) in LINES.into_iter().enumerate() {
            let mine = if line == 0 { pending & !select } else { pending & select };
            let high = mine != 0 && enable >> line & 1 != 0;
            if high != self.lines[line] {
                self.lines[line] = high;
                self.interrupts += u64::from(high);
                context.interrupt(place, Level::from(high));
            }
        }
    }
}

impl Device for Fdcan {
    type Register = Register;

    fn read(
        &mut self,
        register: Register,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) -> Option<u64> {
        match register {
            Register::FdcanTscv => Some(self.timestamp(registers, context.now().0).into()),
            // TX under software's control; a transceiver carries its level to RX.
            Register::FdcanTest => {
                let value = registers.get(register);
                let echoes = self.wire.has_transceiver;
                let low = echoes && field(value, 5, 2) == TX_DOMINANT;
                Some(value & !RX | if low { 0 } else { RX })
            }
            // Reading clears its flags: LEC and DLEC go to "no change", the receive flags and PXE to 0, CEL
            // to 0 (protocol status register, error counter register).
            Register::FdcanPsr => {
                let value = registers.get(register);
                let cleared = value & !(psr::RESI | psr::RBRS | psr::RFDF | psr::PXE);
                registers.set(register, cleared | psr::UNCHANGED | psr::UNCHANGED << 8);
                self.settle(registers, context);
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

    fn write(
        &mut self,
        register: Register,
        value: u64,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        use Register as R;
        match rule(register) {
            None => {
                context.tell("FDCAN_TT", "a time-triggered register is written, and there is no model of it")
            }
            Some(Rule::Special) => {}
            Some(Rule::ReadOnly) => registers.set(register, self.before(register)),
            Some(Rule::Bits(mask)) => registers.set(register, value & mask),
            Some(Rule::Protected(mask)) => {
                let old = self.before(register);
                if Self::may_configure(registers) {
                    registers.set(register, value & mask);
                } else {
                    if value & mask != old {
                        context.tell(register.spec().name, "written without CCE and INIT, and is ignored");
                    }
                    registers.set(register, old);
                }
            }
        }
        match register {
            R::FdcanCccr => {
                let old = self.before(register);
                registers.set(R::FdcanCccr, old);
                self.write_cccr(value, old, registers, context);
            }
            R::FdcanTest => {
                let old = self.before(register);
                let new = if self.before(R::FdcanCccr) & cccr::TEST != 0 { value & 0x70 } else { old };
                if new != value & 0x70 {
                    context.tell("FDCAN_TEST", "written without CCCR.TEST, and is ignored");
                }
                registers.set(register, new);
            }
            R::FdcanIr => {
                let left = self.before(register) & !value;
                registers.set(register, left);
            }
            R::FdcanTscv => self.timestamp_from = context.now().0,
            R::FdcanNdat1 | R::FdcanNdat2 => {
                let old = self.before(register);
                registers.set(register, old & !value);
            }
            R::FdcanRxf0a => self.acknowledge_rx(0, value, registers, context),
            R::FdcanRxf1a => self.acknowledge_rx(1, value, registers, context),
            R::FdcanTxefa => self.acknowledge_events(value, registers, context),
            R::FdcanTxbar => {
                registers.set(register, 0);
                self.request(value, registers, context);
            }
            R::FdcanTxbcr => {
                registers.set(register, 0);
                self.cancel(value, registers);
            }
            _ => {}
        }
        self.settle(registers, context);
    }

    fn on_event(&mut self, event: EventId, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        if self.start.is_some_and(|(planned, _)| planned == event) {
            self.start = None;
            self.start_frame(registers, context);
        } else if self.in_flight.as_ref().is_some_and(|flight| flight.event == event) {
            if let Some(flight) = self.in_flight.take() {
                self.end_frame(flight, registers, context);
            }
        } else if self.recovery == Some(event) {
            self.recovery_due(registers, context);
        }
        self.settle(registers, context);
    }

    fn on_clock(&mut self, hz: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        if hz != self.clock_hz && self.running(registers) {
            context.tell("FDCAN_CCCR", "the kernel clock changes while the node is on the bus");
        }
        self.clock_hz = hz;
    }

    fn reset(&mut self) {
        let (ram, wire, clock_hz) = (self.ram.clone(), std::mem::take(&mut self.wire), self.clock_hz);
        let (interrupts, requests) = (self.interrupts, std::mem::take(&mut self.requests));
        *self = Self { wire, clock_hz, interrupts, requests, ..Self::new(ram) };
    }

    fn reset_line(&mut self, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        Device::reset(self);
        registers::reset(registers);
        self.settle(registers, context);
    }
}
