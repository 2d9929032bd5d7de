//! Gaussian noise for a thousand taxels per frame.

use std::sync::LazyLock;

use libm::erfc;
use rand::RngCore;

use crate::draw::Rng;

const BITS: u32 = 12;
const LEVELS: usize = 1 << BITS;

/// Equally likely levels of a Gaussian of unit variance.
static TABLE: LazyLock<Vec<f32>> = LazyLock::new(|| {
    // Middle of each level in probability, by bisection of the distribution.
    let level = |i: usize| {
        let tail = 1.0 - (i as f64 + 0.5) / LEVELS as f64;
        let (mut low, mut high) = (-5.0, 5.0);
        for _ in 0..40 {
            let middle = (low + high) / 2.0;
            if above(middle) > tail { low = middle } else { high = middle }
        }
        (low + high) / 2.0
    };
    let upper: Vec<f64> = (LEVELS / 2..LEVELS).map(level).collect();
    let rms = (upper.iter().map(|z| z * z).sum::<f64>() / upper.len() as f64).sqrt();
    upper.iter().rev().map(|z| (-z / rms) as f32).chain(upper.iter().map(|z| (z / rms) as f32)).collect()
});

/// Probability that a Gaussian of unit variance exceeds `z`.
pub(super) fn above(z: f64) -> f64 {
    0.5 * erfc(z * std::f64::consts::FRAC_1_SQRT_2)
}

/// Gaussian draws of unit variance, 4096 equally likely levels out to 3.7 sigma: for noise of about a
/// count that is rounded to counts, at a fraction of the cost of exact ones.
pub(super) fn draws<const N: usize>(rng: &mut Rng, out: &mut [f32; N]) {
    let table: &[f32; LEVELS] = TABLE.as_slice().try_into().expect("as many entries as levels");
    let mut bits = [[0; 2]; N];
    rng.fill_bytes(bits.as_flattened_mut());
    for (value, bits) in out.iter_mut().zip(bits) {
        *value = table[u16::from_le_bytes(bits) as usize % LEVELS];
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::within;
    use crate::draw::{Stream, stream};

    #[test]
    fn the_table_is_gaussian() {
        let mut draws = [0.0; 200_000];
        super::draws(&mut stream(3, Stream::Film, 0), &mut draws);
        let mean = |of: &dyn Fn(f64) -> f64| draws.iter().map(|&z| of(f64::from(z))).sum::<f64>() / 200e3;
        within("mean", mean(&|z| z), -0.01..0.01);
        within("second moment", mean(&|z| z * z), 0.98..1.02);
        within("third", mean(&|z| z * z * z), -0.03..0.03);
        within("fourth", mean(&|z| z * z * z * z), 2.9..3.1);
        within("above 2, off", mean(&|z| f64::from(u8::from(z > 2.0))) - above(2.0), -0.002..0.002);
    }
}
