//! The FDCAN as software sees it: through its registers and the message RAM, by RM0433's rules.
//!
//! Offsets and bits are written out here once more, after Linux's `m_can.c`; frame times are counted by hand.

mod loopback;
mod rx;
mod setup;
mod tx;
mod wires;

use rigless::emulator::{Error, Memory};
use rigless::mcu::Operate;
use rigless::soc::Width;
use rigless::time::VirtualNanos;
use slipsense_can_sim::{Format, Frame, Id, Outcome};

use crate::fault_injection::{Fault, Faults, Kind};
use crate::fitted::Fitted;
use crate::machine::Twin;

const FDCAN1: u64 = 0x4000_A000;
const RAM: u64 = 0x4000_AC00;
const RCC_APB1HENR: u64 = 0x5802_44EC;

const DBTP: u64 = 0x0C;
const CCCR: u64 = 0x18;
const NBTP: u64 = 0x1C;
const TSCC: u64 = 0x20;
const TSCV: u64 = 0x24;
const ECR: u64 = 0x40;
const PSR: u64 = 0x44;
const TDCR: u64 = 0x48;
const IR: u64 = 0x50;
const IE: u64 = 0x54;
const ILS: u64 = 0x58;
const ILE: u64 = 0x5C;
const GFC: u64 = 0x80;
const SIDFC: u64 = 0x84;
const XIDFC: u64 = 0x88;
const XIDAM: u64 = 0x90;
const RXF0C: u64 = 0xA0;
const RXF0S: u64 = 0xA4;
const RXF0A: u64 = 0xA8;
const RXF1C: u64 = 0xB0;
const RXF1S: u64 = 0xB4;
const RXESC: u64 = 0xBC;
const TXBC: u64 = 0xC0;
const TXFQS: u64 = 0xC4;
const TXESC: u64 = 0xC8;
const TXBRP: u64 = 0xCC;
const TXBAR: u64 = 0xD0;
const TXBCR: u64 = 0xD4;
const TXBTO: u64 = 0xD8;
const TXBCF: u64 = 0xDC;
const TXBTIE: u64 = 0xE0;
const TXBCIE: u64 = 0xE4;

const INIT: u64 = 1 << 0;
const CCE: u64 = 1 << 1;
const FDOE: u64 = 1 << 8;
const BRSE: u64 = 1 << 9;
const QUEUE: u64 = 1 << 30;

/// Where the tests put things, in words; elements of 64 bytes.
const STANDARD: u64 = 0;
const EXTENDED: u64 = 32;
const FIFO0: u64 = 64;
const FIFO1: u64 = 164;
const TX: u64 = 500;
const ELEMENT: u64 = 18;
const FULL: u64 = 0b111;

/// 80 MHz: 1 Mbit/s sampled at 64 of 80 quanta, 8 Mbit/s at 8 of 10.
const CLOCK_HZ: u64 = 80_000_000;
const NOMINAL: u64 = 15 << 25 | 62 << 8 | 15;
const DATA: u64 = 1 << 23 | 6 << 8 | 1 << 4 | 1;
const BIT_NS: u64 = 1000;

struct Bench {
    twin: Twin,
    now: u64,
}

/// The FDCAN reaches no memory of the core.
struct Nothing;

impl Memory for Nothing {
    fn read(&mut self, address: u64, width: Width) -> Result<u64, Error> {
        Err(Error::Memory { address, width })
    }

    fn write(&mut self, address: u64, width: Width, _: u64) -> Result<(), Error> {
        Err(Error::Memory { address, width })
    }
}

impl Bench {
    fn new(faults: Vec<Fault>) -> Self {
        let fitted =
            Fitted { faults: Faults::new(faults), hse_hz: crate::machine::HSE_HZ, ..Fitted::default() };
        let twin = Twin::new(&fitted.into()).expect("the part is described");
        let mut bench = Self { twin, now: 1000 };
        bench.store(RCC_APB1HENR, 1 << 8);
        bench.twin.mcu.fdcan[0].clock_hz = CLOCK_HZ;
        bench
    }

