//! `entropy-and-mfcc`: slip where both of the paper's single-sensor baselines say slip.
//!
//! The score is the smaller of the two scores, each less its threshold and over its standard deviation on
//! train; above 0 exactly where both are above their thresholds.

use anyhow::Result;
use slipsense_recording::Episode;

use super::EntropyScore;
use super::mfcc_qda::MfccQdaScore;
use super::threshold::Score;
use crate::fit::{Cut, Fitted};

pub(super) struct AndScore {
    entropy: EntropyScore,
    entropy_cut: Cut,
    mfcc: MfccQdaScore,
    mfcc_cut: Cut,
}

impl AndScore {
    pub(super) fn new(fitted: &Fitted) -> Result<Self> {
        Ok(Self {
            entropy: EntropyScore::new(),
            entropy_cut: fitted.entropy,
            mfcc: MfccQdaScore::new(&fitted.mfcc)?,
            mfcc_cut: fitted.mfcc.cut,
        })
    }
}

/// Both scores as one, above 0 where both are above their thresholds.
fn both(a: f32, a_cut: Cut, b: f32, b_cut: Cut) -> f32 {
    ((a - a_cut.threshold) / a_cut.std).min((b - b_cut.threshold) / b_cut.std)
}

impl Score for AndScore {
    fn step(&mut self, episode: &Episode, frame: usize) -> f32 {
        let (entropy, mfcc) = (self.entropy.step(episode, frame), self.mfcc.step(episode, frame));
        both(entropy, self.entropy_cut, mfcc, self.mfcc_cut)
    }

    fn reset(&mut self) {
        self.entropy.reset();
        self.mfcc.reset();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn above_0_exactly_where_both_are_above_their_thresholds() {
        let (a, b) = (Cut { threshold: 1.5, std: 0.25 }, Cut { threshold: -3.0, std: 10.0 });
        for (x, y, slip) in [
            (1.6, -2.0, true),
            (1.5, -2.0, false),
            (1.6, -3.0, false),
            (1.4, 50.0, false),
            (9.0, -4.0, false),
        ] {
            let score = both(x, a, y, b);
            assert_eq!(score > 0.0, slip, "{x} {y}: {score}");
        }
        // (2 − 1.5) / 0.25 = 2 and (7 + 3) / 10 = 1.
        assert_eq!(both(2.0, a, 7.0, b), 1.0);
    }
}
