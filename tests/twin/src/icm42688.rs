//! An ICM-42688-P on SPI: the emulator's own model, which nobody here wrote, and around it what makes it play an
//! episode.
//!
//! The model (DS-000347 rev 1.6) has registers, FIFO and packets, and makes the samples that fell due whenever it is
//! selected or written to, all of them from the one acceleration set last. So each sample is an event here, 125 µs after
//! the one before: the model gets the acceleration and is selected, and makes this one sample. To a reader amid a read the
//! address of the byte that comes next is given once more (for a FIFO the same port, 14.24 of the model). Amid a packet it
//! waits for the packet's last byte, because the model drops what is left of one when it makes a sample.
//!
//! What the model lacks: an oscillator of its own error (its samples are exactly 125 µs apart), a way to stop it.

use std::sync::Arc;

use rigless::chip::Timeline;
use rigless::chip::icm42688p::Icm42688p;
use rigless::chip::spi::Peer;
use rigless::snapshot::Store;
use rigless::time::{EventId, VirtualNanos};
use slipsense_recording::Episode;

use crate::xl::{self, Readouts};

const DEVICE_CONFIG: u8 = 0x11;
const FIFO_DATA: u8 = 0x30;
const PWR_MGMT0: u8 = 0x4E;
const ACCEL_CONFIG0: u8 = 0x50;
const REG_BANK_SEL: u8 = 0x76;

/// 9.6: the first byte's highest bit says read.
const READ: u8 = 0x80;
const SOFT_RESET: u8 = 1;
/// ACCEL_MODE, low noise; ACCEL_ODR, 8 kHz.
const MODE: u8 = 0b11;
const LOW_NOISE: u8 = 0b11;
const RATE: u8 = 0b1111;
const RATE_8_KHZ: u8 = 0b0011;
/// ACCEL_CONFIG0 after a reset (14.38).
const ACCEL_CONFIG0_RESET: u8 = 0x06;
const PERIOD_NS: u64 = 125_000;
/// At ±4 g, which the firmware sets.
const LSB_PER_G: i64 = 8192;
/// A packet with the accelerometer alone (6.1): header, three axes, high byte first as the firmware sets it,
/// temperature.
const PACKET: usize = 8;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Transaction {
    /// Selected, and no byte came yet.
    Begun,
    /// Reading; the register whose byte comes next.
    Read(u8),
    /// The register's byte comes next.
    Write(u8),
    /// It came.
    Written,
}

#[derive(Debug, Default)]
pub struct Icm42688 {
    part: Icm42688p,
    readouts: Readouts,
    episode: Option<Arc<Episode>>,
    sensor: usize,
    /// Samples that it has made.
    made: usize,
    /// When the next one is due, if it measures.
    next: Option<u64>,
    event: Option<EventId>,
    transaction: Option<Transaction>,
    /// Bytes of the FIFO that this transaction has read.
    bytes: Vec<u8>,
    /// A sample was due amid a packet.
    late: bool,
    /// What was written to these.
    bank: u8,
    power: u8,
    accel_config: u8,
}

impl Icm42688 {
    /// Behind the array of index `sensor`.
    pub fn new(episode: Option<Arc<Episode>>, sensor: usize, readouts: Readouts) -> Self {
        Self { readouts, episode, sensor, accel_config: ACCEL_CONFIG0_RESET, ..Self::default() }
    }

    /// Gives the model the acceleration in the sample that is due by now.
    fn feel(&mut self, now: u64) {
        while let Some(at) = self.next.filter(|at| *at <= now) {
            // Millionths of g; the model's rounding gives the very count back.
            let true_sample = xl::true_sample(self.episode.as_deref(), self.sensor, self.made);
            let [x, y, z] = true_sample.map(|count| {
                let scaled = i64::from(count) * 1_000_000;
                ((scaled + scaled.signum() * (LSB_PER_G / 2)) / LSB_PER_G) as i32
            });
            self.part.set_acceleration(x, y, z);
            self.made += 1;
            self.next = Some(at + PERIOD_NS);
        }
    }

