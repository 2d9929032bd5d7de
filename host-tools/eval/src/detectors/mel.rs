//! Mel-frequency cepstral coefficients: 13 of 26 filters, as Yoo et al. (2021) and the paper's
//! accelerometer baseline have them.
//!
//! Triangles of height 1 on the HTK mel scale, 20 to 4000 Hz (librosa's `htk=True, norm=None`), natural
//! log, orthonormal DCT-II. Checked against librosa by `tests/python/check_baselines.py`.

use std::f64::consts::PI;
use std::sync::LazyLock;

use slipsense::params::{FFT_BINS, MEL_HIGH_HZ, MEL_LOW_HZ, XL_RATE_HZ, XL_WINDOW};

/// Mel filters.
pub const FILTERS: usize = 26;
/// Cepstral coefficients kept, the 0th (level) included.
pub const COEFFICIENTS: usize = 13;
/// Added under the logarithm, g²: 0.4 LSB² of the coarser part (0.488 mg), and 30 dB below the 9e-5 that
/// 22 µg/√Hz of sensor noise make in one bin of one axis.
pub const FLOOR_G2: f64 = 1e-7;

/// Weights of one triangle.
struct Filter {
    first_bin: usize,
    weights: Vec<f64>,
}

static BANK: LazyLock<Vec<Filter>> = LazyLock::new(|| {
    let mel = |hz: f64| 2595.0 * (1.0 + hz / 700.0).log10();
    let (low, high) = (mel(MEL_LOW_HZ.into()), mel(MEL_HIGH_HZ.into()));
    let edge = |i: usize| {
        let mel = low + (high - low) * i as f64 / (FILTERS + 1) as f64;
        700.0 * (10f64.powf(mel / 2595.0) - 1.0)
    };
    let bin_hz = f64::from(XL_RATE_HZ) / XL_WINDOW as f64;
    (0..FILTERS)
        .map(|i| {
            let [left, peak, right] = [edge(i), edge(i + 1), edge(i + 2)];
            let weight = |bin: usize| {
                let hz = bin as f64 * bin_hz;
                ((hz - left) / (peak - left)).min((right - hz) / (right - peak)).max(0.0)
            };
            let inside: Vec<usize> = (0..FFT_BINS).filter(|&bin| weight(bin) > 0.0).collect();
            let weights = inside.iter().map(|&bin| weight(bin)).collect();
            Filter { first_bin: inside.first().copied().unwrap_or(0), weights }
        })
        .collect()
});

static DCT: LazyLock<[[f64; FILTERS]; COEFFICIENTS]> = LazyLock::new(|| {
    std::array::from_fn(|k| {
        let scale = (if k == 0 { 1.0 } else { 2.0 } / FILTERS as f64).sqrt();
        std::array::from_fn(|n| scale * (PI * k as f64 * (2 * n + 1) as f64 / (2 * FILTERS) as f64).cos())
    })
});

/// Natural log of the power under each triangle, ln g², from the power of each FFT bin, g².
pub fn log_mel(power_g2: &[f64; FFT_BINS]) -> [f64; FILTERS] {
    let bank = &*BANK;
    std::array::from_fn(|i| {
        let Filter { first_bin, weights } = &bank[i];
        let power: f64 = weights.iter().zip(&power_g2[*first_bin..]).map(|(w, p)| w * p).sum();
        (power + FLOOR_G2).ln()
    })
}

/// The first 13 coefficients of the orthonormal DCT-II of the log-mel powers.
pub fn mfcc(log_mel: &[f64; FILTERS]) -> [f64; COEFFICIENTS] {
    let dct = &*DCT;
    std::array::from_fn(|k| dct[k].iter().zip(log_mel).map(|(d, l)| d * l).sum())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_triangle_is_empty() {
        let bins: Vec<usize> = BANK.iter().map(|filter| filter.weights.len()).collect();
        println!("bins per triangle: {bins:?}");
        assert_eq!(bins.len(), FILTERS);
        assert!(bins.iter().all(|&n| n >= 1));
    }

    #[test]
    fn the_dct_is_orthonormal() {
        for (i, a) in DCT.iter().enumerate() {
            for (j, b) in DCT.iter().enumerate() {
                let dot: f64 = a.iter().zip(b).map(|(a, b)| a * b).sum();
                assert!((dot - f64::from(u8::from(i == j))).abs() < 1e-12, "{i} {j} {dot}");
            }
        }
    }
}
