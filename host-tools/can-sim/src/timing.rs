//! Bit timings, and how long frames take with them.

use crate::frame::Frame;
use crate::wire_bits::{FrameBits, Rate};

/// Bits of the pause after a frame before the next may start.
pub const INTERMISSION: u32 = 3;

/// One bit: the synchronisation quantum, then two segments around the sample point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BitTiming {
    /// Kernel clock cycles per time quantum.
    pub prescaler: u32,
    /// Quanta between the synchronisation quantum and the sample point: propagation and phase segment 1.
    pub seg1: u32,
    /// Quanta after the sample point.
    pub seg2: u32,
}

impl BitTiming {
    /// Kernel clock cycles of a bit.
    pub const fn cycles(&self) -> u32 {
        self.before_sample() + self.after_sample()
    }

    /// Cycles up to the sample point.
    pub const fn before_sample(&self) -> u32 {
        self.prescaler * (1 + self.seg1)
    }

    /// Cycles from the sample point on.
    pub const fn after_sample(&self) -> u32 {
        self.prescaler * self.seg2
    }
}

/// Both bit timings of a bus and the clock they count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timing {
    pub clock_hz: u32,
    pub nominal: BitTiming,
    pub data: BitTiming,
}

/// Why bit rates cannot be had.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimingError {
    /// The clock is no multiple of this bit rate, in bit/s, or has fewer than 4 cycles of it.
    BitRate(u32),
}

impl Timing {
    /// Bit rates in bit/s sampled at about 80 %, one cycle per quantum. The clock must be a multiple of both.
    pub const fn new(clock_hz: u32, nominal_bps: u32, data_bps: u32) -> Result<Self, TimingError> {
        let (nominal, data) = (bit(clock_hz, nominal_bps), bit(clock_hz, data_bps));
        match (nominal, data) {
            (Some(nominal), Some(data)) => Ok(Self { clock_hz, nominal, data }),
            (None, _) => Err(TimingError::BitRate(nominal_bps)),
            (_, None) => Err(TimingError::BitRate(data_bps)),
        }
    }

    /// Cycles of bits from start to end of frame.
    pub const fn bits(&self, bits: &FrameBits) -> u64 {
        let (nominal, data) = (self.nominal.cycles(), self.data.cycles());
        let even = bits.nominal as u64 * nominal as u64 + bits.data as u64 * data as u64;
        // BRS and CRC delimiter together are a bit of either kind.
        if bits.switched { even + (nominal + data) as u64 } else { even }
    }

    pub const fn bit(&self, rate: Rate) -> u32 {
        match rate {
            Rate::Nominal => self.nominal.cycles(),
            Rate::Data => self.data.cycles(),
            Rate::ToData => self.nominal.before_sample() + self.data.after_sample(),
            Rate::ToNominal => self.data.before_sample() + self.nominal.after_sample(),
        }
    }

    /// Cycles of a frame from start to end of frame, without the intermission.
    pub fn frame(&self, frame: &Frame) -> u64 {
        self.bits(&FrameBits::of(frame))
    }

    /// Cycles of the intermission: until the next frame may start.
    pub const fn intermission(&self) -> u64 {
        INTERMISSION as u64 * self.nominal.cycles() as u64
    }

    /// Cycles in nanoseconds, rounded up: no end is early.
    pub const fn ns(&self, cycles: u64) -> u64 {
        // Whole seconds apart, so that hours of cycles do not overflow.
        let clock = self.clock_hz as u64;
        cycles / clock * 1_000_000_000 + (cycles % clock * 1_000_000_000).div_ceil(clock)
    }
}

const fn bit(clock_hz: u32, bps: u32) -> Option<BitTiming> {
    if bps == 0 || !clock_hz.is_multiple_of(bps) || clock_hz / bps < 4 {
        return None;
    }
    let quanta = clock_hz / bps;
    let seg2 = quanta / 5 + (quanta < 5) as u32;
    Some(BitTiming { prescaler: 1, seg1: quanta - 1 - seg2, seg2 })
}