    /// Lets it make a sample, and go on with the byte of this register.
    fn make_while_read(&mut self, register: u8, context: &mut Timeline<'_, '_>) {
        self.part.select(context);
        self.part.transfer(u32::from(READ | register), 8, context);
    }

    fn schedule(&mut self, context: &mut Timeline<'_, '_>) {
        self.event = self.next.map(|at| context.schedule(VirtualNanos(at)));
    }

    /// 14.1, 14.36, 14.38: what starts the samples, one period later, and what ends them.
    fn written(&mut self, register: u8, value: u8, context: &mut Timeline<'_, '_>) {
        match (self.bank, register) {
            (_, REG_BANK_SEL) => self.bank = value,
            (0, DEVICE_CONFIG) if value & SOFT_RESET != 0 => {
                (self.bank, self.power, self.accel_config) = (0, 0, ACCEL_CONFIG0_RESET);
            }
            (0, PWR_MGMT0) => self.power = value,
            (0, ACCEL_CONFIG0) => self.accel_config = value,
            _ => {}
        }
        let measures = self.power & MODE == LOW_NOISE && self.accel_config & RATE == RATE_8_KHZ;
        if measures != self.next.is_some() {
            self.next = measures.then(|| context.now().0 + PERIOD_NS);
            self.schedule(context);
        }
    }
}

impl Store for Icm42688 {}

impl Peer for Icm42688 {
    fn transfer(&mut self, mosi: u32, bits: u8, context: &mut Timeline<'_, '_>) -> u32 {
        let byte = mosi as u8;
        let answer = self.part.transfer(mosi, bits, context);
        self.transaction = self.transaction.map(|transaction| match transaction {
            Transaction::Begun if byte & READ != 0 => Transaction::Read(byte & !READ),
            Transaction::Begun => Transaction::Write(byte),
            Transaction::Read(FIFO_DATA) if self.bank == 0 => {
                self.bytes.push(answer as u8);
                Transaction::Read(FIFO_DATA)
            }
            Transaction::Read(register) => Transaction::Read(register.wrapping_add(1) & !READ),
            Transaction::Write(register) => {
                self.written(register, byte, context);
                Transaction::Written
            }
            Transaction::Written => Transaction::Written,
        });
        if self.late && self.bytes.len().is_multiple_of(PACKET) {
            self.late = false;
            self.make_while_read(FIFO_DATA, context);
        }
        answer
    }

    fn select(&mut self, context: &mut Timeline<'_, '_>) {
        self.transaction = Some(Transaction::Begun);
        // If one was, it is made now.
        self.late = false;
        self.feel(context.now().0);
        self.part.select(context);
    }

    fn deselect(&mut self, context: &mut Timeline<'_, '_>) {
        self.transaction = None;
        self.part.deselect(context);
        let axis = |packet: &[u8], at: usize| i16::from_be_bytes([packet[at], packet[at + 1]]);
        let packets = self.bytes.chunks_exact(PACKET);
        let samples = packets.map(|packet| [1, 3, 5].map(|at| axis(packet, at))).collect();
        xl::note(&self.readouts, context.now().0, samples);
        self.bytes.clear();
    }

    fn on_event(&mut self, event: EventId, context: &mut Timeline<'_, '_>) {
        if self.event != Some(event) {
            return;
        }
        self.feel(context.now().0);
        match self.transaction {
            None => {
                self.part.select(context);
                self.part.deselect(context);
            }
            Some(Transaction::Begun) => self.part.select(context),
            Some(Transaction::Read(FIFO_DATA)) if !self.bytes.len().is_multiple_of(PACKET) => {
                self.late = true
            }
            Some(Transaction::Read(register)) => self.make_while_read(register, context),
            // A write takes 2 µs: the next select comes before the next sample.
            Some(Transaction::Write(_) | Transaction::Written) => {}
        }
        self.schedule(context);
    }

    /// A reset of the microcontroller took the event away; the part runs on.
    fn restarted(&mut self, context: &mut Timeline<'_, '_>) {
        self.schedule(context);
    }
}
