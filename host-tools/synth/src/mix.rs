//! Which scenarios make a set, and how often each comes.

use crate::recipe::ScenarioChoice::{self, *};

/// Scenarios with their shares of the recordings (not of the time).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mix(&'static [(ScenarioChoice, f64)]);

/// The paper's protocol on the rig: six steps, its three controls, and two more that it lacks (pulls on a
/// firm grip and a rig that moves for nothing), without which the sound of the rig alone tells slip. The
/// shares are set so that 57.6 % of the frames have no contact and 23.7 % slip, as in the paper, and so
/// that no contact stays the likeliest class at any time of a recording and whether or not the crosshead
/// moves. [`ScenarioChoice::Random`] draws from it.
pub const PROTOCOL: Mix = Mix(&[
    (SixStep, 0.80),
    (Empty, 0.06),
    (Unlinked, 0.04),
    (FreeGrasp, 0.03),
    (FirmGrip, 0.04),
    (RigMotion, 0.03),
]);

/// Away from the rig: pulls by hand in any direction, twists, hand-held work.
pub const FREE: Mix = Mix(&[(FreePull, 0.4), (Rotation, 0.2), (HandHeld, 0.25), (FreeGrasp, 0.15)]);

/// Nothing slips, ever: for counting false alarms.
pub const WITHOUT_SLIP: Mix = Mix(&[(Disturbances, 1.0)]);

impl Mix {
    /// The scenarios and their shares, which sum to 1.
    pub const fn shares(&self) -> &'static [(ScenarioChoice, f64)] {
        self.0
    }

    /// The scenario at position `x` of the cumulated shares, 0 to 1.
    pub fn at(&self, x: f64) -> ScenarioChoice {
        let mut left = x;
        for &(scenario, share) in self.0 {
            left -= share;
            if left < 0.0 {
                return scenario;
            }
        }
        self.0[self.0.len() - 1].0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_sum_to_one_and_every_scenario_is_drawn() {
        for mix in [PROTOCOL, FREE, WITHOUT_SLIP] {
            let sum: f64 = mix.shares().iter().map(|s| s.1).sum();
            println!("sum of shares {sum}");
            assert!((sum - 1.0).abs() < 1e-9);
            for &(scenario, share) in mix.shares() {
                let drawn = (0..10_000).filter(|&i| mix.at(i as f64 / 1e4) == scenario).count();
                assert!((drawn as f64 / 1e4 - share).abs() < 1e-3, "{scenario:?}: {drawn} of 10000");
            }
        }
    }
}
