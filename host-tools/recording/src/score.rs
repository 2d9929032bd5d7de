//! How detections and classes are scored against the truth. One definition for the command line, the
//! trainer and the benchmark.
//!
//! An event is a maximal run of label 2. The first flag in `[onset − 50 ms, end]` belongs to it: at or
//! after the onset it is a hit, before the onset it is early, which is reported apart and is neither a
//! hit of latency 0 nor a false alarm. A flag after the end does not save the event. A false alarm is a
//! maximal run of flags outside all slip intervals widened by 50 ms on both sides; runs less than 200 ms
//! apart are one alarm. No score here is point-adjusted.

use slipsense::params::FRAME_RATE_HZ;

/// Frames by which a slip interval is widened on both sides: 50 ms.
pub const MARGIN_FRAMES: usize = (FRAME_RATE_HZ as usize * 50) / 1000;
/// False-alarm runs closer than this many frames are one alarm: 200 ms.
pub const MERGE_FRAMES: usize = (FRAME_RATE_HZ as usize * 200) / 1000;
pub use crate::label::SLIP;
pub use slipsense::params::CLASSES;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Detection {
    /// Flagged at or after the onset.
    Hit {
        /// Frames from the onset to the first flag; 0 is the onset frame itself.
        delay: usize,
    },
    /// Flagged up to 50 ms before the onset.
    Early {
        /// Frames from the first flag to the onset, 1 to [`MARGIN_FRAMES`].
        lead: usize,
    },
    /// Not flagged between 50 ms before the onset and the end.
    Missed,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EventScore {
    /// First frame labelled slip.
    pub onset: usize,
    /// First frame after the event.
    pub end: usize,
    pub detection: Detection,
}

/// The events of one episode and the alarms that belong to none.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct EventScores {
    /// In order of time.
    pub events: Vec<EventScore>,
    /// Flags raised where nothing slipped, gaps shorter than 200 ms included; in order of time.
    pub false_alarms: Vec<Interval>,
}

/// Frames `start..end`, not empty.
pub type Interval = (usize, usize);

/// Score one episode's flags. `label` holds classes 0 to 2, `slip` is non-zero where the flag is up.
///
/// # Panics
/// If the two differ in length.
pub fn score_events(label: &[u8], slip: &[u8]) -> EventScores {
    assert_eq!(label.len(), slip.len(), "one flag per label");
    score_intervals(&runs(label.len(), |f| label[f] == SLIP), slip)
}

/// Score one episode's flags against slip intervals, which are in order of time and do not overlap.
///
/// # Panics
/// If an interval ends behind the flags.
pub fn score_intervals(intervals: &[Interval], slip: &[u8]) -> EventScores {
    let mut previous_end = 0;
    let mut events = Vec::with_capacity(intervals.len());
    for &(onset, end) in intervals {
        // Frames of the event before are not early frames of this one.
        let from = onset.saturating_sub(MARGIN_FRAMES).max(previous_end);
        let detection = match (from..end).find(|&f| slip[f] != 0) {
            Some(first) if first >= onset => Detection::Hit { delay: first - onset },
            Some(first) => Detection::Early { lead: onset - first },
            None => Detection::Missed,
        };
        events.push(EventScore { onset, end, detection });
        previous_end = end;
    }

    let near_slip = near(intervals, slip.len());
    let mut false_alarms: Vec<Interval> = Vec::new();
    for (start, end) in runs(slip.len(), |f| slip[f] != 0 && !near_slip[f]) {
        match false_alarms.last_mut() {
            Some((_, last)) if start - *last < MERGE_FRAMES => *last = end,
            _ => false_alarms.push((start, end)),
        }
    }
    EventScores { events, false_alarms }
}

/// Frames, of `frames`, that lie in one of the intervals or at most [`MARGIN_FRAMES`] beside it: where a
/// flag is no false alarm.
pub fn near(intervals: &[Interval], frames: usize) -> Vec<bool> {
    let mut near = vec![false; frames];
    for &(onset, end) in intervals {
        let to = (end + MARGIN_FRAMES).min(frames);
        near[onset.saturating_sub(MARGIN_FRAMES)..to].fill(true);
    }
    near
}

