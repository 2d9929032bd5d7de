//! Changes that leave the truth as it is. One of each per sequence and sensor, the same for all its
//! frames: a change from frame to frame would invent motion.

mod mel;
mod pad;

pub use mel::{MelChange, Sound};
pub use pad::{PadChange, SlowArray};

/// Mean 0, variance 1: the sum of four uniform bytes.
fn almost_normal(rng: &mut impl rand::Rng) -> f32 {
    let sum: i32 = rng.random::<u32>().to_le_bytes().iter().map(|&byte| i32::from(byte)).sum();
    (sum - 510) as f32 / 147.8
}
