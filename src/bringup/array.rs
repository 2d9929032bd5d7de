//! An array's codes: mean and noise of each taxel, and what they say of connector, lines, taxels, settling.
//!
//! An address line that is open shows where two addresses differ by it alone and read the same; two lines that are
//! swapped show where the pad has no taxel and the scan finds one pressed. So the whole pad must be pressed. Lines that
//! are swapped within the pad's symmetry (an exchange that maps its corners onto themselves) do not show.

use super::{Finding, NOISE_MAX_CODES, PRESSED_CODES, SETTLED_CODES, STEP_MIN_CODES};
use crate::drivers::scan::ADDRESS_LINES;
use crate::params::{ACTIVE_TAXELS, TAXEL_COLS, TAXEL_ROWS, TAXELS};
use crate::sensor::is_active;
use crate::transfer::{FULL_SCALE_CODES, IDLE_CODE};

/// From this code on an input is at the rail.
const RAIL_CODE: u32 = u16::MAX as u32 - 255;
/// Beyond full scale: the amplifier is at its rail, which need not be the ADC's.
const HIGH_CODE: u32 = IDLE_CODE as u32 + FULL_SCALE_CODES;
/// Codes by which two taxels differ for certain: an eighth of what counts as pressed, far above the noise of a mean.
const DIFFERENT_CODES: u32 = PRESSED_CODES / 8;
/// Of the taxels on the pad, this part must be pressed to judge the lines.
const PRESSED_MIN: usize = ACTIVE_TAXELS * 3 / 4;
/// Of the pairs of addresses that a line tells apart, so many may differ by chance if it does not.
const PAIRS_MAX: usize = TAXELS / 2 / 100;

/// Sums over frames of one array.
#[derive(Debug)]
pub struct ArrayStats {
    frames: u32,
    sums: [u32; TAXELS],
    squares: [u64; TAXELS],
}

impl ArrayStats {
    /// No frame yet.
    pub const fn new() -> Self {
        Self { frames: 0, sums: [0; TAXELS], squares: [0; TAXELS] }
    }

    /// Forget all.
    pub fn clear(&mut self) {
        self.frames = 0;
        self.sums.fill(0);
        self.squares.fill(0);
    }

    /// A scan of `arrays` arrays, of which this is number `index`. At most 65,536 of them.
    pub fn add(&mut self, codes: &[u16], index: usize, arrays: usize) {
        self.frames += 1;
        let codes = codes.chunks_exact(arrays.max(1)).filter_map(|codes| codes.get(index));
        for ((&code, sum), square) in codes.zip(&mut self.sums).zip(&mut self.squares) {
            *sum += u32::from(code);
            *square += u64::from(code) * u64::from(code);
        }
    }

    /// Mean code of a slot.
    pub fn mean(&self, slot: usize) -> u32 {
        let frames = self.frames.max(1);
        self.sums.get(slot).map_or(0, |sum| (sum + frames / 2) / frames)
    }

    /// Variance of a slot, codes², as frames² times it: no rounding hides a code that changed once.
    fn spread(&self, slot: usize) -> u64 {
        let (sum, square) = (self.sums.get(slot), self.squares.get(slot));
        let sum = u64::from(sum.copied().unwrap_or(0));
        u64::from(self.frames) * square.copied().unwrap_or(0) - sum * sum
    }

    /// Noise of a slot, codes rms.
    pub fn noise(&self, slot: usize) -> u32 {
        let frames = u64::from(self.frames.max(1));
        (self.spread(slot) / (frames * frames)).isqrt() as u32
    }

    fn is_pressed(&self, slot: usize) -> bool {
        self.mean(slot) > u32::from(IDLE_CODE) + PRESSED_CODES
    }

    /// The slot that is farthest from the one before it, and by how much, codes; of those that rise, because a drop
    /// ends at the array's idle level.
    pub fn largest_step(&self) -> (usize, u32) {
        let step = |slot: usize| (slot, self.mean(slot).saturating_sub(self.mean(slot - 1)));
        let below_rail = |slot: &usize| self.mean(*slot) < HIGH_CODE;
        (1..TAXELS).filter(below_rail).map(step).max_by_key(|(_, step)| *step).unwrap_or((1, 0))
    }
}

const fn on_pad(slot: usize) -> bool {
    is_active(slot / TAXEL_COLS, slot % TAXEL_COLS)
}

fn count(of: impl Fn(usize) -> bool) -> usize {
    (0..TAXELS).filter(|&slot| of(slot)).count()
}

