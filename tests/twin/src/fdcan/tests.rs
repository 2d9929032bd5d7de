//! The FDCAN as software sees it: through its registers and the message RAM, by RM0433's rules.
//!
//! Offsets and bits are written out here once more, after Linux's `m_can.c`; frame times are counted by hand.

use rigless::emulator::{Error, Memory};
use rigless::mcu::Operate;
use rigless::soc::Width;
use rigless::time::VirtualNanos;
use slipsense_can_model::{Format, Frame, Id, Outcome};

use crate::machine::{Fitted, Twin};
use crate::trouble::{Kind, Trouble};

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
const NDAT1: u64 = 0x98;
const RXF0C: u64 = 0xA0;
const RXF0S: u64 = 0xA4;
const RXF0A: u64 = 0xA8;
const RXBC: u64 = 0xAC;
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
const TXEFC: u64 = 0xF0;
const TXEFS: u64 = 0xF4;
const TXEFA: u64 = 0xF8;

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
const BUFFERS: u64 = 264;
const EVENTS: u64 = 400;
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
    fn new(troubles: Vec<Trouble>) -> Self {
        let fitted = Fitted { episode: None, xl_error: 0.0, troubles, slow: false };
        let twin = Twin::new(&fitted).expect("the part is described");
        let mut bench = Self { twin, now: 1000 };
        bench.store(RCC_APB1HENR, 1 << 8);
        bench.twin.mcu.fdcan[0].clock_hz = CLOCK_HZ;
        bench
    }

    /// Configured and on the bus; `queue` for TXBC's mode.
    fn started(mode: u64, troubles: Vec<Trouble>) -> Self {
        let mut bench = Self::new(troubles);
        bench.configure(mode);
        bench.set(CCCR, FDOE | BRSE);
        bench.wait(20 * BIT_NS);
        bench
    }

    /// Everything that the tests use, in configuration mode.
    fn configure(&mut self, mode: u64) {
        self.set(CCCR, INIT);
        self.set(CCCR, INIT | CCE);
        self.set(CCCR, INIT | CCE | FDOE | BRSE);
        self.set(NBTP, NOMINAL);
        self.set(DBTP, DATA);
        self.set(TDCR, 8 << 8);
        self.set(RXESC, FULL << 8 | FULL << 4 | FULL);
        self.set(TXESC, FULL);
        self.set(TXBC, mode | 3 << 24 | TX << 2);
        self.set(TXEFC, 1 << 24 | 2 << 16 | EVENTS << 2);
        self.set(RXF0C, 2 << 24 | 3 << 16 | FIFO0 << 2);
        self.set(RXF1C, 3 << 16 | FIFO1 << 2);
        self.set(RXBC, BUFFERS << 2);
        self.set(TXBTIE, 0b111);
        self.set(TXBCIE, 0b111);
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

    /// Lets so many nanoseconds pass.
    fn wait(&mut self, ns: u64) {
        let end = self.now + ns;
        while let Some(at) = self.twin.mcu.next_event().filter(|at| at.0 <= end) {
            self.twin.mcu.advance_to(at);
            self.settle();
        }
        self.now = end;
    }

    /// A frame of 8 bytes into a Tx buffer: classic, standard identifier.
    fn fill(&mut self, buffer: u64, id: u64, event: bool) {
        let at = TX + ELEMENT * buffer;
        self.put_word(at, id << 18);
        self.put_word(at + 1, buffer << 24 | u64::from(event) << 23 | 8 << 16);
        self.put_word(at + 2, 0x5555_5555);
        self.put_word(at + 3, 0x5555_5555);
    }

    fn told(&mut self) -> Vec<&'static str> {
        self.twin.mcu.drain_told().into_iter().map(|told| told.reason).collect()
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

/// Software initialization: after a reset INIT stands, CCE needs it, and what is protected needs both.
#[test]
fn protected_registers_take_writes_with_init_and_cce_only() {
    let mut bench = Bench::new(Vec::new());
    assert_eq!(bench.get(CCCR), INIT);
    for (register, reset) in [(NBTP, 0x0600_0A03), (DBTP, 0x0A33), (TXBC, 0), (RXF0C, 0), (GFC, 0)] {
        bench.set(register, 0x0011_0010);
        assert_eq!(bench.get(register), reset, "{register:#x} without CCE");
    }
    assert!(bench.told().iter().any(|line| line.contains("CCE")));
    bench.set(CCCR, INIT | CCE);
    bench.set(TXBC, 3 << 24 | TX << 2);
    assert_eq!(bench.get(TXBC), 3 << 24 | TX << 2);
    // INIT falls, CCE with it, and the registers are closed.
    bench.set(CCCR, 0);
    assert_eq!(bench.get(CCCR) & (INIT | CCE), 0);
    bench.set(TXBC, 0);
    assert_eq!(bench.get(TXBC), 3 << 24 | TX << 2);
    // CCE and INIT in one write: CCE is not taken.
    bench.set(CCCR, INIT | CCE);
    assert_eq!(bench.get(CCCR) & (INIT | CCE), INIT);
    // FDOE and BRSE are protected too.
    bench.set(CCCR, INIT | FDOE | BRSE);
    assert_eq!(bench.get(CCCR) & (FDOE | BRSE), 0);
    bench.set(CCCR, INIT | CCE);
    bench.set(CCCR, INIT | CCE | FDOE | BRSE);
    assert_eq!(bench.get(CCCR), INIT | CCE | FDOE | BRSE);
}

/// Setting CCE drops what was pending.
#[test]
fn configuration_resets_requests_and_fifos() {
    let off = Trouble { name: "off", kind: Kind::NoAcknowledge, when: 0..u64::MAX };
    let mut bench = Bench::started(0, vec![off]);
    bench.fill(0, 1, false);
    bench.set(TXBAR, 1);
    assert_eq!(bench.get(TXBRP), 1);
    bench.wait(300 * BIT_NS);
    bench.set(CCCR, INIT | FDOE | BRSE);
    bench.set(CCCR, INIT | CCE | FDOE | BRSE);
    assert_eq!(bench.get(TXBRP), 0);
    bench.set(TXBAR, 1);
    assert_eq!(bench.get(TXBRP), 0, "no request while CCE is set");
}

/// Tx FIFO: in the order of the requests, whatever the identifiers; three elements.
#[test]
fn the_fifo_sends_in_the_order_of_its_elements() {
    let mut bench = Bench::started(0, Vec::new());
    assert_eq!(bench.get(TXFQS), 3, "three free, both indices 0");
    for (buffer, id) in [(0, 0x300), (1, 0x200), (2, 0x100)] {
        bench.fill(buffer, id, false);
        assert_eq!(bench.get(TXFQS) >> 16 & 0x1F, buffer, "put index");
        bench.set(TXBAR, 1 << buffer);
    }
    assert_eq!(bench.get(TXFQS), 1 << 21, "full");
    bench.wait(1_000_000);
    assert_eq!(bench.sent(), ids(&[0x300, 0x200, 0x100]));
    assert_eq!((bench.get(TXBRP), bench.get(TXBTO)), (0, 0b111));
    assert_ne!(bench.get(IR) & 1 << 11, 0, "TFE");
    assert_ne!(bench.get(IR) & 1 << 9, 0, "TC");
}

/// Tx queue: the smallest identifier of those pending, of equal ones the lowest buffer.
#[test]
fn the_queue_sends_in_the_order_of_identifiers() {
    let mut bench = Bench::started(QUEUE, Vec::new());
    // While the first is on the wires the others queue up behind it.
    for (buffer, id) in [(0, 0x300), (1, 0x200), (2, 0x100)] {
        bench.fill(buffer, id, false);
        bench.set(TXBAR, 1 << buffer);
        bench.wait(10 * BIT_NS);
    }
    bench.wait(1_000_000);
    assert_eq!(bench.sent(), ids(&[0x300, 0x100, 0x200]));
    assert_eq!(bench.get(TXFQS), 0, "empty: put index 0, and level and get index read 0");
}

/// Transmit cancellation: at once while it waits; on the wires it goes through, and TXBCF and TXBTO both tell.
#[test]
fn a_cancelled_frame_leaves_or_goes_through() {
    let mut bench = Bench::started(QUEUE, Vec::new());
    for (buffer, id) in [(0, 0x100), (1, 0x200)] {
        bench.fill(buffer, id, false);
        bench.set(TXBAR, 1 << buffer);
    }
    bench.wait(10 * BIT_NS);
    bench.set(TXBCR, 0b11);
    assert_eq!((bench.get(TXBRP), bench.get(TXBCF)), (0b01, 0b10));
    bench.wait(1_000_000);
    assert_eq!(bench.sent(), ids(&[0x100]));
    assert_eq!((bench.get(TXBRP), bench.get(TXBCF), bench.get(TXBTO)), (0, 0b11, 0b01));
    assert_ne!(bench.get(IR) & 1 << 10, 0, "TCF");
    // A new request takes both flags back.
    bench.fill(0, 0x100, false);
    bench.set(TXBAR, 1);
    assert_eq!((bench.get(TXBCF), bench.get(TXBTO)), (0b10, 0));
}

/// Tx events: marker, identifier, full and lost.
#[test]
fn tx_events_are_stored_until_the_fifo_is_full() {
    let mut bench = Bench::started(0, Vec::new());
    for buffer in 0..3 {
        bench.fill(buffer, 0x123, true);
        bench.set(TXBAR, 1 << buffer);
    }
    bench.wait(1_000_000);
    assert_eq!(bench.get(TXEFS), 1 << 25 | 1 << 24 | 2, "two of two, one lost; put index wrapped");
    assert_eq!(bench.get(IR) >> 12 & 0b1111, 0b1111, "new, watermark, full, lost");
    assert_eq!(bench.word(EVENTS), 0x123 << 18);
    assert_eq!(bench.word(EVENTS + 2 + 1) >> 24, 1, "marker of the second");
    assert_eq!(bench.word(EVENTS + 1) >> 22 & 0b11, 1, "event type: Tx event");
    bench.set(TXEFA, 1);
    assert_eq!(bench.get(TXEFS) & 0x3F, 0, "both acknowledged by the index of the last");
}

/// Standard filters: range, dual, mask, reject, and the global filter for the rest.
#[test]
fn standard_filters_in_their_order() {
    let mut bench = Bench::new(Vec::new());
    bench.configure(0);
    let filter = |kind: u64, to: u64, one: u64, two: u64| kind << 30 | to << 27 | one << 16 | two;
    let filters = [
        filter(0, 1, 0x100, 0x1FF), // range to FIFO 0
        filter(1, 2, 0x200, 0x300), // dual to FIFO 1
        filter(2, 3, 0x400, 0x7F0), // mask 0x400 to 0x40F: rejected
        filter(2, 1, 0x400, 0x700), // 0x400 to 0x4FF, if the one before has not matched
        filter(3, 1, 0x500, 0x500), // switched off
        filter(1, 0, 0x600, 0x600), // switched off
        filter(0, 7, 0x700, 5),     // Rx buffer 5
    ];
    for (index, word) in filters.into_iter().enumerate() {
        bench.put_word(STANDARD + index as u64, word);
    }
    bench.set(SIDFC, (filters.len() as u64) << 16 | STANDARD << 2);
    bench.set(RXF0C, 10 << 16 | FIFO0 << 2);
    // What no filter takes is rejected.
    bench.set(GFC, 0b10 << 4 | 0b10 << 2);
    let frames = [0x0FF, 0x100, 0x1FF, 0x200, 0x250, 0x300, 0x40F, 0x410, 0x500, 0x600, 0x700];
    bench.peer(&frames.map(standard));
    bench.set(CCCR, FDOE | BRSE);
    bench.wait(3_000_000);
    assert_eq!(bench.get(RXF0S) & 0x7F, 3);
    let found: Vec<u64> = (0..3).map(|element| bench.word(FIFO0 + ELEMENT * element) >> 18).collect();
    assert_eq!(found, [0x100, 0x1FF, 0x410]);
    assert_eq!(bench.word(FIFO0 + 2 * ELEMENT + 1) >> 24, 3, "FIDX, ANMF 0");
    assert_eq!(bench.word(FIFO0 + 1) >> 16 & 0xF, 8, "DLC");
    assert_eq!(bench.word(FIFO0 + 2), 0x5555_5555);
    let found: Vec<u64> = (0..2).map(|element| bench.word(FIFO1 + ELEMENT * element) >> 18).collect();
    assert_eq!((found.as_slice(), bench.get(RXF1S) & 0x7F), (&[0x200, 0x300][..], 2));
    assert_eq!((bench.get(NDAT1), bench.word(BUFFERS + 5 * ELEMENT) >> 18), (1 << 5, 0x700));
    bench.set(NDAT1, 1 << 5);
    assert_eq!(bench.get(NDAT1), 0);
}

/// Extended filters: range with and without the XIDAM mask; unmatched ones to FIFO 1.
#[test]
fn extended_filters_with_the_and_mask() {
    let mut bench = Bench::new(Vec::new());
    bench.configure(0);
    bench.put_word(EXTENDED, 1 << 29 | 0x100);
    bench.put_word(EXTENDED + 1, 0x1FF);
    bench.put_word(EXTENDED + 2, 1 << 29 | 0x1000_0200);
    bench.put_word(EXTENDED + 3, 3 << 30 | 0x1000_02FF);
    bench.set(XIDFC, 2 << 16 | EXTENDED << 2);
    bench.set(XIDAM, 0x0000_FFFF);
    bench.set(GFC, 0b10 << 4 | 0b01 << 2);
    bench.peer(&[0x1234_0150, 0x1000_0250, 0x0000_0250].map(extended));
    bench.set(CCCR, FDOE | BRSE);
    bench.wait(2_000_000);
    let found: Vec<u64> = (0..2).map(|element| bench.word(FIFO0 + ELEMENT * element)).collect();
    assert_eq!(found, [1 << 30 | 0x1234_0150, 1 << 30 | 0x1000_0250]);
    assert_eq!(bench.word(FIFO1), 1 << 30 | 0x0250);
    assert_eq!(bench.word(FIFO1 + 1) >> 31, 1, "ANMF");
}

/// Rx FIFO: watermark, full, lost; blocking keeps the old, overwriting the new; acknowledge by index.
#[test]
fn a_full_fifo_blocks_or_overwrites() {
    for overwrite in [false, true] {
        let mut bench = Bench::new(Vec::new());
        bench.configure(0);
        bench.set(RXF0C, u64::from(overwrite) << 31 | 2 << 24 | 3 << 16 | FIFO0 << 2);
        bench.peer(&[1, 2, 3, 4].map(standard));
        bench.set(CCCR, FDOE | BRSE);
        bench.wait(2_000_000);
        let status = bench.get(RXF0S);
        assert_eq!(status & 0x7F, 3);
        assert_ne!(status & 1 << 24, 0, "full");
        assert_eq!(bench.get(IR) & 0b1111, if overwrite { 0b0111 } else { 0b1111 });
        let first = if overwrite { 4 } else { 1 };
        assert_eq!(bench.word(FIFO0) >> 18, first, "element 0");
        let get = status >> 8 & 0x3F;
        assert_eq!(get, u64::from(overwrite));
        bench.set(RXF0A, get);
        assert_eq!(bench.get(RXF0S) & 0x7F, 2);
        bench.set(RXF0A, get);
        assert!(bench.told().iter().any(|line| line.contains("does not hold")), "acknowledged twice");
    }
}

/// Interrupt registers: a flag reaches the line that ILS names, if IE and ILE let it, until it is cleared.
#[test]
fn flags_reach_the_selected_line() {
    let mut bench = Bench::started(0, Vec::new());
    bench.set(IE, 1 << 9 | 1 << 11);
    bench.set(ILS, 1 << 11);
    bench.set(ILE, 0b01);
    bench.fill(0, 1, false);
    bench.set(TXBAR, 1);
    bench.wait(1_000_000);
    assert_eq!(bench.get(IR) & (1 << 9 | 1 << 11), 1 << 9 | 1 << 11);
    assert!(bench.line(0) && !bench.line(1), "line 1 is not enabled");
    bench.set(ILE, 0b11);
    assert!(bench.line(1));
    bench.set(IR, 1 << 9);
    assert!(!bench.line(0) && bench.line(1), "a written one clears");
    bench.set(IE, 0);
    assert!(!bench.line(1));
}

/// Fault confinement: 8 a failed frame; warning at 96, passive at 128, off at 256, with INIT; back after 129
/// times 11 recessive bits from the end of INIT on.
#[test]
fn errors_lead_to_bus_off_and_back() {
    let end = 20_000_000;
    let jam = Trouble { name: "jam", kind: Kind::ErrorFrames { per_million: 1_000_000 }, when: 0..end };
    let mut bench = Bench::started(0, vec![jam]);
    bench.fill(0, 0x10, false);
    bench.set(TXBAR, 1);
    bench.wait(end);
    let attempts = bench.twin.mcu.fdcan[0].wire.log.len();
    assert_eq!(attempts, 32, "256 / 8");
    assert_eq!(bench.get(PSR) & (1 << 5 | 1 << 6 | 1 << 7), 1 << 5 | 1 << 6 | 1 << 7, "EP, EW, BO");
    assert_eq!(bench.get(IR) & 0b111 << 23, 0b111 << 23);
    assert_ne!(bench.get(CCCR) & INIT, 0);
    assert_eq!(bench.get(TXBRP), 1, "the request stays");
    let asked = bench.now;
    bench.set(CCCR, FDOE | BRSE);
    bench.wait(10_000_000);
    let log = &bench.twin.mcu.fdcan[0].wire.log;
    let back = log.get(32).expect("sent after the recovery").start_ns - asked;
    assert!((129 * 11..129 * 11 + 12).contains(&(back / BIT_NS)), "back after {back} ns");
    assert_eq!(bench.get(ECR) & 0xFF, 0);
    assert_eq!(bench.get(PSR) & 1 << 7, 0);
}

/// Without acknowledge the node becomes passive and stays on the bus: an error passive transmitter's counter does not
/// rise for a missing acknowledge (ISO 11898-1, fault confinement, rule c exception 1).
#[test]
fn a_missing_acknowledge_never_leads_to_bus_off() {
    let off = Trouble { name: "off", kind: Kind::NoAcknowledge, when: 0..50_000_000 };
    let mut bench = Bench::started(0, vec![off]);
    bench.fill(0, 0x10, false);
    bench.set(TXBAR, 1);
    bench.wait(49_000_000);
    assert_eq!(bench.get(ECR) & 0xFF, 128);
    assert_eq!(bench.get(PSR) & 0b111, 3, "LEC: acknowledge error");
    assert_eq!(bench.get(PSR) & 0b111, 7, "LEC: no change since it was read");
    bench.wait(2_000_000);
    assert_eq!(bench.sent().len(), 1);
    assert_eq!(bench.get(ECR) & 0xFF, 127, "down by one");
}

/// Timestamp counter: nominal bit times, a prescaler, reset by a write; the frame's is that of its start.
#[test]
fn the_timestamp_counts_nominal_bits() {
    let mut bench = Bench::new(Vec::new());
    bench.configure(0);
    bench.set(TSCC, 3 << 16 | 1);
    bench.set(CCCR, FDOE | BRSE);
    bench.wait(1_000_000);
    assert_eq!(bench.get(TSCV), 250);
    bench.set(TSCV, 0);
    assert_eq!(bench.get(TSCV), 0);
    bench.wait(400_000);
    bench.fill(0, 1, true);
    bench.set(TXBAR, 1);
    bench.wait(500_000);
    let stamp = bench.word(EVENTS + 1) & 0xFFFF;
    assert!((100..=101).contains(&stamp), "{stamp}");
}

/// A frame of 64 bytes without a dynamic stuff bit, by hand: 16 bits to `res`, BRS half of each rate, 549 bits at the
/// data rate (ESI, DLC, data, stuff count, CRC-21, 7 fixed stuff bits), CRC delimiter, 9 bits.
#[test]
fn an_fd_frame_takes_the_time_of_its_bits() {
    let mut bench = Bench::started(0, Vec::new());
    bench.put_word(TX, 0x555 << 18);
    bench.put_word(TX + 1, 1 << 21 | 1 << 20 | 0xF << 16);
    (0..16).for_each(|word| bench.put_word(TX + 2 + word, 0x5555_5555));
    bench.set(TXBAR, 1);
    bench.wait(1_000_000);
    let cycles = 16 * 80 + (64 + 2) + (1 + 4 + 512 + 4 + 21 + 7) * 10 + (8 + 16) + 9 * 80;
    let frame = &bench.twin.mcu.fdcan[0].wire.log[0];
    assert_eq!(frame.frame.format(), Format::FD);
    assert!((frame.end_ns - frame.start_ns).abs_diff(cycles * 1_000_000_000 / CLOCK_HZ) <= 1);
}

/// A classic frame against its bits, CRC-15 and stuffing counted here.
#[test]
fn a_classic_frame_takes_the_time_of_its_bits() {
    let mut bench = Bench::started(0, Vec::new());
    bench.fill(0, 0x555, false);
    bench.set(TXBAR, 1);
    bench.wait(1_000_000);
    let mut bits = vec![0];
    let mut push = |value: u64, width: u32| bits.extend((0..width).rev().map(|bit| value >> bit & 1));
    push(0x555, 11);
    push(0b000, 3);
    push(8, 4);
    push(0x5555_5555_5555_5555, 64);
    let crc = bits.iter().fold(0u64, |crc, bit| {
        let next = crc << 1 & 0x7FFF;
        if crc >> 14 ^ bit == 1 { next ^ 0x4599 } else { next }
    });
    bits.extend((0..15).rev().map(|bit| crc >> bit & 1));
    let (mut stuffed, mut run, mut last) = (0, 0, 2);
    for &bit in &bits {
        run = if bit == last { run + 1 } else { 1 };
        last = bit;
        if run == 5 {
            stuffed += 1;
            (run, last) = (1, 1 - bit);
        }
    }
    // Delimiter, acknowledge and its delimiter, end of frame.
    let total = bits.len() as u64 + stuffed + 3 + 7;
    let frame = &bench.twin.mcu.fdcan[0].wire.log[0];
    assert_eq!(frame.end_ns - frame.start_ns, total * BIT_NS);
}

/// FDOE off: a classic frame, whatever the element says; BRS falls with it.
#[test]
fn without_fdoe_frames_are_classic() {
    let mut bench = Bench::new(Vec::new());
    bench.configure(0);
    bench.set(CCCR, INIT | CCE);
    bench.set(CCCR, 0);
    bench.wait(20 * BIT_NS);
    bench.put_word(TX, 0x123 << 18);
    bench.put_word(TX + 1, 1 << 21 | 1 << 20 | 8 << 16);
    bench.set(TXBAR, 1);
    bench.wait(1_000_000);
    assert_eq!(bench.twin.mcu.fdcan[0].wire.log[0].frame.format(), Format::Classic);
}
