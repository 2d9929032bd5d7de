//! What the tests of the network feed it.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slipsense::features::XlFeatures;
use slipsense::net::format::Dims;
use slipsense::params::{TAXELS, XL_FEATURES};
use slipsense::sensor::PiezoFrame;

/// The shapes the kernels are tested at: the shipped one, the smallest, odd ones, the largest.
pub const SHAPES: [Dims; 4] = [
    Dims { conv_channels: [4, 8, 16], embed: 32, xl_kernel: 5, xl_channels: 48, heads: 4, window: 60 },
    Dims { conv_channels: [1, 1, 1], embed: 1, xl_kernel: 1, xl_channels: 1, heads: 1, window: 1 },
    Dims { conv_channels: [3, 5, 7], embed: 15, xl_kernel: 3, xl_channels: 11, heads: 3, window: 7 },
    Dims { conv_channels: [8, 16, 32], embed: 64, xl_kernel: 6, xl_channels: 96, heads: 8, window: 60 },
];

/// One sensor's input to the network.
#[derive(Clone, Debug)]
pub struct Sensor {
    /// Array scan, if it came.
    pub piezo: Option<PiezoFrame>,
    /// Features of the accelerometer, if they came.
    pub xl: Option<XlFeatures>,
}

/// Frames of `sensors` sensors: idle pads, light and full contact, extremes, and parts missing.
pub fn random_frames(frames: usize, sensors: usize, seed: u64) -> Vec<Vec<Sensor>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..frames).map(|_| (0..sensors).map(|_| random_sensor(&mut rng)).collect()).collect()
}

fn random_sensor(rng: &mut ChaCha8Rng) -> Sensor {
    let mut counts = [0u16; TAXELS];
    let kind = rng.random_range(0..5);
    for (index, count) in counts.iter_mut().enumerate() {
        *count = match kind {
            0 => rng.random_range(0..2),
            1 if index / 32 > 10 && index % 32 < 20 => rng.random_range(0..600),
            2 => rng.random_range(0..4096),
            3 => 4095,
            _ => 0,
        };
    }
    let mut xl = [0i16; XL_FEATURES];
    for value in &mut xl {
        *value = if kind == 3 { [i16::MIN, i16::MAX][rng.random_range(0..2)] } else { rng.random() };
    }
    Sensor {
        piezo: rng.random_bool(0.95).then(|| PiezoFrame::from_scan(counts)),
        xl: rng.random_bool(0.95).then_some(xl),
    }
}