/// Frame counts of truth against prediction; adds up over episodes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ClassScores {
    /// `confusion[truth][predicted]`, frames.
    pub confusion: [[u64; CLASSES]; CLASSES],
}

impl ClassScores {
    /// Count one episode's frames.
    ///
    /// # Panics
    /// If the two differ in length or hold a class above 2.
    pub fn new(label: &[u8], class: &[u8]) -> Self {
        assert_eq!(label.len(), class.len(), "one prediction per label");
        let mut confusion = [[0; CLASSES]; CLASSES];
        for (&truth, &predicted) in label.iter().zip(class) {
            confusion[truth as usize][predicted as usize] += 1;
        }
        Self { confusion }
    }

    pub fn add(&mut self, other: &Self) {
        for (row, other) in self.confusion.iter_mut().zip(&other.confusion) {
            for (count, other) in row.iter_mut().zip(other) {
                *count += other;
            }
        }
    }

    pub fn frames(&self) -> u64 {
        self.confusion.iter().flatten().sum()
    }

    /// Share of frames whose class is right, 0 to 1. `None` without frames.
    pub fn accuracy(&self) -> Option<f64> {
        ratio((0..CLASSES).map(|c| self.confusion[c][c]).sum(), self.frames())
    }

    /// F1 of one class, 0 to 1. `None` where the class is neither true nor predicted anywhere.
    pub fn f1(&self, class: usize) -> Option<f64> {
        let [hit, truth, predicted] = self.counts(class);
        ratio(2 * hit, truth + predicted)
    }

    /// Share of the frames predicted as `class` that are, 0 to 1. `None` where none is predicted.
    pub fn precision(&self, class: usize) -> Option<f64> {
        let [hit, _, predicted] = self.counts(class);
        ratio(hit, predicted)
    }

    /// Share of the frames of `class` that are predicted so, 0 to 1. `None` where there are none.
    pub fn recall(&self, class: usize) -> Option<f64> {
        let [hit, truth, _] = self.counts(class);
        ratio(hit, truth)
    }

    /// Frames of a class that are predicted so, that are of it, and that are predicted as it.
    fn counts(&self, class: usize) -> [u64; 3] {
        let predicted = self.confusion.iter().map(|row| row[class]).sum();
        [self.confusion[class][class], self.confusion[class].iter().sum(), predicted]
    }

    /// Unweighted mean of the classes' F1, over the classes that have one.
    pub fn macro_f1(&self) -> Option<f64> {
        let scores: Vec<f64> = (0..CLASSES).filter_map(|c| self.f1(c)).collect();
        (!scores.is_empty()).then(|| scores.iter().sum::<f64>() / scores.len() as f64)
    }

    /// False positives of slip as a share of the frames that do not slip. `None` without such frames.
    pub fn fpr_of_non_slip(&self) -> Option<f64> {
        let [hit, truth, predicted] = self.counts(SLIP.into());
        ratio(predicted - hit, self.frames() - truth)
    }

    /// False positives as a share of all frames. `None` without frames.
    pub fn fpr_of_all(&self) -> Option<f64> {
        let [hit, _, predicted] = self.counts(SLIP.into());
        ratio(predicted - hit, self.frames())
    }
}

fn ratio(part: u64, whole: u64) -> Option<f64> {
    (whole > 0).then(|| part as f64 / whole as f64)
}

