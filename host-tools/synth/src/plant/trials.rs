//! Trials of a re-grasp controller: objects, pulls and grips, from a seed.

use std::str::FromStr;
use std::sync::LazyLock;

use serde::{Deserialize, Serialize};

use super::Plant;
use crate::draw::{Draw, Rng, Stream, stream};
use crate::mix::ScenarioChoice;
use crate::objects::{self, Group, Object};
use crate::recipe::{ObjectChoice, Platform, Recipe, SynthError};
use crate::splits::hashed;

/// Grip of one finger before anything reacts, newtons.
const GRIP_N: (f64, f64) = (1.0, 4.0);
/// Strength of the pull over what the grip holds: above friction's spread, as the paper's operators pull until it slips.
const STRENGTH: (f64, f64) = (1.4, 2.0);
/// How far the pulls by hand stray from the direction they are meant to have, degrees.
const STRAY_DEG: f64 = 15.0;
/// Speeds of the pulls, mm/s; the paper has two and does not state them.
const SPEEDS_MM_S: [f64; 2] = [5.0, 15.0];
/// Directions in turn: up, down, oblique, sideways, and two twists.
const DIRECTIONS: [Direction; 10] = [
    Direction::Pull(0.0),
    Direction::Twist,
    Direction::Pull(45.0),
    Direction::Pull(180.0),
    Direction::Pull(-45.0),
    Direction::Pull(90.0),
    Direction::Twist,
    Direction::Pull(135.0),
    Direction::Pull(-90.0),
    Direction::Pull(-135.0),
];

/// The catalogue keeps nine objects from training; this is a tenth.
static TENTH: LazyLock<Object> =
    LazyLock::new(|| serde_json::from_str(include_str!("tenth_object.json")).expect("tenth_object.json"));

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Objects {
    /// Ten that training has never seen.
    Unseen,
    /// Those kept for choosing among models: on them the controller's parameters were chosen.
    Val,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Hand {
    /// Parallel jaw with two fingers, driven by a motor that vibrates like the hand-driven jaw.
    Umi,
    /// Motorised hand, two fingers.
    Tesollo2,
    /// The same with three.
    Tesollo3,
}

/// Way of a pull or twist.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Direction {
    /// In the pad's plane, degrees from the rig's direction, counter-clockwise.
    Pull(f64),
    /// About the pad's normal.
    Twist,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Trial {
    pub recipe: Recipe,
    pub object: String,
    /// Way of the pull, as meant.
    pub direction: Direction,
    /// Strength of the pulling hand, see [`Plant::new`].
    pub strength: f64,
    /// For what else is drawn of this trial.
    rng: Rng,
}

impl FromStr for Objects {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let known = [Self::Unseen, Self::Val].into_iter().find(|one| one.name() == name);
        known.ok_or_else(|| format!("\"{name}\" must be unseen or val"))
    }
}

impl FromStr for Hand {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let known = [Self::Umi, Self::Tesollo2, Self::Tesollo3].into_iter().find(|one| one.name() == name);
        known.ok_or_else(|| format!("\"{name}\" must be umi, tesollo2 or tesollo3"))
    }
}

impl Objects {
    pub const fn name(self) -> &'static str {
        match self {
            Self::Unseen => "unseen",
            Self::Val => "val",
        }
    }

    /// The objects, in the order of the catalogue.
    pub fn list(self) -> Vec<&'static Object> {
        match self {
            Self::Unseen => objects::of_group(Group::HeldOut).chain([&*TENTH]).collect(),
            Self::Val => objects::of_group(Group::Val).collect(),
        }
    }
}

impl Hand {
    pub const fn name(self) -> &'static str {
        match self {
            Self::Umi => "umi",
            Self::Tesollo2 => "tesollo2",
            Self::Tesollo3 => "tesollo3",
        }
    }

    const fn platform(self) -> Platform {
        match self {
            Self::Umi => Platform::Umi,
            Self::Tesollo2 | Self::Tesollo3 => Platform::Tesollo,
        }
    }

    /// Fingers, each with a sensor.
    pub const fn fingers(self) -> usize {
        match self {
            Self::Umi | Self::Tesollo2 => 2,
            Self::Tesollo3 => 3,
        }
    }
}

impl Trial {
    /// The gripper with its object before the first frame.
    pub fn plant(&self) -> Result<Plant, SynthError> {
        Plant::new(&self.recipe, self.strength)
    }

    /// A number of this trial's between two, for what is outside the plant: always the same one.
    pub fn draw_between(&self, low: f64, high: f64) -> f64 {
        self.rng.clone().between(low, high)
    }
}

/// The first `count` trials of a seed. Ten in a row have ten directions; objects take turns, so that of the ten
/// unseen ones each meets every direction once in 100 trials, half of them at either speed. Trials of other objects,
/// hands or seeds share no draws.
pub fn trials(objects: Objects, hand: Hand, seed: u64, count: usize) -> Vec<Trial> {
    let list = objects.list();
    (0..count)
        .map(|index| {
            let (place, round) = (index % list.len(), index / list.len());
            let object = list[place];
            let name = format!("slipsense/grasp/{}/{}/{seed}/{index}", objects.name(), hand.name());
            let seed = hashed(&name);
            let mut rng = stream(seed, Stream::Trial, 0);
            let direction = DIRECTIONS[(place + round) % DIRECTIONS.len()];
            let stray_deg = rng.between(-STRAY_DEG, STRAY_DEG);
            let (scenario, pull_angle_deg) = match direction {
                Direction::Twist => (ScenarioChoice::Rotation, None),
                Direction::Pull(deg) => (ScenarioChoice::FreePull, Some(within_circle(deg + stray_deg))),
            };
            let recipe = Recipe {
                object: match object.name == TENTH.name {
                    true => ObjectChoice::Own(Box::new(object.clone())),
                    false => ObjectChoice::Named(object.name.clone()),
                },
                scenario,
                platform: hand.platform(),
                sensors: hand.fingers(),
                speed_mm_s: Some(SPEEDS_MM_S[round % SPEEDS_MM_S.len()]),
                grip_n: Some(rng.log_uniform(GRIP_N)),
                pull_angle_deg,
                ..Recipe::new(seed)
            };
            let strength = rng.uniform(STRENGTH);
            Trial { recipe, object: object.name.clone(), direction, strength, rng }
        })
        .collect()
}

/// The same angle from -180 to 180.
fn within_circle(deg: f64) -> f64 {
    if deg > 180.0 { deg - 360.0 } else { deg }
}
