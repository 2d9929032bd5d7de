//! Step 7: every bin's power over its own running floor.
//!
//! The standardised frame keeps the shape of the spectrum, which is the finger's and the gripper's, and drops the level.
//! The floor of a bin follows its logarithm slowly upwards and fast downwards, as trackers of background noise do for
//! speech; what is above it is new, whatever path it came by. With `x` the logarithm and `f` the floor before this
//! frame: `over = x − f`, then `f ← f + round((x − f) / 2^9)` where `x` is above, `2^5` where below: time constants of
//! 2.1 s and 133 ms.

use super::log::LN_FRAC_BITS;
use crate::fixed::{round_shift, saturate_i16};
use crate::params::{FRAME_RATE_HZ, MEL_BINS, XL_RATE_HZ, XL_WINDOW};

/// Fraction bits of [`LogMel::over_floor`](super::LogMel::over_floor): Q3.12, ±8 nat; what is beyond saturates.
pub const OVER_FLOOR_FRAC_BITS: u32 = 12;
/// The floor rises by `2^-RISE_SHIFT` of the difference each frame.
pub const RISE_SHIFT: u32 = 9;
/// ... and falls by `2^-FALL_SHIFT` of it.
pub const FALL_SHIFT: u32 = 5;
/// Frames from the first sample until the window holds nothing else; what is compared with the floor before that is 0.
pub const FIRST_FRAMES: u32 = (XL_WINDOW as u32 * FRAME_RATE_HZ).div_ceil(XL_RATE_HZ);

/// The floors of one sensor.
#[derive(Clone, Debug)]
pub struct NoiseFloor {
    /// Nat, Q16.
    floor: [i32; MEL_BINS],
    /// Is there a floor?
    known: bool,
    /// Frames since the start or the last gap, up to [`FIRST_FRAMES`].
    frames: u32,
}

impl NoiseFloor {
    /// Before the first frame.
    pub const fn new() -> Self {
        Self { floor: [0; MEL_BINS], known: false, frames: 0 }
    }

    /// Samples are missing: the window fills anew, the floors stay.
    pub fn restart(&mut self) {
        self.frames = 0;
    }

    /// The floors that the next frame is compared with, nat, Q16.
    pub const fn floor(&self) -> &[i32; MEL_BINS] {
        &self.floor
    }

    /// Take the logarithms of the next frame, nat, Q16: how far they are above the floors, Q3.12.
    pub fn step(&mut self, ln_power: &[i32; MEL_BINS]) -> [i16; MEL_BINS] {
        let mut over = [0; MEL_BINS];
        if self.frames < FIRST_FRAMES {
            self.frames += 1;
            if !self.known {
                self.floor = *ln_power;
                self.known = self.frames == FIRST_FRAMES;
            }
            return over;
        }
        for ((over, floor), &ln) in over.iter_mut().zip(&mut self.floor).zip(ln_power) {
            // Logarithms are 0 to 34 nat, so a difference has 23 bits.
            let difference = ln - *floor;
            *over = saturate_i16(round_shift(difference as i64, LN_FRAC_BITS - OVER_FLOOR_FRAC_BITS) as i32);
            let shift = if difference > 0 { RISE_SHIFT } else { FALL_SHIFT };
            *floor += round_shift(difference as i64, shift) as i32;
        }
        over
    }
}
