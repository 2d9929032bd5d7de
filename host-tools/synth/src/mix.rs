//! The scenarios, and how often each comes in a set.

use ScenarioChoice::*;
use serde::{Deserialize, Serialize};

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ScenarioChoice {
    /// One of the scenarios on the rig and its controls, by the shares of the protocol below.
    #[default]
    Random,
    /// The crosshead comes down and holds, the gripper closes, the operator varies the grip, the crosshead
    /// goes up and the object slips, stops, the gripper opens.
    SixStep,
    /// The same with nothing in the gripper.
    Empty,
    /// The same with an object that is not linked to the crosshead.
    Unlinked,
    /// Hand-held grasps without slip: lift, carry, knocks, drag over a table, set down, release.
    FreeGrasp,
    /// The crosshead pulls a firmly gripped object and the gripper's mount gives way: no slip.
    FirmGrip,
    /// The crosshead moves in any phase and pulls nothing: the cable is slack. No slip.
    RigMotion,
    /// A hand pulls the object in any direction of the pad's plane at a wavering speed until it slips.
    FreePull,
    /// A hand twists the object until it turns in the grip.
    Rotation,
    /// The gripper is carried about with the object: motion, steps, knocks; two in five end in slip.
    HandHeld,
    /// The gripper is carried about with nothing in it; the jaws close on nothing.
    CarriedEmpty,
    /// Nothing but disturbances, with grasps held and released. No slip.
    Disturbances,
}

impl ScenarioChoice {
    /// The gripper stands in its fixture at the rig; a hand or an arm carries it in the others.
    pub(crate) fn on_rig(self) -> bool {
        matches!(self, Self::SixStep | Self::Empty | Self::Unlinked | Self::FirmGrip | Self::RigMotion)
    }

    /// The jaws close on nothing.
    pub(crate) fn empty(self) -> bool {
        matches!(self, Self::Empty | Self::CarriedEmpty)
    }
}

/// Scenarios with their weights: how many recordings in a round are of each (not how much of the time).
pub(crate) type Mix = &'static [(ScenarioChoice, usize)];

/// The paper's protocol on the rig: six steps, its three controls, and two more that it lacks (pulls on a
/// firm grip and a rig that moves for nothing), without which the rig's vibration alone would predict slip. The
/// weights are set so that 57.6 % of the frames have no contact and 23.7 % slip, as in the paper, and so
/// that no contact stays the likeliest class at any time of a recording and whether or not the crosshead
/// moves. [`ScenarioChoice::Random`] draws from it, and the splits take turns through it.
pub(crate) const PROTOCOL: Mix =
    &[(SixStep, 80), (Empty, 6), (Unlinked, 4), (FreeGrasp, 3), (FirmGrip, 4), (RigMotion, 3)];

/// Away from the rig: pulls by hand, twists about the pad's normal, grasps without slip. Of the split `free`.
pub(crate) const FREE: Mix = &[(FreePull, 5), (Rotation, 4), (FreeGrasp, 1)];

/// Everything that a hand, an arm or a rig does with an object: for families of physics beside the laboratory's.
/// Empty jaws at the rig and carried about are as many as it takes for no contact to be the likeliest class whether
/// or not the crosshead moves; without them a still crosshead would mean a hand, and a hand an object.
pub(crate) const ANYWHERE: Mix = &[
    (SixStep, 5),
    (Empty, 3),
    (FreePull, 6),
    (Rotation, 4),
    (HandHeld, 2),
    (CarriedEmpty, 4),
    (FirmGrip, 1),
    (Unlinked, 1),
    (RigMotion, 1),
];

/// The scenario at position `x` of the cumulated weights, 0 to 1.
pub(crate) fn scenario_at(mix: Mix, x: f64) -> ScenarioChoice {
    let total: usize = mix.iter().map(|s| s.1).sum();
    let mut left = x * total as f64;
    for &(scenario, weight) in mix {
        left -= weight as f64;
        if left < 0.0 {
            return scenario;
        }
    }
    mix[mix.len() - 1].0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_scenario_is_drawn_as_often_as_it_weighs() {
        for mix in [PROTOCOL, FREE, ANYWHERE] {
            let total: usize = mix.iter().map(|s| s.1).sum();
            for &(scenario, weight) in mix {
                let drawn = (0..10_000).filter(|&i| scenario_at(mix, i as f64 / 1e4) == scenario).count();
                let share = weight as f64 / total as f64;
                assert!((drawn as f64 / 1e4 - share).abs() < 1e-3, "{scenario:?}: {drawn} of 10000");
            }
        }
    }
}
