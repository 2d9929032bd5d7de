//! From values to places on the picture.

use std::ops::Range;

/// Where the plots of a picture begin and end.
pub(super) const LEFT: f64 = 104.0;
pub(super) const RIGHT: f64 = 1084.0;

/// A linear map from values to pixels.
#[derive(Clone, Debug)]
pub(super) struct Scale {
    from: Range<f64>,
    to: Range<f64>,
}

impl Scale {
    /// `from.start` goes to `to.start`, `from.end` to `to.end`. An empty range is widened.
    pub(super) fn new(from: Range<f64>, to: Range<f64>) -> Self {
        let from = if from.end > from.start { from } else { from.start..from.start + 1.0 };
        Self { from, to }
    }

    pub(super) fn at(&self, value: f64) -> f64 {
        let share = (value - self.from.start) / (self.from.end - self.from.start);
        self.to.start + share * (self.to.end - self.to.start)
    }

    pub(super) fn clamp(&self, value: f64) -> f64 {
        self.at(value.clamp(self.from.start, self.from.end))
    }

    /// Round numbers inside the range, about `count` of them, and the digits they need.
    pub(super) fn ticks(&self, count: usize) -> (Vec<f64>, usize) {
        let rough = (self.from.end - self.from.start) / count.max(1) as f64;
        let power = 10f64.powf(rough.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * power).into_iter().find(|s| *s >= rough * 0.999);
        let step = step.unwrap_or(rough);
        let first = (self.from.start / step - 1e-6).ceil() as i64;
        let last = (self.from.end / step + 1e-6).floor() as i64;
        let digits = (-step.log10().floor()).max(0.0) as usize;
        ((first..=last).map(|i| i as f64 * step).collect(), digits)
    }
}

/// Frames that share one column of a picture that is narrower than the episode is long.
pub(super) fn columns(frames: Range<usize>, at_most: usize) -> Vec<Range<usize>> {
    let count = frames.len().min(at_most);
    let edge = |i: usize| frames.start + i * frames.len() / count.max(1);
    (0..count).map(|i| edge(i)..edge(i + 1)).collect()
}

/// Points of a line, at most two per column: where frames share one, its extremes, so that no peak is lost.
pub(super) fn line(frames: Range<usize>, at_most: usize, value: impl Fn(usize) -> f64) -> Vec<(f64, f64)> {
    let mut points = Vec::new();
    for column in columns(frames, at_most) {
        let at = |f: usize| (f as f64, value(f));
        if column.len() == 1 {
            points.push(at(column.start));
            continue;
        }
        let by_value = |a: &usize, b: &usize| value(*a).total_cmp(&value(*b));
        if let (Some(low), Some(high)) = (column.clone().min_by(by_value), column.max_by(by_value)) {
            points.extend([at(low.min(high)), at(low.max(high))]);
        }
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        let ticks = |from: Range<f64>, count| Scale::new(from, 0.0..1.0).ticks(count);
        assert_eq!(ticks(0.0..6.0, 6), (vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0], 0));
        let (fine, digits) = ticks(-0.3..0.3, 3);
        assert_eq!((fine.len(), digits), (3, 1));
        assert!(fine.iter().zip([-0.2, 0.0, 0.2]).all(|(a, b)| (a - b).abs() < 1e-12));
    }

    #[test]
    fn a_flat_signal_has_a_scale() {
        assert_eq!(Scale::new(3.0..3.0, 10.0..20.0).at(3.0), 10.0);
    }

    #[test]
    fn columns_cover_every_frame_once() {
        for (frames, at_most) in [(10, 3), (3, 10), (7, 7), (0, 5)] {
            let all: Vec<usize> = columns(0..frames, at_most).into_iter().flatten().collect();
            assert_eq!(all, (0..frames).collect::<Vec<_>>());
        }
    }

    #[test]
    fn a_line_keeps_its_extremes() {
        let spike = |f| if f == 501 { 9.0 } else { (f % 2) as f64 };
        let points = line(0..1000, 10, spike);
        assert!(points.len() <= 20);
        assert!(points.contains(&(501.0, 9.0)));
        assert!(points.windows(2).all(|pair| pair[0].0 < pair[1].0));
    }
}