/// The first thing that is wrong with an array, from the connector to the single taxel.
pub fn judge_array(stats: &ArrayStats) -> Finding {
    if count(|slot| stats.mean(slot) >= RAIL_CODE) > TAXELS * 9 / 10 {
        return Finding::ArrayUnplugged;
    }
    if count(|slot| stats.mean(slot) < u32::from(IDLE_CODE) / 4) > TAXELS * 9 / 10 {
        return Finding::ArrayShorted;
    }
    if count(|slot| stats.spread(slot) == 0) > TAXELS * 9 / 10 {
        return Finding::ArrayFixed { code: stats.mean(0) as u16 };
    }
    if let Some((taxels, first)) = first_of(|slot| stats.noise(slot) > NOISE_MAX_CODES) {
        return Finding::TaxelsNoisy { taxels, first, codes: stats.noise(first.into()) };
    }
    let high = |slot: usize| stats.mean(slot) >= HIGH_CODE;
    if let Some(row) = (0..TAXEL_ROWS).find(|row| (0..TAXEL_COLS).all(|col| high(row * TAXEL_COLS + col))) {
        return Finding::RowHigh { row: row as u8 };
    }
    if let Some(col) = (0..TAXEL_COLS).find(|col| (0..TAXEL_ROWS).all(|row| high(row * TAXEL_COLS + col))) {
        return Finding::ColHigh { col: col as u8 };
    }
    if let Some((taxels, first)) = first_of(|slot| stats.spread(slot) == 0 && !high(slot)) {
        return Finding::TaxelsStuck { taxels, first };
    }
    let pressed = count(|slot| stats.is_pressed(slot));
    if pressed < PRESSED_MIN {
        return Finding::NotPressed;
    }
    judge_lines_by(stats).unwrap_or_else(|| Finding::ArrayAt {
        pressed: pressed as u32,
        noise_codes: (0..TAXELS).map(|slot| stats.noise(slot)).max().unwrap_or(0),
    })
}

/// How many taxels are so, and the first of them.
fn first_of(of: impl Fn(usize) -> bool) -> Option<(u32, u16)> {
    let first = (0..TAXELS).find(|&slot| of(slot))?;
    Some((count(&of) as u32, first as u16))
}

/// Under pressure: lines, rows, columns, taxels.
fn judge_lines_by(stats: &ArrayStats) -> Option<Finding> {
    let tells_apart = |line: u32| {
        let pairs = (0..TAXELS).filter(|slot| slot & 1 << line == 0);
        pairs
            .filter(|&slot| stats.mean(slot).abs_diff(stats.mean(slot | 1 << line)) > DIFFERENT_CODES)
            .count()
    };
    if let Some(line) = (0..ADDRESS_LINES).find(|&line| tells_apart(line) <= PAIRS_MAX) {
        return Some(Finding::AddressOpen { line: line as u8 });
    }
    let idle = |slot: usize| !on_pad(slot) || !stats.is_pressed(slot);
    if let Some(row) = (0..TAXEL_ROWS).find(|row| (0..TAXEL_COLS).all(|col| idle(row * TAXEL_COLS + col))) {
        return Some(Finding::RowSilent { row: row as u8 });
    }
    if let Some(col) = (0..TAXEL_COLS).find(|col| (0..TAXEL_ROWS).all(|row| idle(row * TAXEL_COLS + col))) {
        return Some(Finding::ColSilent { col: col as u8 });
    }
    let outside = count(|slot| stats.is_pressed(slot) && !on_pad(slot));
    if outside > 0 {
        let pairs = (1..ADDRESS_LINES).flat_map(|b| (0..b).map(move |a| (a, b)));
        let explains =
            |&(a, b): &(u32, u32)| count(|slot| stats.is_pressed(slot) && !on_pad(exchange(slot, a, b))) == 0;
        return Some(match pairs.into_iter().find(explains) {
            Some((a, b)) => Finding::AddressSwapped { lines: (a as u8, b as u8) },
            None => Finding::OutsidePad { taxels: outside as u32 },
        });
    }
    let dead = |slot: usize| {
        let neighbours = [slot.wrapping_sub(1), slot + 1, slot.wrapping_sub(TAXEL_COLS), slot + TAXEL_COLS];
        let pressed = |slot: &&usize| **slot < TAXELS && stats.is_pressed(**slot);
        on_pad(slot) && !stats.is_pressed(slot) && neighbours.iter().filter(pressed).count() >= 3
    };
    let (taxels, first) = first_of(dead)?;
    Some(Finding::TaxelsDead { taxels, first })
}

/// The address with two of its bits exchanged.
const fn exchange(slot: usize, a: u32, b: u32) -> usize {
    let differ = (slot >> a ^ slot >> b) & 1;
    slot ^ (differ << a | differ << b)
}

/// A transition's codes, the trigger three times, each as much later as the one before.
#[derive(Clone, Copy, Debug, Default)]
pub struct Settling {
    /// Codes before, and at the three triggers; the last is the firmware's.
    pub codes: [u32; 3],
    /// The whole step, codes.
    pub step_codes: u32,
}

/// Of an exponential, what is left after three samples at equal distances is d2² / (d1 − d2) of their differences d1,
/// d2; noise alone leaves next to nothing. `noise_codes`: of one frame.
pub fn judge_settling(settling: Settling, noise_codes: u32) -> Finding {
    let [a, b, c] = settling.codes.map(i64::from);
    let (d1, d2) = ((b - a).abs(), (c - b).abs());
    let step_codes = settling.step_codes;
    if step_codes < STEP_MIN_CODES {
        return Finding::NotPressed;
    }
    // Between two means of some frames; below it an exponential is not told from noise.
    let floor = SETTLED_CODES.max(2 * noise_codes);
    let left = if d2 <= i64::from(floor) { d2 } else { d2 * d2 / (d1 - d2).max(1) };
    let left_codes = left.clamp(0, i64::from(step_codes)) as u32;
    if left_codes > floor {
        Finding::NotSettled { left_codes, step_codes }
    } else {
        Finding::Settled { left_codes, step_codes }
    }
}
