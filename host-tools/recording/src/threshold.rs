//! The lowest threshold of log-odds that keeps false alarms rare.

use std::collections::BTreeSet;

use slipsense::fixed::Logit;
use slipsense::net::format::OperatingPoint;

use crate::score::{Interval, MERGE_FRAMES, near};

/// Alarms made of single flagged frames, by the definition of [`crate::score`]: what is less
/// than 200 ms apart is one.
#[derive(Default)]
struct Alarms {
    flagged: BTreeSet<usize>,
    count: u64,
}

impl Alarms {
    fn flag(&mut self, frame: usize) {
        let before = self.flagged.range(..frame).next_back().copied();
        let after = self.flagged.range(frame..).next().copied();
        let one = |first: Option<usize>, second: Option<usize>| match (first, second) {
            (Some(first), Some(second)) => u64::from(second - (first + 1) < MERGE_FRAMES),
            _ => 0,
        };
        // Alone it is one more alarm; it may join the one before and the one after, which may be the same.
        let frame_itself = Some(frame);
        self.count += 1 + one(before, after);
        self.count -= one(before, frame_itself) + one(frame_itself, after);
        self.flagged.insert(frame);
    }
}

/// The lowest threshold such that neither it nor any higher one raises more than `allowed` false alarms.
/// Per episode: what is slip, and the score of each frame; `None` is below every threshold.
///
/// A lower threshold can raise fewer alarms than a higher one, as it joins several into one long alarm:
/// that does not make it quieter, so the search comes from above and stops at the first excess.
pub fn lowest_threshold(episodes: &[(&[Interval], Vec<Option<Logit>>)], allowed: u64) -> Logit {
    let mut frames: Vec<(Logit, usize)> = Vec::new();
    let mut start = 0;
    for (slip, scores) in episodes {
        let near = near(slip, scores.len());
        let countable = scores.iter().zip(near).enumerate().filter(|(_, (_, near))| !near);
        frames.extend(countable.filter_map(|(frame, (score, _))| Some(((*score)?, start + frame))));
        // Alarms of two episodes are two.
        start += scores.len() + MERGE_FRAMES;
    }
    frames.sort_unstable_by(|a, b| b.cmp(a));
    let mut alarms = Alarms::default();
    for equal in frames.chunk_by(|a, b| a.0 == b.0) {
        equal.iter().for_each(|&(_, frame)| alarms.flag(frame));
        if alarms.count > allowed {
            return equal[0].0;
        }
    }
    OperatingPoint::THRESHOLD_MIN
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::score::score_intervals;

    /// Counted by the definition, at every threshold from the highest score down.
    fn naive(episodes: &[(&[Interval], Vec<Option<Logit>>)], allowed: u64) -> i32 {
        let alarms = |threshold: i32| -> usize {
            let flags = |scores: &[Option<Logit>]| -> Vec<u8> {
                scores.iter().map(|s| s.is_some_and(|s| s.to_bits() > threshold).into()).collect()
            };
            episodes.iter().map(|(t, s)| score_intervals(t, &flags(s)).false_alarms.len()).sum()
        };
        let mut threshold = 40;
        while threshold > -40 && alarms(threshold - 1) as u64 <= allowed {
            threshold -= 1;
        }
        threshold
    }

    #[test]
    fn as_counted_by_the_definition() {
        use rand::{Rng, SeedableRng};
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(11);
        let (quiet, slips): (&[Interval], &[Interval]) = (&[], &[(500, 700), (1_500, 1_505)]);
        for _ in 0..40 {
            // Rises and falls, so that alarms have lengths and gaps.
            let mut level = 0i32;
            let mut scores = |frames: usize| -> Vec<Option<Logit>> {
                let mut walk = || {
                    level = (level + rng.random_range(-2..=2)).clamp(-30, 30);
                    rng.random_bool(0.9).then_some(Logit::from_bits(level))
                };
                (0..frames).map(|_| walk()).collect()
            };
            let episodes = [(quiet, scores(3_000)), (slips, scores(2_000)), (quiet, scores(3_000))];
            for allowed in [0, 1, 3, 10] {
                // Below the least score all thresholds are the same.
                let found = lowest_threshold(&episodes, allowed).to_bits().max(-31);
                assert_eq!(found, naive(&episodes, allowed).max(-31), "{allowed} allowed");
            }
        }
    }

    #[test]
    fn without_margins_the_threshold_is_the_lowest() {
        let (quiet, seven): (&[Interval], _) = (&[], Logit::from_bits(7));
        assert_eq!(lowest_threshold(&[(quiet, vec![None; 100])], 0), OperatingPoint::THRESHOLD_MIN);
        assert_eq!(lowest_threshold(&[(quiet, vec![Some(seven); 100])], 0), seven);
        assert_eq!(lowest_threshold(&[(quiet, vec![Some(seven); 100])], 1), OperatingPoint::THRESHOLD_MIN);
    }
}
