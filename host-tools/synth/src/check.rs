//! What the tests share: print what was measured beside what is expected, and hold it to that.

use std::fmt::{Debug, Display};
use std::ops::RangeBounds;

use slipsense::params::XL_RATE_HZ;

#[track_caller]
pub(crate) fn near(what: impl Display, measured: f64, expected: f64, share: f64) {
    let off = measured / expected - 1.0;
    println!("{what}: {measured:.4}, expected {expected:.4} ({:+.1} %)", 100.0 * off);
    assert!(off.abs() < share, "{what}: {measured}, expected {expected} within {share}");
}

#[track_caller]
pub(crate) fn within(what: impl Display, measured: f64, expected: impl RangeBounds<f64> + Debug) {
    println!("{what}: {measured:.4}, expected {expected:?}");
    assert!(expected.contains(&measured), "{what}: {measured}, expected {expected:?}");
}

pub(crate) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

pub(crate) fn variance(values: &[f64]) -> f64 {
    let mean = mean(values);
    values.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / values.len() as f64
}

pub(crate) fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((values.len() as f64 * share) as usize).min(values.len() - 1)]
}

pub(crate) fn median(values: Vec<f64>) -> f64 {
    quantile(values, 0.5)
}

/// Samples of an accelerometer above 10 Hz, first-order.
pub(crate) fn above_10_hz(samples: impl Iterator<Item = [f64; 3]>) -> Vec<[f64; 3]> {
    let pole = libm::exp(-std::f64::consts::TAU * 10.0 / XL_RATE_HZ as f64);
    let (mut last, mut y) = (None, [0.0; 3]);
    let filtered = samples.map(|x| {
        let before = last.replace(x).unwrap_or(x);
        y = std::array::from_fn(|axis| pole * (y[axis] + x[axis] - before[axis]));
        y
    });
    filtered.collect()
}

/// Squared size of the Fourier sum of all axes at a frequency, turns per sample.
pub(crate) fn power_at(samples: &[[f64; 3]], turns: f64) -> f64 {
    let (sin_step, cos_step) = libm::sincos(std::f64::consts::TAU * turns);
    let (mut c, mut s) = (1.0, 0.0);
    let mut sums = [[0.0; 2]; 3];
    for x in samples {
        for (sum, x) in sums.iter_mut().zip(x) {
            *sum = [sum[0] + x * c, sum[1] + x * s];
        }
        (c, s) = (c * cos_step - s * sin_step, s * cos_step + c * sin_step);
    }
    sums.iter().flatten().map(|x| x * x).sum()
}

pub(crate) fn largest(values: impl IntoIterator<Item = f64>) -> f64 {
    values.into_iter().fold(f64::NEG_INFINITY, f64::max)
}
