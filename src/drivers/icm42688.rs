//! ICM-42688-P: 8 kHz, ±4 g, 8192 LSB/g, over SPI, read from its FIFO. Sections are those of its data sheet,
//! DS-000347 rev 1.6. Nothing here has met hardware.
//!
//! The gyroscope stays off, so a packet is 8 bytes: a header, three axes, a temperature (6.1). The header frames the
//! stream; after one that is none the FIFO is emptied. An overrun is seen by the level: a stream that has dropped a
//! packet is full until it is read.

use embedded_hal_async::spi::SpiDevice;

use super::registers::{Registers, SpiBuffer};
use crate::board::{Accelerometer, FifoSamples, FifoStatus, XlFault, XlPart};
use crate::params::XL_AXES;
use crate::sensor::XlSample;

/// Register addresses (13). On the wire, bit 7 says read (9.6).
pub mod register {
    /// Soft reset in bit 0.
    pub const DEVICE_CONFIG: u8 = 0x11;
    /// FIFO mode in bits 7:6.
    pub const FIFO_CONFIG: u8 = 0x16;
    /// Level, two bytes, high byte first; reading this one latches both.
    pub const FIFO_COUNTH: u8 = 0x2e;
    /// Oldest byte; a burst stays here.
    pub const FIFO_DATA: u8 = 0x30;
    /// Flush in bit 1.
    pub const SIGNAL_PATH_RESET: u8 = 0x4b;
    /// Byte orders, level in bytes or records, I2C off.
    pub const INTF_CONFIG0: u8 = 0x4c;
    /// Modes of the sensors.
    pub const PWR_MGMT0: u8 = 0x4e;
    /// Range in bits 7:5, rate in bits 3:0.
    pub const ACCEL_CONFIG0: u8 = 0x50;
    /// Bandwidths of the filters before the FIFO.
    pub const GYRO_ACCEL_CONFIG0: u8 = 0x52;
    /// What goes to the FIFO.
    pub const FIFO_CONFIG1: u8 = 0x5f;
    /// The part's identifier.
    pub const WHO_AM_I: u8 = 0x75;
    /// Bank of all registers but this.
    pub const REG_BANK_SEL: u8 = 0x76;
    /// Anti-alias filter, ACCEL_CONFIG_STATIC2 to 4, in bank 2.
    pub const ACCEL_CONFIG_STATIC: [u8; 3] = [3, 4, 5];
}

/// What [`register::WHO_AM_I`] reads.
pub const WHO_AM_I: u8 = 0x47;
/// Bytes of a packet with the accelerometer alone.
pub const PACKET_BYTES: usize = 8;
/// Room for packets, bytes: 2048 less one packet (6.3).
pub const FIFO_BYTES: u16 = 2048 - PACKET_BYTES as u16;
/// Of the header: no packet; accelerometer; gyroscope; 20-bit data.
const HEADER_MASK: u8 = 0xf0;
/// Accelerometer alone.
const HEADER_XL: u8 = 0x40;
/// What an axis reads before its first sample (12.8).
const INVALID: XlSample = [i16::MIN; XL_AXES];

const SOFT_RESET: u8 = 1;
const FLUSH: u8 = 1 << 1;
const BANK_0: u8 = 0;
const BANK_2: u8 = 2;
/// Order in which they are written; the sensor is switched on last, outside this list.
const SETTINGS: [(u8, u8); 9] = [
    // High byte first, level in bytes, I2C off (14.34).
    (register::INTF_CONFIG0, 0x33),
    // ±4 g, 8 kHz (14.38).
    (register::ACCEL_CONFIG0, 2 << 5 | 3),
    // Bandwidth of the accelerometer's filter: half the rate (14.40).
    (register::GYRO_ACCEL_CONFIG0, 0x01),
    // Accelerometer packets (14.45), stream mode (14.4).
    (register::FIFO_CONFIG1, 1),
    (register::FIFO_CONFIG, 1 << 6),
    // Anti-alias filter at its widest, 3979 Hz: DELT 63, DELTSQR 3968, BITSHIFT 3 (5.3); it is 258 Hz otherwise.
    (register::REG_BANK_SEL, BANK_2),
    (register::ACCEL_CONFIG_STATIC[0], 63 << 1),
    (register::ACCEL_CONFIG_STATIC[1], (3968 & 0xff) as u8),
    (register::ACCEL_CONFIG_STATIC[2], 3 << 4 | (3968 >> 8) as u8),
];
/// Accelerometer in low-noise mode, gyroscope off (14.36).
const XL_LOW_NOISE: u8 = 3;

