//! Disturbances on which operating points are chosen.

use super::schedule::{NOSLIP_SECONDS, ObjectSchedule, hashed};
use crate::mix::ScenarioChoice;
use crate::objects::Group;
use crate::recipe::Recipe;

/// Names and recipes of minutes without slip like those of [`Split::Noslip`](super::Split::Noslip), but of
/// validation objects on the hand-held gripper only, and with seeds that no split has: what is chosen on
/// them has seen nothing of a test. A longer list begins with the shorter one.
pub fn tuning_disturbances(episodes: usize) -> Vec<(String, Recipe)> {
    let objects = ObjectSchedule::shuffled(&[Group::Val], hashed("slipsense/tuning/order"));
    let recipe = |index: usize| Recipe {
        object: objects.object(index),
        scenario: ScenarioChoice::Disturbances,
        seconds: Some(NOSLIP_SECONDS),
        ..Recipe::new(hashed(&format!("slipsense/tuning/{index}")))
    };
    (0..episodes).map(|index| (format!("tuning-{index:05}"), recipe(index))).collect()
}
