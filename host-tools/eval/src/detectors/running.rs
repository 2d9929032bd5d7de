//! A causal estimate of what is normal: median and spread over the last eight seconds.

use std::collections::VecDeque;

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
    recent: VecDeque<f64>,
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
            self.recent.push_back(value);
            if self.recent.len() > KEPT {
                self.recent.pop_front();
            }
            self.normal = (self.recent.len() >= NEEDED).then(|| Normal::new(&self.recent));
        }
        self.frames = (self.frames + 1) % KEEP_EVERY;
        normal
    }
}

impl Normal {
    /// Upper median of the values and of their distances from it.
    fn new<'a>(values: impl IntoIterator<Item = &'a f64>) -> Self {
        let upper_median =
            |values: &mut [f64]| *values.select_nth_unstable_by(values.len() / 2, f64::total_cmp).1;
        let mut values: Vec<f64> = values.into_iter().copied().collect();
        let median = upper_median(&mut values);
        values.iter_mut().for_each(|value| *value = (*value - median).abs());
        Self { median, mad: upper_median(&mut values).max(SPREAD_MIN * median.abs()).max(f64::MIN_POSITIVE) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn median_and_spread_by_hand() {
        // Distances from 5: 0, 1, 1, 3, 95; the middle one is 1.
        assert_eq!(Normal::new(&[2.0, 4.0, 5.0, 6.0, 100.0]), Normal { median: 5.0, mad: 1.0 });
        assert_eq!(Normal::new(&[7.0; 9]), Normal { median: 7.0, mad: 7e-3 });
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
        assert_eq!(running.recent, [3.0; 240]);
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
