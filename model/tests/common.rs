//! What the tests feed to networks.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slipsense::features::XlFeatures;
use slipsense::params::TAXELS;
use slipsense::sensor::PiezoFrame;
use slipsense_model::weights::{FIRST_DIMS, Weights};

/// Random weights with every kind of parameter away from its first value.
pub fn random_weights(seed: u64) -> Weights {
    let mut weights = Weights::init(FIRST_DIMS, seed);
    let mut rng = ChaCha8Rng::seed_from_u64(seed + 1);
    for x in weights.tensors.iter_mut().flatten() {
        *x += rng.random_range(-0.1..0.1f32);
    }
    weights
}

/// Scans with a patch of pressure that wanders, `[frame][sensor]`.
pub fn scans(frames: usize, sensors: usize, seed: u64) -> Vec<PiezoFrame> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let scan = |index: usize| {
        let mut counts = [0u16; TAXELS];
        let (row, col) = (8 + index / 7 % 12, 10 + index / 11 % 8);
        for r in row..row + 6 {
            for c in col..col + 5 {
                counts[r * 32 + c] = rng.random_range(0..1500);
            }
        }
        PiezoFrame::from_scan(counts)
    };
    (0..frames * sensors).map(scan).collect()
}

/// Frames of accelerometers, Q2.13, `[frame][sensor]`.
pub fn xl_frames(frames: usize, sensors: usize, seed: u64) -> Vec<XlFeatures> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..frames * sensors).map(|_| std::array::from_fn(|_| rng.random_range(-14_000..14_000))).collect()
}
