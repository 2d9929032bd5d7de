//! Front ends, integers only: accelerometer samples to log-mel, taxel counts to count and delta ([`piezo`]).
//!
//! Log-mel has one file per step, in the order of the signal: high-pass, ring, window and FFT, power over the
//! axes, mel triangles, logarithm, noise floor; beside the last [`crate::fixed::standardise`].

#![deny(clippy::float_arithmetic)]

pub mod highpass;
pub mod ring;
pub mod fft;
#[cfg(feature = "cmsis-dsp")]
pub mod cmsis;
pub mod power;
pub mod mel;
pub mod log;
pub mod floor;
pub mod tables;
pub mod piezo;

pub use floor::OVER_FLOOR_FRAC_BITS;
pub use log::LN_FRAC_BITS;
pub use power::transform;

use core::hint::black_box;

use crate::fixed::standardise;
use crate::params::{FFT_BINS, MEL_BINS, XL_AXES, XL_FEATURES};
use crate::sensor::XlSample;
use floor::NoiseFloor;
use highpass::HighPassState;
use ring::Ring;

/// Fraction bits of [`LogMel::standardised`]: Q2.13, ±4; 16 standardised values never exceed √15.
pub const STANDARDISED_FRAC_BITS: u32 = 13;
/// Added to the variance over the bins: 1e-4 nat², in the Q32 of a squared Q16. A spread of 0.01 nat is far below the
/// 0.3 nat that noise alone makes between bins; the flat frame of a dead sensor becomes zeros.
pub const STANDARDISE_EPSILON_Q32: u64 = 429_497;

/// The features of one sensor at one frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LogMel {
    /// Natural log of the axis-summed mel power in LSB², Q16; at least 0, see [`log::LOG_FLOOR_LSB2`].
    pub ln_power: [i32; MEL_BINS],
    /// The same, standardised over the 16 bins, Q2.13.
    pub standardised: [i16; MEL_BINS],
    /// How far each bin is above its running floor, nat, Q3.12: see [`floor`].
    pub over_floor: [i16; MEL_BINS],
}

/// What the network sees of an accelerometer at one frame: 16 standardised bins, then 16 above the floor. The network
/// takes all of them as Q2.13, so the latter count half.
pub type XlFeatures = [i16; XL_FEATURES];

impl LogMel {
    /// For the network.
    pub fn features(&self) -> XlFeatures {
        let mut all = [0; XL_FEATURES];
        let (standardised, over_floor) = all.split_at_mut(MEL_BINS);
        standardised.copy_from_slice(&self.standardised);
        over_floor.copy_from_slice(&self.over_floor);
        all
    }
}

/// High-pass, window ring and everything after it, for one sensor.
#[derive(Clone, Debug)]
pub struct XlFrontEnd {
    axes: [Axis; XL_AXES],
    floor: NoiseFloor,
}

#[derive(Clone, Debug)]
struct Axis {
    /// `None` before the first sample.
    filter: Option<HighPassState>,
    ring: Ring,
}

impl Axis {
    const NEW: Self = Self { filter: None, ring: Ring::new() };
}

impl XlFrontEnd {
    /// Before the first sample, which will be taken as gravity; the window is zeros.
    pub const fn new() -> Self {
        Self { axes: [Axis::NEW; XL_AXES], floor: NoiseFloor::new() }
    }

    /// Filter any number of samples, oldest first. How a signal is split into calls does not matter.
    pub fn push(&mut self, samples: &[XlSample]) {
        let Some(&first) = samples.first() else { return };
        // With factors known to be constant, LLVM would multiply 64 by 64 bits.
        let high_pass = black_box(tables::HIGHPASS);
        for (index, axis) in self.axes.iter_mut().enumerate() {
            // Copied, so that it stays in registers.
            let mut filter = axis.filter.unwrap_or(HighPassState::at_rest(first[index]));
            for sample in samples {
                axis.ring.push(high_pass.step(&mut filter, sample[index]));
            }
            axis.filter = Some(filter);
        }
    }

    /// Features of the latest 128 samples, once a frame: the floors move on.
    ///
    /// Within 1e-3 nat of float64 arithmetic wherever the power is 20 dB above the floor, 1e-4 nat in the
    /// mean, whatever else is in the signal (`tests/features.rs`).
    pub fn log_mel(&mut self) -> LogMel {
        let (mut power, mut work) = ([0; FFT_BINS], transform::Work::default());
        for axis in &self.axes {
            power::add_power(&mut power, axis.ring.latest(), &mut work);
        }
        let ln_power = mel::mel_power(&power).map(log::ln_q16);
        let (mut deviations, mut standardised) = (ln_power, [0; MEL_BINS]);
        standardise::<STANDARDISED_FRAC_BITS>(&mut deviations, STANDARDISE_EPSILON_Q32, &mut standardised);
        LogMel { ln_power, standardised, over_floor: self.floor.step(&ln_power) }
    }

    /// Samples are missing. All starts again but the noise floors: a jump in the signal would look like a knock.
    pub fn restart(&mut self) {
        self.axes = [Axis::NEW; XL_AXES];
        self.floor.restart();
    }

    /// The floors that the next frame is compared with.
    pub const fn noise_floor(&self) -> &NoiseFloor {
        &self.floor
    }
}
