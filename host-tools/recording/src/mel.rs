//! The mel scale (HTK's formula) between the limits of the firmware's log-mel.

use slipsense::params::{MEL_HIGH_HZ, MEL_LOW_HZ};

/// Point `index` of the grid of `bins` triangles, Hz: 0 is the lower limit, `bins + 1` the upper, the peak of bin b is b + 1.
pub fn mel_point_hz(index: usize, bins: usize) -> f64 {
    let mel = |hz: f64| 2595.0 * (1.0 + hz / 700.0).log10();
    let (low, high) = (mel(MEL_LOW_HZ.into()), mel(MEL_HIGH_HZ.into()));
    let mel = low + (high - low) * index as f64 / (bins + 1) as f64;
    700.0 * (10f64.powf(mel / 2595.0) - 1.0)
}
