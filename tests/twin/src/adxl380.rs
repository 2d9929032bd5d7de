//! An ADXL380 on SPI, playing the accelerations of an episode at the rate of an oscillator of its own.
//!
//! Registers and FIFO as the drivers of Linux (`adxl380.c`) and Analog Devices (no-OS, `adxl38x`) use them; the data
//! sheet was not at hand. What is not known: how soon after leaving standby the first sample comes (here: one
//! period), whether an overflow drops single axes (here: yes, the oldest entries).

use std::collections::VecDeque;
use std::sync::Arc;

use rigless::chip::Timeline;
use rigless::chip::spi::Peer;
use rigless::snapshot::Store;

use crate::bench::{self, Desk, DeskFault};
use crate::fault_injection::Kind;
use crate::fitted::Fitted;
use crate::xl::{self, Readouts, Xl};

const DEVID_AD: u8 = 0x00;
const DEVID_MST: u8 = 0x01;
const PART_ID: u8 = 0x02;
const STATUS0: u8 = 0x11;
const FIFO_DATA: u8 = 0x1D;
const FIFO_STATUS0: u8 = 0x1E;
const FIFO_STATUS1: u8 = 0x1F;
const MISC0: u8 = 0x20;
const OP_MODE: u8 = 0x26;
const DIG_EN: u8 = 0x27;
const RESET: u8 = 0x2A;
const FIFO_CFG0: u8 = 0x30;

const RESET_CODE: u8 = 0x52;
/// Until it answers after a reset.
const RESET_NS: u64 = 500_000;
/// FIFO_EN and the three axes of DIG_EN.
const FIFO_ENABLE: u8 = 1 << 3;
const XYZ: u8 = 0b0111_0000;
/// Channel identifiers in FIFO_CFG0.
const CHANNEL_ID: u8 = 1 << 6;
/// OP_MODE's modes that deliver 8 kHz: high performance.
const HIGH_PERFORMANCE: u8 = 12;
const ENTRIES: usize = 315;
/// Samples that it makes in the time of one while its oscillator is in fault: 133 in a frame, and the FIFO holds 105.
const TOO_FAST: usize = 4;

#[derive(Debug, Default)]
pub struct Adxl380 {
    /// For the comparison, where the bus did not carry the samples.
    readouts: Readouts,
    batch: Vec<i16>,
    fitted: Arc<Fitted>,
    /// At rest, in place of the episode.
    desk: Option<Desk>,
    sensor: usize,
    period_ns: f64,
    /// All 128.
    registers: Vec<u8>,
    fifo: VecDeque<(u8, i16)>,
    /// When measuring began, and samples since then.
    measuring: Option<u64>,
    made: u64,
    /// Samples taken from the episode so far.
    played: usize,
    silent_until: u64,
    /// Command of this transaction, and the byte of an entry that comes next.
    command: Option<u8>,
    address: u8,
    entry: Option<(u8, i16)>,
    entry_byte: usize,
}

impl Adxl380 {
    /// Behind the array of index `sensor`.
    pub fn new(fitted: &Arc<Fitted>, sensor: usize, readouts: Readouts) -> Self {
        let desk = fitted.desk.map(|desk| desk.at(sensor));
        let error = if bench::has(desk, DeskFault::XlSlow) { -0.1 } else { xl::OSCILLATOR_ERROR };
        let mut part = Self {
            readouts,
            fitted: fitted.clone(),
            desk,
            sensor,
            period_ns: 1e9 / Xl::Adxl380.rate_hz(error),
            ..Self::default()
        };
        part.power_up();
        part
    }

    fn power_up(&mut self) {
        self.registers = vec![0; 128];
        for (register, value) in [(DEVID_AD, 0xAD), (DEVID_MST, 0x1D), (PART_ID, 0x17), (PART_ID + 1, 0xC0)] {
            self.registers[usize::from(register)] = value;
        }
        self.fifo.clear();
        self.measuring = None;
    }

    fn register(&self, register: u8) -> u8 {
        self.registers[usize::from(register & 0x7F)]
    }