const fn read(register: u8) -> u8 {
    register | 0x80
}

/// An ICM-42688-P, accelerometer only.
#[derive(Debug)]
pub struct Icm42688<'b, SPI> {
    registers: Registers<'b, SPI>,
}

impl<'b, SPI: SpiDevice> Icm42688<'b, SPI> {
    /// SPI mode 0 or 3, at most 24 MHz.
    pub const fn new(spi: SPI, buffer: &'b mut SpiBuffer) -> Self {
        Self { registers: Registers::new(spi, buffer) }
    }

    async fn set(&mut self, register: u8, value: u8) -> Result<(), XlFault> {
        self.registers.set(register, [register, read(register)], value).await
    }
}

impl<SPI: SpiDevice> Accelerometer for Icm42688<'_, SPI> {
    const PART: XlPart = XlPart {
        name: "ICM-42688-P",
        native_rate_hz: 8_000,
        decimation: 1,
        lsb_per_g: 8_192,
        // 1 ms (14.1).
        reset_ticks: 1,
        // The accelerometer takes 10 ms to start (table 2).
        settling_ticks: 3,
        read_us: 310,
    };

    async fn reset(&mut self) -> Result<(), XlFault> {
        self.registers.write(register::REG_BANK_SEL, BANK_0).await?;
        let found = self.registers.read(read(register::WHO_AM_I), 1).await?[0];
        if found != WHO_AM_I {
            return Err(XlFault::WrongPart { expected: WHO_AM_I.into(), found: found.into() });
        }
        self.registers.write(register::DEVICE_CONFIG, SOFT_RESET).await
    }

    async fn configure(&mut self) -> Result<(), XlFault> {
        for (register, value) in SETTINGS {
            self.set(register, value).await?;
        }
        self.set(register::REG_BANK_SEL, BANK_0).await?;
        // Nothing may be written for 200 µs after this: reading it back is allowed, the next write is frames away.
        self.set(register::PWR_MGMT0, XL_LOW_NOISE).await
    }

    async fn drain(&mut self, samples: &mut FifoSamples) -> Result<FifoStatus, XlFault> {
        samples.clear();
        let level = match *self.registers.read(read(register::FIFO_COUNTH), 2).await? {
            [high, low] => u16::from_be_bytes([high, low]),
            _ => 0,
        };
        if level > FIFO_BYTES + PACKET_BYTES as u16 {
            return Err(XlFault::Level { level });
        }
        let mut fifo = FifoStatus { overrun: level >= FIFO_BYTES, resyncs: 0 };
        let whole = level as usize / PACKET_BYTES * PACKET_BYTES;
        if whole > 0 {
            let bytes = self.registers.read(read(register::FIFO_DATA), whole).await?;
            fifo.resyncs = parse(bytes, samples);
        }
        if fifo.resyncs > 0 {
            samples.clear();
            self.registers.write(register::SIGNAL_PATH_RESET, FLUSH).await?;
        }
        Ok(fifo)
    }
}

/// Samples of the packets in `bytes`, up to the first that is none or that holds no sample yet. Returns how often the
/// stream broke: 0 or 1.
pub fn parse(bytes: &[u8], samples: &mut FifoSamples) -> u32 {
    for &[header, xh, xl, yh, yl, zh, zl, _temperature] in bytes.as_chunks::<PACKET_BYTES>().0 {
        let sample = [[xh, xl], [yh, yl], [zh, zl]].map(i16::from_be_bytes);
        // There is room for all that a FIFO holds.
        if header & HEADER_MASK != HEADER_XL || sample == INVALID || samples.push(sample).is_err() {
            return 1;
        }
    }
    0
}
