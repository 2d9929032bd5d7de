//! The library's own `arm_rfft_q31`, through the crate `cmsis_dsp`.

use cmsis_dsp::transform::{Direction, OutputOrder, Q31RealFft};
use fixed::types::I1F31;

use crate::params::XL_WINDOW;

/// The spectrum of Q31 samples, over 128: 128 bins, real and imaginary part alternating. Overwrites the samples.
pub fn rfft(samples: &mut [i32; XL_WINDOW], spectrum: &mut [i32; 2 * XL_WINDOW]) {
    let samples: &mut [I1F31; XL_WINDOW] = bytemuck::must_cast_mut(samples);
    // Only a length that the library lacks is refused.
    if let Ok(fft) = Q31RealFft::new(XL_WINDOW as u32, Direction::Forward, OutputOrder::Standard) {
        fft.run(samples, spectrum);
    }
}
