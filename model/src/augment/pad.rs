//! Changes of a pad: rotation, flips, roll, gain, noise.

use rand::Rng;
use rand_chacha::ChaCha8Rng;
use slipsense::params::{COL_PITCH_MM, COUNT_MAX, ROW_PITCH_MM, TAXEL_COLS, TAXEL_ROWS, TAXELS};
use slipsense::sensor::is_active;

/// Share of sequences that are rotated.
const ROTATED: f64 = 0.3;
/// Largest roll: 30 % of a side.
const ROLL_MAX: i32 = (TAXEL_ROWS as i32 * 3) / 10;
/// Smallest and largest factor on all counts, drawn evenly on a logarithmic scale: films and circuits differ by as much.
const GAIN: std::ops::Range<f32> = 0.5..2.0;
/// Share of the arrays that are slow.
const SLOW: f64 = 0.15;
/// Frames between two scans of a slow array.
const SLOW_FRAMES: std::ops::RangeInclusive<usize> = 2..=10;
/// Largest standard deviation of the noise on loaded taxels, counts (paper: 0.001 of 4096).
const NOISE_COUNTS: f32 = 4.0;

/// Where each taxel's reading comes from, how much of it, and how noisy it gets.
#[derive(Clone, Debug)]
pub struct PadChange {
    /// Index of the taxel read; `None` off the pad, which stays 0.
    source: Vec<Option<usize>>,
    gain: f32,
    /// Standard deviation, counts.
    noise: f32,
}

impl PadChange {
    /// Flips and a roll, each in half of the cases, a rotation in some, a gain and some noise.
    pub fn draw(rng: &mut ChaCha8Rng) -> Self {
        let flip = [rng.random_bool(0.5), rng.random_bool(0.5)];
        let roll = if rng.random_bool(0.5) {
            [rng.random_range(-ROLL_MAX..=ROLL_MAX), rng.random_range(-ROLL_MAX..=ROLL_MAX)]
        } else {
            [0, 0]
        };
        let angle_rad =
            if rng.random_bool(ROTATED) { rng.random_range(0.0..std::f32::consts::TAU) } else { 0.0 };
        let gain = rng.random_range(GAIN.start.ln()..GAIN.end.ln()).exp();
        let noise = rng.random_range(0.0..NOISE_COUNTS);
        Self::new(angle_rad, flip, roll, gain, noise)
    }

    /// Rotate about the pad's middle, flip rows, columns, then roll by rows and columns. `noise`: counts.
    pub fn new(angle_rad: f32, flip: [bool; 2], roll: [i32; 2], gain: f32, noise: f32) -> Self {
        let from = |at: usize, size: usize, roll: i32, flip: bool| {
            let rolled = (at as i32 - roll).rem_euclid(size as i32) as usize;
            if flip { size - 1 - rolled } else { rolled }
        };
        let source = (0..TAXELS).map(|index| {
            let (row, col) = (index / TAXEL_COLS, index % TAXEL_COLS);
            let before_roll =
                (from(row, TAXEL_ROWS, roll[0], flip[0]), from(col, TAXEL_COLS, roll[1], flip[1]));
            let read = rotated(before_roll, angle_rad)?;
            is_active(row, col).then_some(read)
        });
        Self { source: source.collect(), gain, noise }
    }

    /// A scan, so much of the way `between` two of them, changed. Noise reaches loaded taxels only: clipped at 0 on an
    /// empty pad, it would look like contact.
    pub fn apply(
        &self,
        [before, after]: [&[u16; TAXELS]; 2],
        between: f32,
        out: &mut [u16; TAXELS],
        rng: &mut ChaCha8Rng,
    ) {
        for (out, source) in out.iter_mut().zip(&self.source) {
            let [before, after] =
                [before, after].map(|scan| source.map_or(0.0, |source| f32::from(scan[source])));
            let count = before + between * (after - before);
            *out = if count == 0.0 {
                0
            } else {
                let real = count * self.gain + self.noise * almost_normal(rng);
                real.round().clamp(0.0, f32::from(COUNT_MAX)) as u16
            };
        }
    }
}

/// An array that is scanned less often than the frames come: held, or interpolated by who delivers them.
#[derive(Clone, Copy, Debug)]
pub struct SlowArray {
    /// Frames from one scan to the next.
    step: usize,
    interpolated: bool,
}

impl SlowArray {
    pub fn draw(rng: &mut ChaCha8Rng) -> Self {
        let step = if rng.random_bool(SLOW) { rng.random_range(SLOW_FRAMES) } else { 1 };
        Self { step, interpolated: rng.random_bool(0.5) }
    }

