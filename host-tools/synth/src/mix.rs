//! Which scenarios make a set, and how often each comes.

use crate::recipe::ScenarioChoice::{self, *};

/// Scenarios with their weights: how many recordings in a round are of each (not how much of the time).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mix(&'static [(ScenarioChoice, usize)]);

/// The paper's protocol on the rig: six steps, its three controls, and two more that it lacks (pulls on a
/// firm grip and a rig that moves for nothing), without which the sound of the rig alone tells slip. The
/// weights are set so that 57.6 % of the frames have no contact and 23.7 % slip, as in the paper, and so
/// that no contact stays the likeliest class at any time of a recording and whether or not the crosshead
/// moves. [`ScenarioChoice::Random`] draws from it, and the splits deal it in rounds.
pub const PROTOCOL: Mix =
    Mix(&[(SixStep, 80), (Empty, 6), (Unlinked, 4), (FreeGrasp, 3), (FirmGrip, 4), (RigMotion, 3)]);

/// Away from the rig: pulls by hand in all directions, twists about the pad's normal, and grasps that do not
/// slip. The split `free` deals it.
pub const FREE: Mix = Mix(&[(FreePull, 5), (Rotation, 4), (FreeGrasp, 1)]);

impl Mix {
    /// The scenarios and their weights.
    pub const fn weights(&self) -> &'static [(ScenarioChoice, usize)] {
        self.0
    }

    /// The scenario at position `x` of the cumulated weights, 0 to 1.
    pub fn at(&self, x: f64) -> ScenarioChoice {
        let total: usize = self.0.iter().map(|s| s.1).sum();
        let mut left = x * total as f64;
        for &(scenario, weight) in self.0 {
            left -= weight as f64;
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
    fn every_scenario_is_drawn_as_often_as_it_weighs() {
        for mix in [PROTOCOL, FREE] {
            let total: usize = mix.weights().iter().map(|s| s.1).sum();
            for &(scenario, weight) in mix.weights() {
                let drawn = (0..10_000).filter(|&i| mix.at(i as f64 / 1e4) == scenario).count();
                let share = weight as f64 / total as f64;
                println!("{scenario:?}: {drawn} of 10000, weight {share:.3}");
                assert!((drawn as f64 / 1e4 - share).abs() < 1e-3, "{scenario:?}: {drawn} of 10000");
            }
        }
    }
}
