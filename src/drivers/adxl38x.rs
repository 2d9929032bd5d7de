//! ADXL380 (8 kHz, ±4 g) and ADXL382 (16 kHz, ±15 g) over SPI, read from their FIFO.
//!
//! Registers, identifiers and sensitivities are those of the Linux driver `adxl380.c`; channel identifiers in the
//! FIFO, its overrun and the order of the level's bytes those of Analog Devices' no-OS driver `adxl38x`. No data sheet
//! was at hand, and no part: nothing here has met hardware.
//!
//! Each FIFO entry is read as three bytes, the axis and the value, so that every sample proves its own alignment.
//! That costs a third of the bus time and saves knowing how the part drops entries when it overflows. The whole FIFO
//! is read in one burst, as Linux does.
//!
//! An overrun is seen by the level alone: a FIFO that keeps the newest entries and has dropped one is full until read.

use embedded_hal_async::spi::SpiDevice;

use super::registers::{Registers, SpiBuffer};
use crate::board::{Accelerometer, FifoSamples, FifoStatus, XlFault, XlPart};
use crate::params::XL_AXES;
use crate::sensor::XlSample;

/// Register addresses. On the wire they are shifted left by one; bit 0 says read.
pub mod register {
    /// Analog Devices' identifier.
    pub const DEVID_AD: u8 = 0x00;
    /// The part's identifier, upper 12 bits of two bytes.
    pub const PART_ID: u8 = 0x02;
    /// Oldest entry of the FIFO; a burst stays here.
    pub const FIFO_DATA: u8 = 0x1d;
    /// Entries in the FIFO, 9 bits, low byte first.
    pub const FIFO_STATUS0: u8 = 0x1e;
    /// Bit 7 tells the two parts apart.
    pub const MISC0: u8 = 0x20;
    /// Range in bits 7:6, mode in bits 3:0.
    pub const OP_MODE: u8 = 0x26;
    /// Enabled channels in bits 7:4, the FIFO in bit 3.
    pub const DIG_EN: u8 = 0x27;
    /// Takes [`RESET_CODE`](super::RESET_CODE).
    pub const RESET: u8 = 0x2a;
    /// Channel identifiers in bit 6, mode in bits 5:4.
    pub const FIFO_CFG0: u8 = 0x30;
}

/// What [`register::DEVID_AD`] reads.
pub const DEVID_AD: u8 = 0xad;
/// What both parts have in the upper 12 bits of [`register::PART_ID`].
pub const PART_ID: u16 = 380;
/// Bit of [`register::MISC0`] that an ADXL382 has set.
pub const MISC0_XL382: u8 = 1 << 7;
/// Resets the part when written to [`register::RESET`]; 0.5 ms until it answers again.
pub const RESET_CODE: u8 = 0x52;
/// Entries from which on the FIFO counts as full: 105 samples.
pub const FIFO_ENTRIES: u16 = 315;
/// More than the FIFO has by any of its descriptions (318 in Analog Devices' example).
const LEVEL_MAX: u16 = 318;
/// Bytes of an entry: the axis in the low two bits of the first, then the value, high byte first.
pub const ENTRY_BYTES: usize = 3;
/// One overrun can cut one sample in two; more in one read is not explained by it.
const RESYNCS_MAX: u32 = 1;

const fn read(register: u8) -> u8 {
    register << 1 | 1
}

const fn write(register: u8) -> u8 {
    register << 1
}

/// An ADXL380: 8 kHz, ±4 g, 7500 LSB/g.
pub type Adxl380<'b, SPI> = Adxl38x<'b, SPI, false>;
/// An ADXL382: 16 kHz, ±15 g, 2000 LSB/g.
pub type Adxl382<'b, SPI> = Adxl38x<'b, SPI, true>;

/// One of the two.
#[derive(Debug)]
pub struct Adxl38x<'b, SPI, const IS_382: bool> {
    registers: Registers<'b, SPI>,
    framer: Framer,
}

impl<'b, SPI: SpiDevice, const IS_382: bool> Adxl38x<'b, SPI, IS_382> {
    /// SPI mode 0, at most 8 MHz.
    pub fn new(spi: SPI, buffer: &'b mut SpiBuffer) -> Self {
        Self { registers: Registers::new(spi, buffer), framer: Framer::default() }
    }
}

