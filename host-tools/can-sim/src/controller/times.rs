//! How long things keep the bus, nanoseconds: [`crate`]'s bits, of the longest frame of each length.

use crate::{Format, INTERMISSION, RECOVERY_BITS, Timing, dlc_of, worst_case};
use slipsense::wire::FD_LENGTHS;

/// What an error adds to a frame, at most: flags of both sides and the delimiter, bits.
const ERROR_BITS: u64 = 6 + 6 + 8;

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Times {
    /// By data length code.
    frames: [u64; FD_LENGTHS.len()],
    bit: u64,
}

impl Times {
    /// Of frames with 29-bit identifiers and bit rate switching.
    pub fn new(timing: &Timing) -> Self {
        let frame =
            |dlc: u8| timing.ns(worst_case(None, true, Format::FD, dlc, timing) + timing.intermission());
        Self {
            frames: core::array::from_fn(|dlc| frame(dlc as u8)),
            bit: timing.ns(timing.nominal.cycles().into()),
        }
    }

    /// A frame of `bytes` of data with the most stuff bits that its length can have, and the intermission behind it.
    /// A length that CAN FD does not have takes the time of the longest.
    pub fn frame(&self, bytes: usize) -> u64 {
        self.frames[dlc_of(bytes, true).map_or(self.frames.len() - 1, usize::from)]
    }

    /// What an error adds to the frame that it destroys.
    pub fn error(&self) -> u64 {
        ERROR_BITS * self.bit
    }

    /// From the end of what drove the node off the bus until it is back, where other nodes' frames of `bytes` fill
    /// `load_percent` of the time. An idle bus shows 11 recessive bits every 11 bits; a frame shows them once, at its
    /// end.
    pub fn recovery(&self, load_percent: u64, bytes: usize) -> u64 {
        let load = load_percent.min(100);
        let (idle, frame) = (11 * self.bit, self.frame(bytes));
        // Sequences in 100 · idle · frame nanoseconds.
        let sequences = (100 - load) * frame + load * idle;
        RECOVERY_BITS / 11 * 100 * idle * frame / sequences
    }
}

const _: () = assert!(INTERMISSION == 3, "the end of a frame shows 11 recessive bits with its intermission");

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_frame_takes_the_design_time() {
        // Measured elsewhere: 118 and 169 µs at worst with 11-bit identifiers, which have 18 bits and up to 5 stuff
        // bits less.
        for (data_bps, us) in [(8_000_000, 118), (5_000_000, 169)] {
            let timing = Timing::new(80_000_000, 1_000_000, data_bps).unwrap();
            let found = Times::new(&timing).frame(64) / 1000;
            assert!((us + 15..=us + 26).contains(&found), "{found} µs at {data_bps} bit/s");
        }
    }

    #[test]
    fn the_way_back_is_longer_on_a_busy_bus() {
        let times = Times::new(&Timing::new(80_000_000, 1_000_000, 8_000_000).unwrap());
        assert_eq!(times.recovery(0, 64), 128 * 11_000);
        assert_eq!(times.recovery(100, 64), 128 * times.frame(64));
        assert!((times.recovery(0, 64)..times.recovery(100, 64)).contains(&times.recovery(50, 64)));
    }
}
