//! What many trials say together.

use serde::Serialize;
use slipsense::params::FRAME_RATE_HZ;
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
        let mut values: Vec<f64> = values.collect();
        values.sort_by(f64::total_cmp);
        let last = values.len().checked_sub(1)?;
        let at = |share: f64| values[(share * last as f64).round() as usize];
        Some(Self { min_ms: at(0.0), median_ms: at(0.5), p90_ms: at(0.9), max_ms: at(1.0) })
    }
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
    /// Objects that are still held at the end.
    pub kept: usize,
    /// Objects that would be without any reaction.
    pub kept_without: usize,
    /// Trials with a motion before a slip was near.
    pub with_false_motion: usize,
    /// From slip to the tick of the frame that says so.
    pub delay: Option<Spread>,
    /// From that tick to the message at the controller.
    pub message: Option<Spread>,
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
        let slid = Spread::of(
            facts.iter().filter(|facts| facts.outcome.lost.is_none()).map(|facts| facts.outcome.slid_mm),
        );
        Self {
            trials: facts.len(),
            slips: count(&|facts| facts.outcome.onset.is_some()),
            detected: count(&Facts::is_detected),
            kept: count(&|facts| facts.outcome.lost.is_none()),
            kept_without: count(&|facts| facts.outcome.lost_without.is_none()),
            with_false_motion: count(&|facts| facts.outcome.false_motions > 0),
            delay: Spread::of(facts.iter().filter_map(|facts| facts.delay_ms)),
            message: ms(|outcome| outcome.message_s),
            peak: ms(|outcome| outcome.peak_s),
            slid_kept_mm: slid.map(|s| (s.median_ms, s.max_ms)),
        }
    }
}
