//! Changes that leave the truth as it is. One of each per sequence and sensor, the same for all its
//! frames: a change from frame to frame would invent motion.

use rand::Rng;
use rand_chacha::ChaCha8Rng;
use slipsense::params::{MEL_BINS, TAXEL_COLS, TAXEL_ROWS, TAXELS};
use slipsense::sensor::is_active;

use crate::float::PIEZO_INPUT_SCALE;
use crate::reference::log_mel_real;

/// Largest roll: 30 % of a side.
const ROLL_MAX: i32 = (TAXEL_ROWS as i32 * 3) / 10;
/// Largest standard deviation of the noise on loaded taxels, counts (paper: 0.001 of 4096).
const NOISE_COUNTS: f32 = 4.0;
/// Most mel bins masked.
const MASK_MAX: usize = 5;
/// Largest amplitude of the uniform noise on standardised log-mel.
const NOISE_LOG_MEL: f32 = 0.1;

/// Where each taxel's reading comes from, and how noisy it gets.
#[derive(Clone, Debug)]
pub struct PadChange {
    /// Index of the taxel read; `None` off the pad, which stays 0.
    source: Vec<Option<usize>>,
    /// Standard deviation, counts.
    noise: f32,
}

impl PadChange {
    /// Flips and a roll, each in half of the cases, and some noise.
    pub fn draw(rng: &mut ChaCha8Rng) -> Self {
        let (flip_rows, flip_cols) = (rng.random_bool(0.5), rng.random_bool(0.5));
        let roll = if rng.random_bool(0.5) {
            [rng.random_range(-ROLL_MAX..=ROLL_MAX), rng.random_range(-ROLL_MAX..=ROLL_MAX)]
        } else {
            [0, 0]
        };
        let noise = rng.random_range(0.0..NOISE_COUNTS);
        Self::new([flip_rows, flip_cols], roll, noise)
    }

    /// Flip rows, columns; then roll by this many rows, columns. `noise` in counts.
    pub fn new(flip: [bool; 2], roll: [i32; 2], noise: f32) -> Self {
        let from = |at: usize, size: usize, roll: i32, flip: bool| {
            let rolled = (at as i32 - roll).rem_euclid(size as i32) as usize;
            if flip { size - 1 - rolled } else { rolled }
        };
        let source = (0..TAXELS).map(|index| {
            let (row, col) = (index / TAXEL_COLS, index % TAXEL_COLS);
            let read = from(row, TAXEL_ROWS, roll[0], flip[0]) * TAXEL_COLS
                + from(col, TAXEL_COLS, roll[1], flip[1]);
            is_active(row, col).then_some(read)
        });
        Self { source: source.collect(), noise }
    }

    /// One scan to the input of the network. Noise reaches loaded taxels only: on an empty pad, clipped
    /// at 0, it would look like contact.
    pub fn apply(&self, counts: &[u16], out: &mut [f32], rng: &mut ChaCha8Rng) {
        for (out, source) in out.iter_mut().zip(&self.source) {
            let count = source.map_or(0, |source| counts[source]);
            let real = if count == 0 {
                0.0
            } else {
                (f32::from(count) + self.noise * almost_normal(rng)).round().clamp(0.0, 4095.0)
            };
            *out = real * PIEZO_INPUT_SCALE;
        }
    }
}

/// Mean 0, variance 1: the sum of four uniform bytes.
fn almost_normal(rng: &mut ChaCha8Rng) -> f32 {
    let sum: i32 = rng.random::<u32>().to_le_bytes().iter().map(|&byte| i32::from(byte)).sum();
    (sum - 510) as f32 / 147.8
}

/// Which mel bins are hidden, and how noisy the others get.
#[derive(Clone, Debug)]
pub struct MelChange {
    masked: std::ops::Range<usize>,
    noise: f32,
}

impl MelChange {
    /// One to five neighbouring bins masked in half of the cases, and some noise.
    pub fn draw(rng: &mut ChaCha8Rng) -> Self {
        let width = if rng.random_bool(0.5) { rng.random_range(1..=MASK_MAX) } else { 0 };
        let from = rng.random_range(0..=MEL_BINS - width);
        Self { masked: from..from + width, noise: rng.random_range(0.0..NOISE_LOG_MEL) }
    }

    /// One frame; a masked bin becomes 0, the mean of a standardised frame.
    pub fn apply(&self, log_mel: &[i16], out: &mut [f32], rng: &mut ChaCha8Rng) {
        for (bin, (out, &q13)) in out.iter_mut().zip(log_mel).enumerate() {
            *out = if self.masked.contains(&bin) {
                0.0
            } else {
                log_mel_real(q13) + self.noise * rng.random_range(-1.0..1.0f32)
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn a_flip_and_a_roll_move_a_taxel_and_keep_the_corners_empty() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut counts = vec![0u16; TAXELS];
        counts[10 * TAXEL_COLS + 12] = 512;
        let mut out = vec![0.0; TAXELS];
        PadChange::new([true, false], [2, -3], 0.0).apply(&counts, &mut out, &mut rng);
        // Row 10 flips to 21 and rolls to 23; column 12 rolls to 9.
        let loaded: Vec<usize> = (0..TAXELS).filter(|&i| out[i] != 0.0).collect();
        assert_eq!((loaded, out[23 * TAXEL_COLS + 9]), (vec![23 * TAXEL_COLS + 9], 2.0));

        PadChange::new([false, false], [9, 9], 4.0).apply(&[4095; TAXELS], &mut out, &mut rng);
        for (index, &value) in out.iter().enumerate() {
            let active = is_active(index / TAXEL_COLS, index % TAXEL_COLS);
            assert_eq!(value > 0.0, active, "taxel {index}");
        }
    }

    #[test]
    fn noise_leaves_an_empty_pad_empty() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let mut out = vec![1.0; TAXELS];
        PadChange::new([false; 2], [0; 2], 4.0).apply(&[0; TAXELS], &mut out, &mut rng);
        assert!(out.iter().all(|&x| x == 0.0));
    }

    #[test]
    fn a_mask_hides_at_most_five_bins() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut hidden = [0; MASK_MAX + 1];
        for _ in 0..200 {
            let mut out = vec![0.0; MEL_BINS];
            MelChange::draw(&mut rng).apply(&[8192; MEL_BINS], &mut out, &mut rng);
            hidden[out.iter().filter(|&&x| x == 0.0).count()] += 1;
        }
        assert!(hidden.iter().all(|&n| n > 0) && hidden[0] > 60, "{hidden:?}");
    }
}