/// Maximal runs of frames, of `frames`, for which `is` holds, in order of time.
pub fn runs(frames: usize, is: impl Fn(usize) -> bool) -> Vec<Interval> {
    let mut runs: Vec<Interval> = Vec::new();
    for f in (0..frames).filter(|&f| is(f)) {
        match runs.last_mut() {
            Some((_, end)) if *end == f => *end += 1,
            _ => runs.push((f, f + 1)),
        }
    }
    runs
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A label or flag track of 1000 frames, `value` in the given intervals.
    fn track(value: u8, intervals: &[Interval]) -> Vec<u8> {
        let mut track = vec![0; 1000];
        intervals.iter().for_each(|&(start, end)| track[start..end].fill(value));
        track
    }

    #[test]
    fn events_and_alarms_by_hand() {
        use Detection::Missed;
        let (hit, early) = (|delay| Detection::Hit { delay }, |lead| Detection::Early { lead });
        type Intervals<'a> = &'a [Interval];
        let cases: [(&str, Intervals<'_>, Intervals<'_>, &[Detection], Intervals<'_>); 13] = [
            ("at the onset", &[(100, 200)], &[(100, 210)], &[hit(0)], &[]),
            ("behind the onset", &[(100, 200)], &[(103, 210)], &[hit(3)], &[]),
            ("in the last frame", &[(100, 200)], &[(199, 210)], &[hit(99)], &[]),
            ("early is neither hit nor alarm", &[(100, 200)], &[(99, 150)], &[early(1)], &[]),
            ("as early as can be", &[(100, 200)], &[(88, 150)], &[early(12)], &[]),
            ("too early and too late", &[(100, 200)], &[(80, 88), (200, 205)], &[Missed], &[(80, 88)]),
            ("up to the end of the margin", &[(100, 200)], &[(110, 212)], &[hit(10)], &[]),
            ("past the margin", &[(100, 200)], &[(110, 213)], &[hit(10)], &[(212, 213)]),
            ("less than 200 ms apart", &[], &[(300, 310), (357, 360)], &[], &[(300, 360)]),
            ("200 ms apart", &[], &[(300, 310), (358, 360)], &[], &[(300, 310), (358, 360)]),
            (
                "a tail is not early",
                &[(100, 200), (206, 300)],
                &[(150, 200), (230, 240)],
                &[hit(50), hit(24)],
                &[],
            ),
            ("both ends of an episode", &[(0, 50), (950, 1000)], &[(0, 5)], &[hit(0), Missed], &[]),
            ("nothing", &[], &[], &[], &[]),
        ];
        for (what, slip, flags, detections, alarms) in cases {
            let event = |(&(onset, end), &detection)| EventScore { onset, end, detection };
            let events = slip.iter().zip(detections).map(event).collect();
            let expected = EventScores { events, false_alarms: alarms.to_vec() };
            assert_eq!(score_events(&track(SLIP, slip), &track(1, flags)), expected, "{what}");
        }
    }

    #[test]
    fn class_scores_by_hand() {
        // Truth 0 0 0 0 1 1 2 2, predicted 0 0 0 2 1 2 2 1.
        let s = ClassScores::new(&[0, 0, 0, 0, 1, 1, 2, 2], &[0, 0, 0, 2, 1, 2, 2, 1]);
        assert_eq!(s.confusion, [[3, 0, 1], [0, 1, 1], [0, 1, 1]]);
        assert_eq!(s.accuracy(), Some(5.0 / 8.0));
        assert_eq!(s.f1(0), Some(6.0 / 7.0));
        assert_eq!((s.precision(2), s.recall(2)), (Some(1.0 / 3.0), Some(0.5)));
        assert_eq!((s.precision(0), s.recall(0)), (Some(1.0), Some(0.75)));
        assert_eq!(s.f1(1), Some(0.5));
        assert_eq!(s.f1(2), Some(2.0 / 5.0));
        assert_eq!(s.macro_f1(), Some((6.0 / 7.0 + 0.5 + 0.4) / 3.0));
        assert_eq!(s.fpr_of_non_slip(), Some(2.0 / 6.0));
        assert_eq!(s.fpr_of_all(), Some(2.0 / 8.0));
        let mut twice = s;
        twice.add(&s);
        assert_eq!((twice.frames(), twice.accuracy()), (16, s.accuracy()));
    }

    #[test]
    fn a_class_that_never_occurs_has_no_f1() {
        let s = ClassScores::new(&[0, 1], &[0, 1]);
        assert_eq!((s.f1(2), s.macro_f1()), (None, Some(1.0)));
        assert_eq!(ClassScores::default().accuracy(), None);
    }
}
