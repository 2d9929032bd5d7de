//! Parts made of registers: they sample in virtual time into a FIFO and answer on a bus that can fail. Written from
//! the registers' descriptions, not from the drivers; addresses and codes are written out here again.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;

use embedded_hal_async::spi::{ErrorKind, ErrorType, Operation, SpiDevice};
use slipsense::calibration::{Calibration, Measurement, Refusal};
use slipsense::drivers::array::{Array, Mounting};
use slipsense::drivers::{Adxl380, SPI_BUFFER_BYTES, Sensor, SpiBuffer, XlMonitor};
use slipsense::sensor::XlSample;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Adxl380,
    Adxl382,
    Icm42688,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wires {
    Fine,
    Error,
    /// MISO reads this byte, and nothing reaches the part.
    Stuck(u8),
}

pub struct Part {
    pub kind: Kind,
    /// Samples per second of its own oscillator.
    pub rate_hz: f64,
    pub wires: Wires,
    /// Both banks of the ICM-42688-P that are used, the second at 128.
    pub registers: [u8; 256],
    bank: usize,
    pub fifo: VecDeque<u8>,
    /// Samples made since it was switched on first, whether anyone saw them or not.
    pub made: u64,
    phase: f64,
    /// What a sample is, by its number.
    pub signal: fn(u64) -> XlSample,
    pub transfers: u32,
}

pub fn buffer() -> &'static mut SpiBuffer {
    Box::leak(Box::new([0; SPI_BUFFER_BYTES]))
}

pub fn adxl380(part: &Rc<RefCell<Part>>) -> Adxl380<'static, Wire> {
    Adxl380::new(Wire(part.clone()), buffer())
}

/// A fingertip that is not calibrated, with this accelerometer.
pub fn sensor(part: &Rc<RefCell<Part>>) -> Sensor<'static, Adxl380<'static, Wire>> {
    let (array, xl) = (Array::new(Box::leak(nominal())), XlMonitor::new(adxl380(part)));
    Sensor { array, xl, batch: Box::leak(Box::default()) }
}

pub fn nominal() -> Box<Calibration> {
    let mut calibration = Box::new(Calibration::zeroed());
    calibration.set_nominal();
    calibration
}

/// What these frames of one array, given their numbers, make of a nominal calibration.
pub fn measured(
    frames: u32,
    mut scan: impl FnMut(u32) -> Vec<u16>,
) -> (Box<Calibration>, Result<(), Refusal>) {
    let (mut measurement, mut calibration) = (Box::new(Measurement::new()), nominal());
    (0..frames).for_each(|frame| measurement.add(&scan(frame), 0, 1));
    let result = measurement.evaluate(&Mounting::default().pad(), &mut calibration);
    (calibration, result)
}

/// A sample that says its number: no two within 2^15 are alike.
pub fn numbered(n: u64) -> XlSample {
    [n as i16, (n >> 3) as i16 ^ 0x55, !(n as i16)]
}

impl Part {
    pub fn new(kind: Kind) -> Rc<RefCell<Self>> {
        let rate_hz = if kind == Kind::Adxl382 { 16_000.0 } else { 8_000.0 };
        let mut part = Self {
            kind,
            rate_hz,
            wires: Wires::Fine,
            registers: [0; 256],
            bank: 0,
            fifo: VecDeque::new(),
            made: 0,
            phase: 0.0,
            signal: numbered,
            transfers: 0,
        };
        part.power_on();
        Rc::new(RefCell::new(part))
    }

    pub fn power_on(&mut self) {
        self.registers = [0; 256];
        self.fifo.clear();
        self.bank = 0;
        if self.kind == Kind::Icm42688 {
            self.registers[0x75] = 0x47;
        } else {
            self.registers[0x00] = 0xad;
            self.registers[0x02] = 0x17;
            self.registers[0x03] = 0xc2;
            self.registers[0x20] = if self.kind == Kind::Adxl382 { 0x80 } else { 0 };
        }
    }