    /// Configured and on the bus.
    fn started(faults: Vec<Fault>) -> Self {
        let mut bench = Self::configured(faults);
        bench.set(CCCR, FDOE | BRSE);
        bench.wait(20 * BIT_NS);
        bench
    }

    fn configured(faults: Vec<Fault>) -> Self {
        let mut bench = Self::new(faults);
        bench.set(CCCR, INIT);
        bench.set(CCCR, INIT | CCE);
        bench.set(CCCR, INIT | CCE | FDOE | BRSE);
        bench.set(NBTP, NOMINAL);
        bench.set(DBTP, DATA);
        bench.set(TDCR, 8 << 8);
        bench.set(RXESC, FULL << 8 | FULL << 4 | FULL);
        bench.set(TXESC, FULL);
        bench.set(TXBC, QUEUE | 3 << 24 | TX << 2);
        bench.set(RXF0C, 2 << 24 | 3 << 16 | FIFO0 << 2);
        bench.set(RXF1C, 3 << 16 | FIFO1 << 2);
        bench.set(TXBTIE, 0b111);
        bench.set(TXBCIE, 0b111);
        bench
    }

    fn settle(&mut self) {
        self.twin.mcu.settle(&mut Nothing).expect("no model asks for memory");
    }

    fn store(&mut self, address: u64, value: u64) {
        self.twin.mcu.write(VirtualNanos(self.now), address, Width::W32, value).expect("mapped");
        self.settle();
    }

    fn set(&mut self, register: u64, value: u64) {
        self.store(FDCAN1 + register, value);
    }

    fn get(&mut self, register: u64) -> u64 {
        let value = self.twin.mcu.read(VirtualNanos(self.now), FDCAN1 + register, Width::W32);
        self.settle();
        value.expect("mapped")
    }

    fn word(&mut self, word: u64) -> u64 {
        self.twin.mcu.read(VirtualNanos(self.now), RAM + 4 * word, Width::W32).expect("mapped")
    }

    fn put_word(&mut self, word: u64, value: u64) {
        self.store(RAM + 4 * word, value);
    }

    fn wait(&mut self, ns: u64) {
        let end = self.now + ns;
        while let Some(at) = self.twin.mcu.next_event().filter(|at| at.0 <= end) {
            self.twin.mcu.advance_to(at);
            self.settle();
        }
        self.now = end;
    }

    /// A frame of 8 bytes into a Tx buffer, classic, standard identifier, and its request.
    fn send(&mut self, buffer: u64, id: u64) {
        let words = [id << 18, 8 << 16, 0x5555_5555, 0x5555_5555];
        (TX + ELEMENT * buffer..).zip(words).for_each(|(at, word)| self.put_word(at, word));
        self.set(TXBAR, 1 << buffer);
    }

    /// Since the last call, a report with this text.
    fn tells(&mut self, text: &str) -> bool {
        self.twin.mcu.drain_told().into_iter().any(|told| told.reason.contains(text))
    }

    fn sent(&self) -> Vec<Id> {
        let log = &self.twin.mcu.fdcan[0].wire.log;
        log.iter().filter(|frame| frame.outcome == Outcome::Sent).map(|frame| frame.frame.id()).collect()
    }

    /// The far end sends these, one after the other.
    fn peer(&mut self, frames: &[Frame]) {
        let now = self.now;
        self.twin.mcu.fdcan[0].wire.peer_queue.extend(frames.iter().map(|frame| (now, *frame)));
    }

    fn line(&self, line: usize) -> bool {
        self.twin.mcu.fdcan[0].lines[line]
    }
}

fn standard(id: u16) -> Frame {
    Frame::new(Id::Standard(id), Format::Classic, &[0x55; 8]).expect("a frame")
}

fn extended(id: u32) -> Frame {
    Frame::new(Id::Extended(id), Format::Classic, &[0x55; 8]).expect("a frame")
}

fn ids(standard: &[u16]) -> Vec<Id> {
    standard.iter().map(|id| Id::Standard(*id)).collect()
}
