//! The seam to the sensors: what a board's taxel scan and an accelerometer's driver provide.

use embedded_hal_async::spi::ErrorKind;

use crate::pipeline::FrameStamp;
use crate::sensor::XlSample;

/// The scan of the taxel arrays, which runs by itself and closes a frame when every taxel was converted once.
pub trait TaxelScan {
    /// Wait until the next frame is due in `lead_us`; not at all where it is nearer or late.
    async fn wait_before(&mut self, lead_us: u64);

    /// Wait for the next frame: its number, and the time of the conversion that closed it. Ends whatever happens: a scan
    /// that stopped is started again, and its frame is delivered without counts.
    async fn tick(&mut self) -> FrameStamp;

    /// The ADC codes, 16 bits, of the frame just waited for: slot by slot in the order of [`crate::drivers::scan`], the arrays
    /// of a slot side by side. `None`: the frame is lost (conversions were missed, or the scan stood still).
    fn codes(&self) -> Option<&[u16]>;

    /// Are [`codes`](Self::codes) still those of that frame? To be asked after reading them: a scan does not wait.
    fn is_untouched(&self) -> bool;
}

/// Samples of one FIFO at most: that of the ICM-42688-P, 2048 bytes of 8-byte packets.
pub const FIFO_SAMPLES_MAX: usize = 256;
/// What a FIFO held, oldest first.
pub type FifoSamples = heapless::Vec<XlSample, FIFO_SAMPLES_MAX>;

/// What is particular about a kind of accelerometer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct XlPart {
    /// As printed on it.
    pub name: &'static str,
    /// Its nominal rate, samples per second.
    pub native_rate_hz: u32,
    /// Samples of it per sample that is delivered: 1, or 2 through [`crate::drivers::decimate`].
    pub decimation: u32,
    /// Sensitivity, LSB per g, nominal.
    pub lsb_per_g: u32,
    /// Frame ticks between a reset and the first register access.
    pub reset_ticks: u32,
    /// Frame ticks after power-up whose samples are thrown away.
    pub settling_ticks: u32,
    /// Time that reading the samples of a frame takes at most, microseconds: their bytes at 8 MHz, and what the transfers
    /// cost on the emulated board.
    pub read_us: u64,
}

/// What a FIFO said beside its samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FifoStatus {
    /// The FIFO was full: samples before the first one are lost.
    pub overrun: bool,
    /// Times that the axes were out of step and found again: samples before the first one are lost.
    pub resyncs: u32,
}

impl FifoStatus {
    /// Do the samples follow those of the read before, without a gap?
    pub const fn is_continuous(&self) -> bool {
        !self.overrun && self.resyncs == 0
    }
}

/// Why an accelerometer does not deliver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the fields are named after what they are, and the text says it")]
pub enum XlFault {
    Bus(ErrorKind),
    /// Another part answers, or none does: identifiers of all zeros or all ones are an open line.
    WrongPart {
        expected: u32,
        found: u32,
    },
    Refused {
        register: u8,
    },
    Level {
        level: u16,
    },
    Unframed,
    Silent,
}

impl XlFault {
    /// In a word, for a log that formats no text.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Bus(_) => "bus",
            Self::WrongPart { .. } => "wrong part",
            Self::Refused { .. } => "refused",
            Self::Level { .. } => "level",
            Self::Unframed => "unframed",
            Self::Silent => "silent",
        }
    }

    /// What was found: an identifier, a register, a level; 0 where there is nothing to tell.
    pub const fn detail(self) -> u32 {
        match self {
            Self::WrongPart { found, .. } => found,
            Self::Refused { register } => register as u32,
            Self::Level { level } => level as u32,
            Self::Bus(_) | Self::Unframed | Self::Silent => 0,
        }
    }
}

impl core::fmt::Display for XlFault {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Bus(kind) => write!(f, "SPI: {kind}"),
            Self::WrongPart { expected, found } => {
                write!(f, "identifier {found:#x}, expected {expected:#x}")
            }
            Self::Refused { register } => write!(f, "register {register:#x} does not keep what is written"),
            Self::Level { level } => write!(f, "FIFO level {level}: more than it holds"),
            Self::Unframed => f.write_str("FIFO: the axes are out of step"),
            Self::Silent => f.write_str("no samples"),
        }
    }
}

impl core::error::Error for XlFault {}

/// One accelerometer behind its bus. Each call is a few transfers, none waits: what needs time between two steps is
/// spread over frame ticks by [`crate::drivers::XlMonitor`].
pub trait Accelerometer {
    /// Which part this is.
    const PART: XlPart;

    /// Check the identifier, then reset the part.
    async fn reset(&mut self) -> Result<(), XlFault>;

    /// [`XlPart::reset_ticks`] later: set rate, range and FIFO, check that the registers hold it, start sampling.
    async fn configure(&mut self) -> Result<(), XlFault>;

    /// Put what the FIFO holds into `samples`, which is emptied first: of samples with a gap between them those after
    /// the last gap. After an error it may hold less.
    async fn drain(&mut self, samples: &mut FifoSamples) -> Result<FifoStatus, XlFault>;
}
