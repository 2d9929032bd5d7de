//! The FDCAN of the STM32H743, which the emulator has no model of.
//!
//! Written from RM0433 (chapter FDCAN; section titles beside each behaviour, as remembered, since neither manual nor
//! M_CAN's could be had here) and from what embassy-stm32 0.6 programs; frame times, arbitration and error counters
//! are `slipsense-can-model`'s.
//!
//! | covered | section |
//! |---|---|
//! | INIT, CCE, protected registers; what CCE resets | software initialization |
//! | bit timings, FDOE, BRSE, DAR, MON, loopback, ASM | operating modes |
//! | Tx FIFO and queue, dedicated buffers, cancellation, Tx events | Tx handling |
//! | filters, Rx FIFOs, dedicated Rx buffers | Rx handling |
//! | IR, IE, ILS, ILE, TXBTIE, TXBCIE | interrupt registers |
//! | ECR, PSR, bus-off and recovery | error management |
//! | TSCV from nominal bit times | timestamp generation |
//!
//! Not covered: timeout counter, high-priority status, message RAM watchdog, clock stop's handshake time, restricted
//! mode's receive path, time-triggered operation, the clock calibration unit, transceiver delay (the wires have
//! none). A touched register of those is told.

mod filters;
pub mod message_ram;
mod registers;
#[cfg(test)]
mod tests;
pub mod wire;

use rigless::device::{Device, DeviceContext, Level, RegisterFile};
use rigless::soc::Layout;
use rigless::soc::stm32h743::generated::fdcan1::Register;
use rigless::time::{EventId, VirtualNanos};
use slipsense_can_model::{Attempt, BitTiming, ErrorState, Frame, Outcome, Timing};

use filters::Accepted;
use message_ram::{MessageRam, TxElement, element_bytes, head_word, tail_word, write_rx};
use registers::{LOOPBACK, Rule, cccr, field, interrupt, psr, rule};
use wire::{MCU, PEER, Wire};

/// Places of the two interrupt lines in the instance's list.
const LINES: [usize; 2] = [0, 1];

/// A frame on the wires.
#[derive(Debug)]
struct InFlight {
    attempt: Attempt,
    frame: Frame,
    /// The Tx buffer it came from.
    buffer: Option<u32>,
    timestamp: u16,
    event: EventId,
}

/// One instance.
#[derive(Debug)]
pub struct Fdcan {
    ram: MessageRam,
    /// What it is connected to.
    pub wire: Wire,
    /// Kernel clock.
    clock_hz: u64,
    timing: Option<Timing>,
    in_flight: Option<InFlight>,
    start: Option<(EventId, u64)>,
    recovery: Option<EventId>,
    /// Elements as they were when their transmission was requested.
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
    /// Every register as the last call left it: the bus lets a write land before the model hears of it.
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

    fn write_cccr(
        &mut self,
        value: u64,
        old: u64,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        let configurable = old & (cccr::INIT | cccr::CCE) == cccr::INIT | cccr::CCE;
        let mut new = value & 0xF3FF & !cccr::CSA;
        if !configurable {
            let changed = (old ^ new) & cccr::PROTECTED | new & !old & cccr::PROTECTED_SET;
            if changed != 0 {
                context.tell(
                    "FDCAN_CCCR",
                    "a bit that is protected was changed without CCE and INIT, and is ignored",
                );
            }
            new = (new & !cccr::PROTECTED) | (old & cccr::PROTECTED);
            new &= !cccr::PROTECTED_SET | old;
        }
        // CCE can be set only while INIT is, and falls with it.
        if new & cccr::INIT == 0 || old & cccr::INIT == 0 {
            if new & cccr::CCE != 0 && old & cccr::INIT == 0 {
                context.tell("FDCAN_CCCR", "CCE was set before INIT read as set, and is ignored");
            }
            new &= !cccr::CCE;
        }
        if new & cccr::CSR != 0 {
            // Clock stop request: acknowledged once the bus is idle, here at once, with INIT set.
            new |= cccr::CSA | cccr::INIT;
        }
        registers.set(Register::FdcanCccr, new);
        if new & cccr::CCE != 0 && old & cccr::CCE == 0 {
            self.configuration_begins(registers);
        }
        if new & cccr::INIT != 0 && old & cccr::INIT == 0 {
            if self.in_flight.take().is_some() {
                context.tell("FDCAN_CCCR", "INIT was set while a frame was on the bus, which is cut off");
            }
            self.start = None;
        }
        if new & cccr::INIT == 0 && old & cccr::INIT != 0 {
            self.join(registers, context);
        }
    }

    /// Software initialization: setting CCE resets these.
    fn configuration_begins(&mut self, registers: &mut RegisterFile) {
        use Register as R;
        for register in
            [R::FdcanHpms, R::FdcanRxf0s, R::FdcanRxf1s, R::FdcanTxbrp, R::FdcanTxbto, R::FdcanTxbcf]
        {
            registers.set(register, 0);
        }
        registers.set(R::FdcanTxfqs, 0);
        registers.set(R::FdcanTxefs, 0);
        self.requested = [const { None }; 32];
        (self.tx_get, self.event_get, self.event_put, self.cancelled) = (0, 0, 0, 0);
        (self.rx_get, self.rx_put) = ([0; 2], [0; 2]);
    }

