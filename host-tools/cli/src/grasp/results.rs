//! Trials as rows, and their totals.

use serde::Serialize;
use slipsense::params::FRAME_RATE_HZ;
use slipsense_recording::score::MARGIN_FRAMES;
use slipsense_synth::plant::{Direction, Trial};

use super::trial::Outcome;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Failure {
    /// The flag did not come before the object was lost.
    NotDetected,
    ForceLimit,
    /// Detected, but the object was gone before the grip held it.
    TooLate,
}

impl Failure {
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

#[derive(Clone, Debug, Serialize)]
pub struct TrialResult {
    pub trial: usize,
    pub object: String,
    /// Way of the pull, as meant.
    pub direction: Direction,
    pub speed_mm_s: Option<f64>,
    /// From slip to the frame that says so, milliseconds; negative where it is said before.
    pub delay_ms: Option<f64>,
    pub failure: Option<Failure>,
    #[serde(flatten)]
    pub outcome: Outcome,
}

impl TrialResult {
    pub fn new(trial: usize, of: &Trial, outcome: Outcome) -> Self {
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

    /// There was a slip, and its flag came before the object was lost.
    pub fn is_detected(&self) -> bool {
        self.outcome.detected.is_some() && self.failure != Some(Failure::NotDetected)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spread {
    pub min_ms: f64,
    pub median_ms: f64,
    pub p90_ms: f64,
    pub max_ms: f64,
}

impl Spread {
    /// Of the values; `None` of none.
    pub fn new(values: impl Iterator<Item = f64>) -> Option<Self> {
        let [min_ms, median_ms, p90_ms, max_ms] = quantiles(values, [0.0, 0.5, 0.9, 1.0])?;
        Some(Self { min_ms, median_ms, p90_ms, max_ms })
    }
}

/// The values nearest to these shares of all; `None` of none.
fn quantiles<const N: usize>(values: impl Iterator<Item = f64>, shares: [f64; N]) -> Option<[f64; N]> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    let last = values.len().checked_sub(1)?;
    Some(shares.map(|share| values[(share * last as f64).round() as usize]))
}

#[derive(Clone, Copy, Debug, Serialize)]
pub struct Totals {
    pub trials: usize,
    /// Trials whose object slips, or would have slipped.
    pub slips: usize,
    /// Of these, slip was said before the object was lost.
    pub detected: usize,
    /// Of these, more than 50 ms before the whole contact would have slipped.
    pub early: usize,
    pub kept: usize,
    /// Objects that would be without any reaction.
    pub kept_without: usize,
    /// Trials with a motion before anything pulled, or where nothing was going to slip.
    pub with_false_motion: usize,
    /// From slip to the tick of the frame that says so.
    pub delay: Option<Spread>,
    pub message: Option<Spread>,
    pub first: Option<Spread>,
    pub peak: Option<Spread>,
    /// Way slid by the objects that were kept, mm: median and largest.
    pub slid_kept_mm: Option<(f64, f64)>,
}

impl Totals {
    pub fn new(results: &[TrialResult]) -> Self {
        let count = |of: &dyn Fn(&TrialResult) -> bool| results.iter().filter(|facts| of(facts)).count();
        let ms = |of: fn(&Outcome) -> Option<f64>| {
            Spread::new(results.iter().filter_map(|facts| of(&facts.outcome)).map(|s| s * 1e3))
        };
        let kept = results.iter().filter(|facts| facts.outcome.lost.is_none());
        let slid_mm = quantiles(kept.map(|facts| facts.outcome.slid_mm), [0.5, 1.0]);
        Self {
            trials: results.len(),
            slips: count(&|facts| facts.outcome.onset.is_some()),
            detected: count(&TrialResult::is_detected),
            early: count(&|facts| facts.delay_ms.is_some_and(|ms| ms < -EARLY_MS)),
            kept: count(&|facts| facts.outcome.lost.is_none()),
            kept_without: count(&|facts| facts.outcome.lost_without.is_none()),
            with_false_motion: count(&|facts| facts.outcome.false_motions > 0),
            delay: Spread::new(results.iter().filter_map(|facts| facts.delay_ms)),
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
    fn result(detected: Option<usize>, lost: Option<usize>, at_limit: bool) -> TrialResult {
        let outcome = Outcome {
            onset: Some(100),
            detected,
            lost,
            lost_without: Some(300),
            at_limit,
            ..Outcome::default()
        };
        TrialResult::new(0, &trials(Objects::Val, Hand::Umi, 1, 1)[0], outcome)
    }

    #[test]
    fn a_loss_has_one_reason() {
        let why = |facts: TrialResult| facts.failure;
        assert_eq!(why(result(Some(101), None, true)), None);
        assert_eq!(why(result(None, Some(300), false)), Some(Failure::NotDetected));
        // Said of what is gone already.
        assert_eq!(why(result(Some(310), Some(300), false)), Some(Failure::NotDetected));
        assert_eq!(why(result(Some(101), Some(300), true)), Some(Failure::ForceLimit));
        assert_eq!(why(result(Some(101), Some(300), false)), Some(Failure::TooLate));
    }

    #[test]
    fn totals_count_and_order() {
        let all = [
            result(Some(97), None, false),
            result(Some(124), None, false),
            result(Some(310), Some(300), false),
            result(None, Some(300), false),
        ];
        let totals = Totals::new(&all);
        assert_eq!((totals.slips, totals.detected, totals.kept, totals.kept_without), (4, 2, 2, 0));
        let delay = totals.delay.unwrap();
        assert_eq!(totals.early, 0);
        assert_eq!(Totals::new(&[result(Some(87), None, false)]).early, 1);
        assert!((delay.min_ms + 12.5).abs() < 1e-9 && (delay.median_ms - 100.0).abs() < 1e-9);
        assert_eq!(Spread::new(std::iter::empty()), None);
    }
}