    fn runs(&self) -> bool {
        let r = &self.registers;
        match self.kind {
            Kind::Icm42688 => r[0x4e] & 3 == 3 && r[0x50] == 0x43 && r[0x5f] & 1 != 0 && r[0x16] >> 6 == 1,
            _ => r[0x26] == 12 && r[0x27] == 0x78 && r[0x30] == 0x60,
        }
    }

    /// Let time pass; the oscillator goes on also where nothing is sampled.
    pub fn advance(&mut self, us: u64) {
        self.phase += us as f64 * 1e-6 * self.rate_hz;
        while self.phase >= 1.0 {
            self.phase -= 1.0;
            let sample = (self.signal)(self.made);
            self.made += 1;
            if self.runs() {
                self.put(sample);
            }
        }
    }

    fn put(&mut self, sample: XlSample) {
        let values = sample.map(i16::to_be_bytes);
        if self.kind == Kind::Icm42688 {
            while self.fifo.len() + 8 > 2040 {
                self.fifo.drain(..8);
            }
            self.fifo.push_back(0x40);
            self.fifo.extend(values.as_flattened());
            self.fifo.push_back(21);
        } else {
            for (axis, [high, low]) in values.into_iter().enumerate() {
                // Entry by entry, so that an overflow cuts a sample.
                while self.fifo.len() >= 3 * 315 {
                    self.fifo.drain(..3);
                }
                self.fifo.extend([axis as u8, high, low]);
            }
        }
    }

    fn exchange(&mut self, bytes: &mut [u8]) {
        let (&mut command, data) = bytes.split_first_mut().expect("an address byte");
        let icm = self.kind == Kind::Icm42688;
        let (read, register) =
            if icm { (command >> 7 != 0, command & 0x7f) } else { (command & 1 != 0, command >> 1) };
        if !read {
            self.write(register, data[0]);
            return;
        }
        let level = if icm { self.fifo.len() } else { self.fifo.len() / 3 } as u16;
        for (offset, byte) in data.iter_mut().enumerate() {
            let at = register.wrapping_add(offset as u8);
            *byte = match (icm, register) {
                (true, 0x30) => self.fifo.pop_front().unwrap_or(0xff),
                (false, 0x1d) => self.fifo.pop_front().unwrap_or(0),
                _ => match (icm, at) {
                    (true, 0x2e) => level.to_be_bytes()[0],
                    (true, 0x2f) => level.to_be_bytes()[1],
                    (false, 0x1e) => level.to_le_bytes()[0],
                    (false, 0x1f) => level.to_le_bytes()[1],
                    _ => self.registers[self.bank * 128 % 256 + usize::from(at)],
                },
            };
        }
    }

    fn write(&mut self, register: u8, value: u8) {
        match (self.kind == Kind::Icm42688, register) {
            (true, 0x76) => {
                self.bank = if value == 0 { 0 } else { 1 };
                self.registers[0x76] = value;
                self.registers[128 + 0x76] = value;
            }
            (true, 0x11) if value & 1 != 0 => self.power_on(),
            (true, 0x4b) if value & 2 != 0 => self.fifo.clear(),
            (false, 0x2a) if value == 0x52 => self.power_on(),
            _ => self.registers[self.bank * 128 + usize::from(register)] = value,
        }
    }
}

/// The bus end of a part.
#[derive(Clone)]
pub struct Wire(pub Rc<RefCell<Part>>);

impl ErrorType for Wire {
    type Error = ErrorKind;
}

impl SpiDevice for Wire {
    async fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), ErrorKind> {
        let mut part = self.0.borrow_mut();
        part.transfers += 1;
        // The drivers make one transfer in place: that is what keeps all bytes in memory that DMA reaches.
        let [Operation::TransferInPlace(bytes)] = operations else {
            panic!("not one transfer in place");
        };
        match part.wires {
            Wires::Fine => part.exchange(bytes),
            Wires::Error => return Err(ErrorKind::Overrun),
            Wires::Stuck(byte) => bytes.fill(byte),
        }
        Ok(())
    }
}