impl<SPI: SpiDevice, const IS_382: bool> Accelerometer for Adxl38x<'_, SPI, IS_382> {
    const PART: XlPart = XlPart {
        name: if IS_382 { "ADXL382" } else { "ADXL380" },
        native_rate_hz: if IS_382 { 16_000 } else { 8_000 },
        decimation: if IS_382 { 2 } else { 1 },
        lsb_per_g: if IS_382 { 2_000 } else { 7_500 },
        reset_ticks: 1,
        // 50 ms. Linux waits for nothing, Analog Devices' example for 500 ms without saying why.
        settling_ticks: 12,
        read_us: if IS_382 { 650 } else { 340 },
    };

    async fn reset(&mut self) -> Result<(), XlFault> {
        let mut found = [0; 4];
        for (at, register, length) in
            [(0, register::DEVID_AD, 1), (1, register::PART_ID, 2), (3, register::MISC0, 1)]
        {
            let bytes = self.registers.read(read(register), length).await?;
            found.iter_mut().skip(at).zip(bytes).for_each(|(to, &from)| *to = from);
        }
        // The low four bits of the part's identifier are its revision.
        found[2] &= 0xf0;
        found[3] &= MISC0_XL382;
        let [high, low] = (PART_ID << 4).to_be_bytes();
        let expected = [DEVID_AD, high, low, if IS_382 { MISC0_XL382 } else { 0 }];
        if found != expected {
            let [expected, found] = [expected, found].map(u32::from_be_bytes);
            return Err(XlFault::WrongPart { expected, found });
        }
        self.registers.write(write(register::RESET), RESET_CODE).await
    }

    /// In standby, which the part is in after a reset: other registers may be written in no other mode.
    async fn configure(&mut self) -> Result<(), XlFault> {
        self.framer = Framer::default();
        for (register, value) in [
            // X, Y, Z and the FIFO on, temperature off.
            (register::DIG_EN, 0b0111_1000),
            // Channel identifiers on, stream mode: the newest entries stay.
            (register::FIFO_CFG0, 1 << 6 | 2 << 4),
            // High performance at the smallest range.
            (register::OP_MODE, 12),
        ] {
            self.registers.set(register, [write(register), read(register)], value).await?;
        }
        Ok(())
    }

    async fn drain(&mut self, samples: &mut FifoSamples) -> Result<FifoStatus, XlFault> {
        samples.clear();
        let level = match *self.registers.read(read(register::FIFO_STATUS0), 2).await? {
            [low, high] => u16::from_le_bytes([low, high & 1]),
            _ => 0,
        };
        if level > LEVEL_MAX {
            return Err(XlFault::Level { level });
        }
        let mut fifo = FifoStatus { overrun: level >= FIFO_ENTRIES, resyncs: 0 };
        if fifo.overrun {
            // What there was of a sample has lost its other half.
            self.framer = Framer::default();
        }
        if level == 0 {
            return Ok(fifo);
        }
        let bytes = self.registers.read(read(register::FIFO_DATA), level as usize * ENTRY_BYTES).await;
        // Entries of a read that failed may be gone.
        let bytes = bytes.inspect_err(|_| self.framer = Framer::default())?;
        for &entry in bytes.as_chunks::<ENTRY_BYTES>().0 {
            match self.framer.push(entry) {
                // 106 samples at most: there is room.
                Ok(Some(sample)) => _ = samples.push(sample),
                Ok(None) => {}
                Err(OutOfStep) => {
                    fifo.resyncs += 1;
                    // What came before does not join what follows.
                    samples.clear();
                }
            }
        }
        if fifo.resyncs > RESYNCS_MAX {
            return Err(XlFault::Unframed);
        }
        Ok(fifo)
    }
}

/// An axis came that was not the next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutOfStep;

/// Makes samples of FIFO entries, across reads: a read may end amid a sample.
#[derive(Clone, Copy, Debug, Default)]
pub struct Framer {
    /// Axes so far, of the sample that is being put together.
    partial: XlSample,
    /// The axis that comes next.
    next: usize,
    /// Is an x awaited after a break?
    broken: bool,
}

impl Framer {
    /// Take one entry; every third ends a sample. After an axis that was not the next, what there was of the sample
    /// is thrown away, and the next x begins another. A break is one error, however many entries it swallows.
    pub fn push(&mut self, [axis, high, low]: [u8; ENTRY_BYTES]) -> Result<Option<XlSample>, OutOfStep> {
        let axis = usize::from(axis & 3);
        let in_step = axis == self.next;
        let is_news = !in_step && !self.broken;
        if !in_step {
            (self.next, self.broken) = (0, true);
        }
        if axis == self.next {
            if let Some(partial) = self.partial.get_mut(axis) {
                *partial = i16::from_be_bytes([high, low]);
            }
            (self.next, self.broken) = ((axis + 1) % XL_AXES, false);
        }
        if is_news {
            return Err(OutOfStep);
        }
        Ok((in_step && self.next == 0).then_some(self.partial))
    }
}