    /// Samples that the oscillator has made by now go to the FIFO.
    fn advance(&mut self, now: u64) {
        let Some(since) = self.measuring else { return };
        let due = ((now.saturating_sub(since)) as f64 / self.period_ns) as u64;
        while self.made < due {
            self.made += 1;
            let at = since + (self.made as f64 * self.period_ns) as u64;
            let faulted = |what| self.fitted.faults.active(at).any(|kind| kind == what);
            if faulted(Kind::AccelerometerStops) || bench::has(self.desk, DeskFault::XlStops) {
                continue;
            }
            let samples = if faulted(Kind::FifoOverrun) { TOO_FAST } else { 1 };
            (0..samples).for_each(|_| self.make_sample());
        }
    }

    fn make_sample(&mut self) {
        let played = || xl::true_sample(self.fitted.episode.as_deref(), self.sensor, self.played);
        let sample = self.desk.map_or_else(played, |desk| desk.sample(self.played));
        self.played += 1;
        if self.register(DIG_EN) & FIFO_ENABLE == 0 {
            return;
        }
        for (axis, value) in sample.into_iter().enumerate() {
            if self.fifo.len() == ENTRIES {
                self.fifo.pop_front();
            }
            self.fifo.push_back((axis as u8, value));
        }
    }

    fn read_byte(&mut self) -> u8 {
        let register = self.address;
        if register == FIFO_DATA {
            return self.fifo_byte();
        }
        self.address = self.address.wrapping_add(1) & 0x7F;
        match register {
            FIFO_STATUS0 => self.fifo.len() as u8,
            FIFO_STATUS1 => (self.fifo.len() >> 8) as u8 & 1,
            STATUS0 => u8::from(!self.fifo.is_empty()),
            // Bit 7 is the ADXL382's.
            MISC0 => {
                let is_382 = bench::has(self.desk, DeskFault::XlWrong);
                self.register(MISC0) & 0x7F | u8::from(is_382) << 7
            }
            other => self.register(other),
        }
    }

    /// An entry is its axis, if identifiers are on, then the value, high byte first. An empty FIFO gives zeros.
    fn fifo_byte(&mut self) -> u8 {
        let identified = self.register(FIFO_CFG0) & CHANNEL_ID != 0;
        if self.entry.is_none() {
            self.entry = self.fifo.pop_front();
            self.entry_byte = usize::from(!identified);
        }
        let Some((axis, value)) = self.entry else { return 0 };
        let [high, low] = value.to_be_bytes();
        let byte = [axis, high, low][self.entry_byte];
        self.entry_byte += 1;
        if self.entry_byte == 3 {
            self.entry = None;
            self.batch.push(value);
        }
        byte
    }

    fn write_byte(&mut self, value: u8, now: u64) {
        let register = self.address;
        self.address = self.address.wrapping_add(1) & 0x7F;
        if register == RESET && value == RESET_CODE {
            self.power_up();
            self.silent_until = now + RESET_NS;
            return;
        }
        if matches!(register, DEVID_AD..=0x03 | STATUS0..=FIFO_STATUS1 | RESET) {
            return;
        }
        self.registers[usize::from(register)] = value;
        if register == OP_MODE {
            let measures = value & 0xF == HIGH_PERFORMANCE && self.register(DIG_EN) & XYZ == XYZ;
            self.measuring = measures.then_some(now);
            self.made = 0;
        }
    }
}

impl Store for Adxl380 {}

impl Peer for Adxl380 {
    fn transfer(&mut self, mosi: u32, bits: u8, context: &mut Timeline<'_, '_>) -> u32 {
        if [DeskFault::MisoOpen, DeskFault::SelectOpen].iter().any(|&fault| bench::has(self.desk, fault)) {
            return 0xFF;
        }
        let now = context.now().0;
        if now < self.silent_until || bits != 8 {
            return 0;
        }
        let Some(command) = self.command else {
            self.advance(now);
            self.command = Some(mosi as u8);
            self.address = (mosi as u8) >> 1;
            return 0;
        };
        if command & 1 != 0 {
            return self.read_byte().into();
        }
        self.write_byte(mosi as u8, now);
        0
    }

    fn select(&mut self, _context: &mut Timeline<'_, '_>) {
        self.command = None;
        self.entry = None;
    }

    fn deselect(&mut self, context: &mut Timeline<'_, '_>) {
        let samples = self.batch.chunks_exact(3).map(|xyz| [xyz[0], xyz[1], xyz[2]]).collect();
        xl::note(&self.readouts, context.now().0, samples);
        self.batch.clear();
    }
}
