//! What many trials say together.

use serde::Serialize;
use slipsense::params::FRAME_RATE_HZ;
use slipsense_recording::score::MARGIN_FRAMES;
use slipsense_synth::plant::{Direction, Trial};

use super::trial::Outcome;

/// Why an object was lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Failure {
    /// The flag did not come before the object was lost.
    NotDetected,
    /// The gripper has no more force.
    ForceLimit,
    /// Detected, but the object was gone before the grip held it.
    TooLate,
}

impl Failure {
    /// In words.
    pub const fn words(self) -> &'static str {
        match self {
            Self::NotDetected => "not detected before it was lost",
            Self::ForceLimit => "the gripper was at its largest force",
            Self::TooLate => "detected, but lost before the grip held it",
        }
    }
}

/// A flag that comes this long before the slip of the whole contact, or later, is on time.
const EARLY_MS: f64 = MARGIN_FRAMES as f64 * 1e3 / FRAME_RATE_HZ as f64;

/// One trial for tables and machines.
#[derive(Clone, Debug, Serialize)]
pub struct Facts {
    /// Number of the trial.
    pub trial: usize,
    /// The object.
    pub object: String,
    /// Way of the pull, as meant.
    pub direction: Direction,
    /// Speed of the pull, mm/s.
    pub speed_mm_s: Option<f64>,
    /// From slip to the frame that says so, milliseconds; negative where it is said before.
    pub delay_ms: Option<f64>,
    /// Why the object was lost.
    pub failure: Option<Failure>,
    /// What became of it.
    #[serde(flatten)]
    pub outcome: Outcome,
}

impl Facts {
    /// Of trial number `trial`.
    pub fn of(trial: usize, of: &Trial, outcome: Outcome) -> Self {
        let ms = 1e3 / f64::from(FRAME_RATE_HZ);
        let delay_ms = outcome.onset.zip(outcome.detected).map(|(o, d)| (d as f64 - o as f64) * ms);
        let found = outcome.detected.is_some_and(|d| outcome.lost.is_none_or(|lost| d < lost));
        let failure = outcome.lost.map(|_| match () {
            () if !found => Failure::NotDetected,
            () if outcome.at_limit => Failure::ForceLimit,
            () => Failure::TooLate,
        });
        let (object, direction, speed_mm_s) = (of.object.clone(), of.direction, of.recipe.speed_mm_s);
        Self { trial, object, direction, speed_mm_s, delay_ms, failure, outcome }
    }

    /// Slip would have come, and its flag came before the object was lost.
    pub fn is_detected(&self) -> bool {
        self.outcome.detected.is_some() && self.failure != Some(Failure::NotDetected)
    }
}

/// Quantiles of a time, milliseconds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spread {
    /// Smallest.
    pub min_ms: f64,
    /// Half are smaller.
    pub median_ms: f64,
    /// Nine in ten are smaller.
    pub p90_ms: f64,
    /// Largest.
    pub max_ms: f64,
}

impl Spread {
    /// Of the values there are; none of none.
    pub fn of(values: impl Iterator<Item = f64>) -> Option<Self> {
        let [min_ms, median_ms, p90_ms, max_ms] = quantiles(values, [0.0, 0.5, 0.9, 1.0])?;
        Some(Self { min_ms, median_ms, p90_ms, max_ms })
    }
}

/// The values nearest to these shares of all; none of none.
fn quantiles<const N: usize>(values: impl Iterator<Item = f64>, shares: [f64; N]) -> Option<[f64; N]> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    let last = values.len().checked_sub(1)?;
    Some(shares.map(|share| values[(share * last as f64).round() as usize]))
}

