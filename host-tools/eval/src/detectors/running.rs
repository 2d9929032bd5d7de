//! A causal estimate of what is normal: median and spread over the last eight seconds.

/// Frames between two values that are kept: 30 values per second.
const KEEP_EVERY: u32 = 8;
/// Values kept: 8 s. Longer than a slip of the protocol, so that most of what is kept is not slip.
const KEPT: usize = 240;
/// Values needed before there is an estimate: half a second.
const NEEDED: usize = 15;
/// Smallest spread, as a share of the median: ends division by zero in recorded silence.
const SPREAD_MIN: f64 = 1e-3;

#[derive(Clone, Copy, Debug, PartialEq)]
struct Normal {
    median: f64,
    /// Median absolute deviation, at least a thousandth of the median's magnitude and above 0.
    mad: f64,
}

/// Running median and median absolute deviation.
#[derive(Clone, Debug, Default)]
pub(super) struct RunningMedian {
    /// In order of time, a ring once full.
    recent: Vec<f64>,
    oldest: usize,
    sorted: Vec<f64>,
    frames: u32,
    normal: Option<Normal>,
}

impl RunningMedian {
    /// How many spreads a finite value is above the median of the values before it. `None` in the first half
    /// second.
    pub(super) fn spreads_above(&mut self, value: f64) -> Option<f64> {
        self.step(value).map(|normal| (value - normal.median) / normal.mad)
    }

    fn step(&mut self, value: f64) -> Option<Normal> {
        let normal = self.normal;
        if self.frames.is_multiple_of(KEEP_EVERY) {
            self.keep(value);
            self.normal = (self.sorted.len() >= NEEDED).then(|| normal_of(&self.sorted));
        }
        self.frames = (self.frames + 1) % KEEP_EVERY;
        normal
    }

    fn keep(&mut self, value: f64) {
        if self.recent.len() < KEPT {
            self.recent.push(value);
        } else {
            let gone = std::mem::replace(&mut self.recent[self.oldest], value);
            self.oldest = (self.oldest + 1) % KEPT;
            let at = self.sorted.partition_point(|x| *x < gone);
            self.sorted.remove(at);
        }
        let at = self.sorted.partition_point(|x| *x < value);
        self.sorted.insert(at, value);
    }
}

/// Upper median of sorted values and of their distances from it.
fn normal_of(sorted: &[f64]) -> Normal {
    let middle = sorted.len() / 2;
    let median = sorted[middle];
    // Walk outwards from the median: distances come in order, each side being sorted.
    let (mut below, mut above) = (middle, middle);
    let mut distance = 0.0;
    for _ in 0..=middle {
        let down = below.checked_sub(1).map_or(f64::INFINITY, |i| median - sorted[i]);
        let up = sorted.get(above).map_or(f64::INFINITY, |x| x - median);
        distance = down.min(up);
        if down < up { below -= 1 } else { above += 1 }
    }
    Normal { median, mad: distance.max(SPREAD_MIN * median.abs()).max(f64::MIN_POSITIVE) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn median_and_spread_by_hand() {
        // Distances from 5: 0, 1, 1, 3, 95; the middle one is 1.
        assert_eq!(normal_of(&[2.0, 4.0, 5.0, 6.0, 100.0]), Normal { median: 5.0, mad: 1.0 });
        assert_eq!(normal_of(&[7.0; 9]), Normal { median: 7.0, mad: 7e-3 });
    }

    #[test]
    fn the_window_forgets_and_starts_without_an_estimate() {
        let mut running = RunningMedian::default();
        let first = (0..1000).position(|_| running.step(1.0).is_some()).unwrap();
        assert_eq!(first, 8 * 14 + 1);
        for _ in 0..8 * 121 {
            running.step(9.0);
        }
        assert_eq!(running.step(9.0).unwrap().median, 9.0, "121 of 240 kept values are new");
        for _ in 0..8 * 240 {
            running.step(3.0);
        }
        assert_eq!(running.sorted, [3.0; 240]);
    }

    #[test]
    fn a_value_is_not_part_of_its_own_median() {
        let mut running = RunningMedian::default();
        for _ in 0..400 {
            running.step(1.0);
        }
        let mut other = running.clone();
        assert_eq!(running.step(50.0), other.step(2.0));
    }
}