    /// INIT was cleared: bit timings are taken, and the node joins after 11 recessive bits, or after its recovery.
    fn join(&mut self, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        let (nominal, data) = (registers.get(Register::FdcanNbtp), registers.get(Register::FdcanDbtp));
        let nominal = BitTiming {
            prescaler: field(nominal, 16, 9) as u32 + 1,
            seg1: field(nominal, 8, 8) as u32 + 1,
            seg2: field(nominal, 0, 7) as u32 + 1,
        };
        let delay_compensation = data >> 23 & 1 != 0;
        let data = BitTiming {
            prescaler: field(data, 16, 5) as u32 + 1,
            seg1: field(data, 8, 5) as u32 + 1,
            seg2: field(data, 4, 4) as u32 + 1,
        };
        self.check_timing(&nominal, &data, delay_compensation, registers, context);
        let Ok(clock_hz) = u32::try_from(self.clock_hz) else { return };
        if clock_hz == 0 {
            context.tell("FDCAN_CCCR", "INIT was cleared while the kernel clock stands still");
            return;
        }
        let timing = Timing { clock_hz, nominal, data };
        self.timing = Some(timing);
        self.timestamp_from = context.now().0;
        if let Some(at) = self.wire.join(context.now().0, timing) {
            self.recovery = Some(context.schedule(VirtualNanos(at)));
        }
        self.update_fifo(registers);
        self.schedule_start(registers, context);
    }

    /// Nominal and data bit time: at least 4 quanta, jump width within segment 2, and above 1 Mbit/s compensation
    /// of the transceiver's delay with a prescaler of 1 or 2 (transceiver delay compensation).
    fn check_timing(
        &self,
        nominal: &BitTiming,
        data: &BitTiming,
        compensated: bool,
        registers: &RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        let nsjw = field(registers.get(Register::FdcanNbtp), 25, 7) as u32 + 1;
        let dsjw = field(registers.get(Register::FdcanDbtp), 0, 4) as u32 + 1;
        if nsjw > nominal.seg2 {
            context.tell("FDCAN_NBTP", "the jump width is wider than the segment after the sample point");
        }
        let control = registers.get(Register::FdcanCccr);
        if control & cccr::FDOE == 0 || control & cccr::BRSE == 0 {
            return;
        }
        if dsjw > data.seg2 {
            context.tell("FDCAN_DBTP", "the jump width is wider than the segment after the sample point");
        }
        let bit_rate = self.clock_hz / u64::from(data.cycles());
        if bit_rate > 1_000_000 && !compensated {
            context.tell("FDCAN_DBTP", "more than 1 Mbit/s without transceiver delay compensation (TDC)");
        }
        if compensated && data.prescaler > 2 {
            context.tell("FDCAN_DBTP", "delay compensation needs a prescaler of 1 or 2");
        }
        if compensated && registers.get(Register::FdcanTdcr) >> 8 & 0x7F == 0 {
            context
                .tell("FDCAN_TDCR", "delay compensation with an offset of 0 samples before the sample point");
        }
    }