/// Counts and times over trials.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Totals {
    /// Trials.
    pub trials: usize,
    /// Trials whose object slips, or would have slipped.
    pub slips: usize,
    /// Of these, slip was said before the object was lost.
    pub detected: usize,
    /// Of these, more than 50 ms before the whole contact would have slipped.
    pub early: usize,
    /// Objects that are still held at the end.
    pub kept: usize,
    /// Objects that would be without any reaction.
    pub kept_without: usize,
    /// Trials with a motion before anything pulled, or where nothing was going to slip.
    pub with_false_motion: usize,
    /// From slip to the tick of the frame that says so.
    pub delay: Option<Spread>,
    /// From that tick to the message at the controller.
    pub message: Option<Spread>,
    /// From that tick to the force of the first motion.
    pub first: Option<Spread>,
    /// From that tick to the largest grip.
    pub peak: Option<Spread>,
    /// Way slid by the objects that were kept, mm: median and largest.
    pub slid_kept_mm: Option<(f64, f64)>,
}

impl Totals {
    /// Of these trials.
    pub fn of(facts: &[Facts]) -> Self {
        let count = |of: &dyn Fn(&Facts) -> bool| facts.iter().filter(|facts| of(facts)).count();
        let ms = |of: fn(&Outcome) -> Option<f64>| {
            Spread::of(facts.iter().filter_map(|facts| of(&facts.outcome)).map(|s| s * 1e3))
        };
        let kept = facts.iter().filter(|facts| facts.outcome.lost.is_none());
        let slid_mm = quantiles(kept.map(|facts| facts.outcome.slid_mm), [0.5, 1.0]);
        Self {
            trials: facts.len(),
            slips: count(&|facts| facts.outcome.onset.is_some()),
            detected: count(&Facts::is_detected),
            early: count(&|facts| facts.delay_ms.is_some_and(|ms| ms < -EARLY_MS)),
            kept: count(&|facts| facts.outcome.lost.is_none()),
            kept_without: count(&|facts| facts.outcome.lost_without.is_none()),
            with_false_motion: count(&|facts| facts.outcome.false_motions > 0),
            delay: Spread::of(facts.iter().filter_map(|facts| facts.delay_ms)),
            message: ms(|outcome| outcome.message_s),
            first: ms(|outcome| outcome.first_s),
            peak: ms(|outcome| outcome.peak_s),
            slid_kept_mm: slid_mm.map(|[median, most]| (median, most)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use slipsense_synth::plant::{Hand, Objects, trials};

    /// Slips at frame 100, said at `detected`, lost at `lost`.
    fn facts(detected: Option<usize>, lost: Option<usize>, at_limit: bool) -> Facts {
        let outcome = Outcome {
            onset: Some(100),
            detected,
            lost,
            lost_without: Some(300),
            false_motions: 0,
            motions: 1,
            message_s: detected.map(|_| 0.002),
            first_s: detected.map(|_| 0.03),
            peak_s: detected.map(|_| 0.04),
            grip_n: (2.0, 4.0),
            at_limit,
            slid_mm: 1.0,
            slid_without_mm: 14.0,
            actuator_ms: 30.0,
        };
        Facts::of(0, &trials(Objects::Val, Hand::Umi, 1, 1)[0], outcome)
    }

    #[test]
    fn a_loss_has_one_reason() {
        let why = |facts: Facts| facts.failure;
        assert_eq!(why(facts(Some(101), None, true)), None);
        assert_eq!(why(facts(None, Some(300), false)), Some(Failure::NotDetected));
        // Said of what is gone already.
        assert_eq!(why(facts(Some(310), Some(300), false)), Some(Failure::NotDetected));
        assert_eq!(why(facts(Some(101), Some(300), true)), Some(Failure::ForceLimit));
        assert_eq!(why(facts(Some(101), Some(300), false)), Some(Failure::TooLate));
    }

    #[test]
    fn totals_count_and_order() {
        let all = [
            facts(Some(97), None, false),
            facts(Some(124), None, false),
            facts(Some(310), Some(300), false),
            facts(None, Some(300), false),
        ];
        let totals = Totals::of(&all);
        assert_eq!((totals.slips, totals.detected, totals.kept, totals.kept_without), (4, 2, 2, 0));
        let delay = totals.delay.unwrap();
        assert_eq!(totals.early, 0);
        assert_eq!(Totals::of(&[facts(Some(87), None, false)]).early, 1);
        assert!((delay.min_ms + 12.5).abs() < 1e-9 && (delay.median_ms - 100.0).abs() < 1e-9);
        assert_eq!(Spread::of(std::iter::empty()), None);
    }
}