    /// The scans before and after a frame, by their frames.
    pub fn scans(self, frame: usize) -> [usize; 2] {
        let before = frame - frame % self.step;
        [before, if self.interpolated { before + self.step } else { before }]
    }

    /// How far a frame is from the one to the other, 0 to 1.
    pub fn between(self, frame: usize) -> f32 {
        (frame % self.step) as f32 / self.step as f32
    }
}

/// Mean 0, variance 1: the sum of four uniform bytes.
fn almost_normal(rng: &mut ChaCha8Rng) -> f32 {
    let sum: i32 = rng.random::<u32>().to_le_bytes().iter().map(|&byte| i32::from(byte)).sum();
    (sum - 510) as f32 / 147.8
}

/// The taxel nearest to where this one is before a rotation; the grid's pitch differs in rows and columns.
fn rotated((row, col): (usize, usize), angle_rad: f32) -> Option<usize> {
    if angle_rad == 0.0 {
        return Some(row * TAXEL_COLS + col);
    }
    let middle = |size: usize| (size - 1) as f32 / 2.0;
    let y = (row as f32 - middle(TAXEL_ROWS)) * ROW_PITCH_MM;
    let x = (col as f32 - middle(TAXEL_COLS)) * COL_PITCH_MM;
    let (sin, cos) = angle_rad.sin_cos();
    let row = ((cos * y + sin * x) / ROW_PITCH_MM + middle(TAXEL_ROWS)).round();
    let col = ((cos * x - sin * y) / COL_PITCH_MM + middle(TAXEL_COLS)).round();
    let on_grid = (0.0..TAXEL_ROWS as f32).contains(&row) && (0.0..TAXEL_COLS as f32).contains(&col);
    on_grid.then(|| row as usize * TAXEL_COLS + col as usize)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    fn changed(change: PadChange, counts: &[u16; TAXELS]) -> [u16; TAXELS] {
        let mut out = [1; TAXELS];
        change.apply([counts; 2], 0.0, &mut out, &mut ChaCha8Rng::seed_from_u64(1));
        out
    }

    #[test]
    fn a_flip_and_a_roll_move_a_taxel_and_keep_the_corners_empty() {
        let mut counts = [0u16; TAXELS];
        counts[10 * TAXEL_COLS + 12] = 512;
        let out = changed(PadChange::new(0.0, [true, false], [2, -3], 1.0, 0.0), &counts);
        // Row 10 flips to 21 and rolls to 23; column 12 rolls to 9.
        let loaded: Vec<usize> = (0..TAXELS).filter(|&i| out[i] != 0).collect();
        assert_eq!((loaded, out[23 * TAXEL_COLS + 9]), (vec![23 * TAXEL_COLS + 9], 512));

        let out = changed(PadChange::new(0.0, [false, false], [9, 9], 1.2, 4.0), &[4095; TAXELS]);
        for (index, &value) in out.iter().enumerate() {
            let active = is_active(index / TAXEL_COLS, index % TAXEL_COLS);
            assert_eq!(value > 0, active, "taxel {index}");
            assert!(value <= COUNT_MAX);
        }
    }

    #[test]
    fn a_rotation_turns_millimetres_and_not_cells() {
        // A quarter turn takes 7 rows of 0.92 mm to 9.2 columns of 0.7 mm.
        let mut counts = [0u16; TAXELS];
        for row in 22..24 {
            for col in 15..17 {
                counts[row * TAXEL_COLS + col] = 100;
            }
        }
        let quarter = std::f32::consts::FRAC_PI_2;
        let out = changed(PadChange::new(quarter, [false; 2], [0; 2], 1.0, 0.0), &counts);
        let at: Vec<(usize, usize)> =
            (0..TAXELS).filter(|&i| out[i] != 0).map(|i| (i / TAXEL_COLS, i % TAXEL_COLS)).collect();
        let mean = |f: fn(&(usize, usize)) -> usize| {
            at.iter().map(|c| f(c) as f32).sum::<f32>() / at.len() as f32 - 15.5
        };
        let (row, col) = (mean(|c| c.0), mean(|c| c.1));
        assert!(
            row.abs() < 0.6 && (col.abs() - 7.0 * ROW_PITCH_MM / COL_PITCH_MM).abs() < 0.6,
            "{row} {col}"
        );
    }

    #[test]
    fn noise_leaves_an_empty_pad_empty() {
        let out = changed(PadChange::new(0.3, [false; 2], [0; 2], 1.0, 4.0), &[0; TAXELS]);
        assert!(out.iter().all(|&x| x == 0));
    }
}