    // Tx handling

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
        let passive = self.wire.bus().node(MCU).state() == ErrorState::Passive;
        let word = start + buffer as usize * TxElement::words(bytes);
        TxElement::read(&self.ram, word, bytes, control & cccr::FDOE != 0, control & cccr::BRSE != 0, passive)
    }

    fn request(&mut self, value: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
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

    fn cancel(&mut self, value: u64, registers: &mut RegisterFile) {
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
    fn update_fifo(&mut self, registers: &mut RegisterFile) {
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
    fn offer(&self, registers: &RegisterFile) -> Option<(u32, Frame)> {
        if !self.running(registers)
            || registers.get(Register::FdcanCccr) & (cccr::MON | cccr::ASM) != 0 && !self.loops(registers)
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

    fn loops(&self, registers: &RegisterFile) -> bool {
        registers.get(Register::FdcanCccr) & cccr::TEST != 0
            && registers.get(Register::FdcanTest) & LOOPBACK != 0
    }

    fn schedule_start(&mut self, registers: &RegisterFile, context: &mut DeviceContext<'_>) {
        if !self.running(registers) || self.in_flight.is_some() {
            return;
        }
        let offered = self.offer(registers).is_some();
        let Some(at) = self.wire.next_start(context.now().0, offered) else { return };
        if self.start.is_none_or(|(_, planned)| at < planned) {
            self.start = Some((context.schedule(VirtualNanos(at)), at));
        }
    }

    fn start_frame(&mut self, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        let mine = self.offer(registers);
        let timestamp = self.timestamp(registers, context.now().0);
        let Some((attempt, frame)) = self.wire.start(context.now().0, mine.as_ref().map(|(_, frame)| frame))
        else {
            self.schedule_start(registers, context);
            return;
        };
        let buffer = mine.map(|(buffer, _)| buffer).filter(|_| attempt.node == MCU);
        if let Some(buffer) = buffer
            && self.requested[buffer as usize].as_ref().map(|element| element.frame.data())
                != Some(frame.data())
        {
            context.tell("FDCAN_TXBRP", "a Tx buffer was changed after its transmission was requested");
        }
        let event = context.schedule(VirtualNanos(self.wire.end_ns(&attempt)));
        self.in_flight = Some(InFlight { attempt, frame, buffer, timestamp, event });
    }

    fn end_frame(&mut self, flight: InFlight, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        let looped = self.loops(registers);
        let sent = flight.attempt.outcome == Outcome::Sent
            || looped && flight.attempt.outcome == Outcome::NotAcknowledged;
        if let Some(buffer) = flight.buffer {
            self.end_own(buffer, sent, &flight, registers, context);
        }
        if sent && (flight.attempt.node == PEER || looped) {
            self.receive(&flight.frame, flight.timestamp, registers);
        }
        self.update_status(&flight, registers);
        self.schedule_start(registers, context);
    }

    fn end_own(
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

    // Rx handling

    fn receive(&mut self, frame: &Frame, timestamp: u16, registers: &mut RegisterFile) {
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

    fn acknowledge_rx(
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

    fn acknowledge_events(
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

    // Error management

    fn update_status(&mut self, flight: &InFlight, registers: &mut RegisterFile) {
        let mut status = registers.get(Register::FdcanPsr);
        let code = match flight.attempt.outcome {
            Outcome::Sent => 0,
            Outcome::NotAcknowledged => psr::ACK_ERROR,
            Outcome::Error(_) => psr::BIT0_ERROR,
        };
        let format = flight.frame.format();
        let in_data = format.switches()
            && matches!(flight.attempt.outcome, Outcome::Error(field) if field >= slipsense_can_model::Field::Data && field < slipsense_can_model::Field::AckSlot);
        if in_data {
            status = status & !psr::DLEC | code << 8;
        } else {
            status = status & !psr::LEC | code;
        }
        if code != 0 {
            self.raise(if in_data { interrupt::PED } else { interrupt::PEA }, registers);
        }
        if flight.attempt.node == PEER && format.is_fd() {
            status |= psr::RFDF | if format.switches() { psr::RBRS } else { 0 };
        }
        registers.set(Register::FdcanPsr, status);
        self.update_counters(registers);
    }

    /// ECR, and the flags of PSR and IR that follow the counters.
    fn update_counters(&mut self, registers: &mut RegisterFile) {
        let node = *self.wire.bus().node(MCU);
        let state = node.state();
        let passive_receiver = node.receive_errors() > 127;
        let counters = u64::from(node.transmit_errors().min(255))
            | u64::from(node.receive_errors().min(127)) << 8
            | u64::from(passive_receiver) << 15;
        registers.set(Register::FdcanEcr, counters);
        let before = registers.get(Register::FdcanPsr);
        let bit = |set: bool, bit: u64| if set { bit } else { 0 };
        let flags = bit(state != ErrorState::Active, psr::EP)
            | bit(node.warns(), psr::EW)
            | bit(state == ErrorState::BusOff, psr::BO);
        let after = before & !(psr::EP | psr::EW | psr::BO) | flags;
        registers.set(Register::FdcanPsr, after);
        let changed = before ^ after;
        let raised = bit(changed & psr::EP != 0, interrupt::EP)
            | bit(changed & psr::EW != 0, interrupt::EW)
            | bit(changed & psr::BO != 0, interrupt::BO);
        self.raise(raised, registers);
        if state == ErrorState::BusOff && self.was != ErrorState::BusOff {
            // Bus-off: INIT is set by hardware, and the node stays silent until software clears it.
            registers.set(Register::FdcanCccr, registers.get(Register::FdcanCccr) | cccr::INIT);
            self.start = None;
        }
        self.was = state;
    }

    fn recovery_due(&mut self, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        self.wire.advance(context.now().0);
        if let Some(at) = self.wire.returns() {
            self.recovery = Some(context.schedule(VirtualNanos(at)));
            return;
        }
        self.recovery = None;
        self.update_counters(registers);
        self.schedule_start(registers, context);
    }

    /// Timestamp generation: nominal bit times over TCP + 1, 16 bits.
    fn timestamp(&self, registers: &RegisterFile, now_ns: u64) -> u16 {
        let tscc = registers.get(Register::FdcanTscc);
        let Some(timing) = self.timing.filter(|_| tscc & 3 == 1) else { return 0 };
        let step = u64::from(timing.nominal.cycles()) * (field(tscc, 16, 4) + 1);
        let elapsed = u128::from(now_ns - self.timestamp_from) * u128::from(timing.clock_hz) / 1_000_000_000;
        (elapsed / u128::from(step)) as u16
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
            // Reading clears what it tells: LEC and DLEC go to "no change", the receive flags and PXE to 0, CEL
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
                let new = if self.before(R::FdcanCccr) & cccr::TEST != 0 { value & 0xF0 } else { old };
                if new != value & 0xF0 {
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
