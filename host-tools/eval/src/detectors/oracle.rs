//! `oracle`, which sees true slip at the interface, and `oracle-label`, which sees the answer.
//!
//! The encoder's label begins with the crosshead's motion, the interface slips later, when pad, finger and
//! fixture have given way. The oracle's delay against the label is what no detector can be faster than
//! without guessing; the label's own verdict is the ceiling of every other figure.

use anyhow::{Context, Result};
use slipsense_recording::Episode;
use slipsense_recording::score::SLIP;

use super::{Detector, NEVER, Verdict, held_or_free, touched};

/// Interface speed above which it slips, mm/s.
const SPEED_MIN_MM_S: f32 = crate::truth::SLIDING_MM_S;
/// Share of the load above which all of the contact slips, not its rim alone.
const FRACTION_MIN: f32 = crate::truth::SLIDING_FRACTION;

pub(super) struct Oracle;

impl Detector for Oracle {
    fn name(&self) -> &'static str {
        "oracle"
    }

    /// The score is the slipping share of the load where the interface moves, else 0.
    fn judge(&mut self, episode: &Episode) -> Result<Verdict> {
        let missing = |array| format!("the oracle needs the simulator's truth, array {array}");
        let speed = episode.slip_true_mm_s.as_ref().with_context(|| missing("slip_true"))?;
        let fraction = episode.slip_fraction.as_ref().with_context(|| missing("slip_fraction"))?;
        let score = |frame: usize| match touched(episode, frame) {
            false => NEVER,
            true if speed[frame] > SPEED_MIN_MM_S => fraction[frame],
            true => 0.0,
        };
        let frames = 0..episode.frames();
        let fallback = frames.clone().map(|frame| held_or_free(episode, frame)).collect();
        Ok(Verdict::new(frames.map(score).collect(), FRACTION_MIN, fallback))
    }

    fn reset(&mut self) {}
}

pub(super) struct OracleLabel;

impl Detector for OracleLabel {
    fn name(&self) -> &'static str {
        "oracle-label"
    }

    /// Score 1 where the label says slip, else 0; threshold one half.
    fn judge(&mut self, episode: &Episode) -> Result<Verdict> {
        let label = episode.label.as_ref().context("array label is missing")?;
        let score = label.iter().map(|&class| f32::from(u8::from(class == SLIP))).collect();
        Ok(Verdict::new(score, 0.5, label.iter().map(|&class| class.min(1)).collect()))
    }

    fn reset(&mut self) {}
}
