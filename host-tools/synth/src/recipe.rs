//! What to generate: a recipe is small, is stored in the episode it made, and makes it again.

use serde::{Deserialize, Serialize};
use slipsense::params::MAX_SENSORS;

use crate::SynthError;
use crate::draw::{Draw, Stream, stream};
use crate::mix;
use crate::objects::{self, Group, Object, PAD_LENGTH_MM, PAD_WIDTH_MM, Shape};
use crate::scenario::levels::{GRIP_N, HAND_HELD_SLIPS};

/// The five crosshead speeds of the paper's protocol, mm/s.
pub const SPEEDS_MM_S: [f64; 5] = [2.0, 5.0, 10.0, 15.0, 18.0];

/// Shortest and longest episode, seconds: shorter ones cannot hold the six steps, longer ones are
/// several episodes. Ten minutes of two sensors take about 1 GiB while they are made.
pub const SECONDS: std::ops::RangeInclusive<f64> = 2.5..=600.0;

/// One episode to generate. What is left open is drawn from the seed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recipe {
    /// Seed of every draw.
    pub seed: u64,
    /// Which object is gripped.
    #[serde(default)]
    pub object: ObjectChoice,
    /// What happens.
    #[serde(default)]
    pub scenario: ScenarioChoice,
    /// Which hand holds it.
    #[serde(default)]
    pub platform: Platform,
    /// Where on the finger the object lies.
    #[serde(default)]
    pub region: Region,
    /// Instrumented fingers: 1 or 2 of a UMI, 1 to 3 of a Tesollo.
    #[serde(default = "two")]
    pub sensors: usize,
    /// Length of the episode; drawn when absent (4 to 40 s, most about 12 s; disturbances 20 to 60 s). A
    /// length holds as many passes of the scenario as it has room for, and shortens a single one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seconds: Option<f64>,
    /// Crosshead speed, above 0 to 50 mm/s; one of [`SPEEDS_MM_S`] when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub speed_mm_s: Option<f64>,
    /// Grip force of one finger in every grasp, before the operator changes it, 0.3 to 12 N; drawn for each
    /// grasp when absent. Drawn grips are kept weak enough for the object to slip where it is to slip; a
    /// named one is kept, and what pulls or twists is as stiff as the slip needs (by hand, a firm and sticky
    /// grip may still give way by jerks that are too short to be labelled slip).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub grip_n: Option<f64>,
    /// Direction of a pull by hand in the pad's plane, -180 to 180 degrees from the direction in which the rig
    /// pulls, counter-clockwise on the first finger; drawn when absent. Only `free_pull` takes one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pull_angle_deg: Option<f64>,
    /// Factor on the electrical noise of arrays and accelerometers, 0 to 4.
    #[serde(default = "one")]
    pub noise: f64,
    /// The crosshead's drive is heard by the accelerometers, as on a real rig.
    #[serde(default = "yes")]
    pub rig_leak: bool,
    /// What reaches the accelerometers.
    #[serde(rename = "heard", default)]
    pub vibration_content: VibrationContent,
    /// Which model makes the slip vibration.
    #[serde(default)]
    pub vibration: VibrationModel,
}

/// The hand.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Platform {
    /// Hand-held parallel jaw, one or two instrumented fingers.
    #[default]
    Umi,
    /// Motorised hand, two or three instrumented fingers.
    Tesollo,
}

/// Where on the finger the object lies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Region {
    /// The middle of the pad.
    #[default]
    Centre,
    /// 8–12 mm towards the palm, where the pad is stiffer and the finger rings otherwise.
    Palm,
}

/// What reaches the accelerometers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VibrationContent {
    /// Everything.
    #[default]
    All,
    /// The crosshead's drive and the parts' own noise, nothing else: for the detector that shows
    /// whether the rig gives slip away.
    RigOnly,
}

/// Which model makes the slip vibration.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VibrationModel {
    /// Asperities, texture lines and stick-slip pulses through the finger's modes.
    #[default]
    Modal,
    /// Autoregressive noise whose coefficients depend on speed and force; coded independently, for
    /// tests only.
    Autoregressive,
}

const fn two() -> usize {
    2
}

const fn one() -> f64 {
    1.0
}

const fn yes() -> bool {
    true
}

/// Which object: one of a group of the catalogue (`"held_out"`), a certain one (`{"named": "usb-cable"}`),
/// or one that the recipe brings.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ObjectChoice {
    /// Any that models are trained on.
    #[default]
    Train,
    /// Any of those kept apart for choosing among trained models.
    Val,
    /// Any of the group that training must never see.
    HeldOut,
    /// This one of the catalogue.
    Named(String),
    /// This one, with all the fields of the catalogue's, checked by [`Object::check`]:
    /// `{"own": {"name": "my-rod", "kind": "tool", "group": "train", "shape": {"cylinder": ...}, ...}}`.
    /// Its name must not be that of another object of the catalogue.
    Own(Box<Object>),
}

/// Which course of events to draw.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ScenarioChoice {
    /// One of the scenarios on the rig and its controls, by the shares of [`mix::PROTOCOL`].
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
    /// Nothing but disturbances, with grasps held and released. No slip.
    Disturbances,
}

impl ScenarioChoice {
    /// The gripper stands in its fixture at the rig; a hand or an arm carries it in the others.
    pub(crate) fn on_rig(self) -> bool {
        matches!(self, Self::SixStep | Self::Empty | Self::Unlinked | Self::FirmGrip | Self::RigMotion)
    }
}

impl Recipe {
    /// An episode with two sensors in which everything but the seed is drawn, of a training object.
    pub fn new(seed: u64) -> Self {
        Self {
            seed,
            object: ObjectChoice::Train,
            scenario: ScenarioChoice::Random,
            platform: Platform::Umi,
            region: Region::Centre,
            sensors: 2,
            seconds: None,
            speed_mm_s: None,
            grip_n: None,
            pull_angle_deg: None,
            noise: 1.0,
            rig_leak: true,
            vibration_content: VibrationContent::All,
            vibration: VibrationModel::Modal,
        }
    }

    /// `count` recipes like this one, whose seeds follow from this one's and differ from each other.
    pub fn series(&self, count: usize) -> Vec<Self> {
        let mut rng = stream(self.seed, Stream::Recipe, 0);
        let seed = |rng: &mut crate::draw::Rng| rand::Rng::random::<u64>(rng) >> 11;
        (0..count).map(|_| Self { seed: seed(&mut rng), ..self.clone() }).collect()
    }

    /// Refuse what cannot be generated.
    pub fn check(&self) -> Result<(), SynthError> {
        if self.sensors == 0 || self.sensors > MAX_SENSORS {
            return Err(SynthError::Sensors(self.sensors));
        }
        if self.sensors > self.platform.most_sensors() {
            return Err(SynthError::PlatformSensors {
                platform: self.platform.name(),
                sensors: self.sensors,
                most: self.platform.most_sensors(),
            });
        }
        if let Some(seconds) = self.seconds.filter(|s| !SECONDS.contains(s)) {
            return Err(SynthError::Seconds(seconds));
        }
        if let Some(speed) = self.speed_mm_s.filter(|v| !(*v > 0.0 && *v <= 50.0)) {
            return Err(SynthError::Speed(speed));
        }
        if !(0.0..=4.0).contains(&self.noise) {
            return Err(SynthError::Noise(self.noise));
        }
        if let Some(grip) = self.grip_n.filter(|n| !(GRIP_N.0..=GRIP_N.1).contains(n)) {
            return Err(SynthError::Grip(grip));
        }
        if let Some(angle) = self.pull_angle_deg {
            if self.scenario != ScenarioChoice::FreePull {
                return Err(SynthError::PullAngleScenario);
            }
            if !(-180.0..=180.0).contains(&angle) {
                return Err(SynthError::PullAngle(angle));
            }
        }
        match &self.object {
            ObjectChoice::Named(name) => object_named(name).map(drop),
            ObjectChoice::Own(object) => {
                let taken = objects::named(&object.name).is_some_and(|known| *known != **object);
                if object.name.trim().is_empty() || taken {
                    return Err(SynthError::OwnName(object.name.clone()));
                }
                Ok(object.check()?)
            }
            ObjectChoice::Train | ObjectChoice::Val | ObjectChoice::HeldOut => Ok(()),
        }
    }

    /// Refuse what cannot be generated, and draw what was left open.
    pub(crate) fn resolve(&self) -> Result<ResolvedRecipe, SynthError> {
        self.check()?;
        // Fixed number of draws in fixed order: naming one thing does not change the others.
        let mut rng = stream(self.seed, Stream::Grasp, 0);
        let (pick, dice, speed) = (rng.between(0.0, 1.0), rng.between(0.0, 1.0), rng.count(0, 4));
        let slips_at_end = rng.chance(HAND_HELD_SLIPS);
        let any_of = |group| {
            let objects: Vec<_> = objects::of_group(group).collect();
            objects[(pick * objects.len() as f64) as usize % objects.len()]
        };
        let object = match &self.object {
            ObjectChoice::Train => any_of(Group::Train),
            ObjectChoice::Val => any_of(Group::Val),
            ObjectChoice::HeldOut => any_of(Group::HeldOut),
            ObjectChoice::Named(name) => object_named(name)?,
            ObjectChoice::Own(object) => objects::keep(object),
        };
        let scenario = match self.scenario {
            ScenarioChoice::Random => mix::PROTOCOL.at(dice),
            named => named,
        };
        let speed_mm_s = self.speed_mm_s.unwrap_or(SPEEDS_MM_S[speed]);
        let (platform, region, seconds) = (self.platform, self.region, self.seconds);
        let (grip_n, pull_angle_deg) = (self.grip_n, self.pull_angle_deg);
        Ok(ResolvedRecipe {
            object,
            scenario,
            speed_mm_s,
            grip_n,
            pull_angle_deg,
            platform,
            region,
            seconds,
            slips_at_end,
        })
    }
}

impl Platform {
    /// Name, as in recipes and in the metadata of episodes.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Umi => "umi",
            Self::Tesollo => "tesollo",
        }
    }

    /// Fingers that may be instrumented.
    pub const fn most_sensors(self) -> usize {
        match self {
            Self::Umi => 2,
            Self::Tesollo => 3,
        }
    }
}

fn object_named(name: &str) -> Result<&'static Object, SynthError> {
    objects::named(name).ok_or_else(|| {
        let names: Vec<_> = objects::CATALOGUE.iter().map(|o| o.name.as_str()).collect();
        SynthError::Object(name.to_owned(), names.join(", "))
    })
}

/// A recipe with nothing left open but the noise, the length, the grip and the direction of the pull.
pub(crate) struct ResolvedRecipe {
    pub object: &'static Object,
    pub scenario: ScenarioChoice,
    pub speed_mm_s: f64,
    pub grip_n: Option<f64>,
    /// None where it is drawn, as all draws of the scenario are.
    pub pull_angle_deg: Option<f64>,
    pub platform: Platform,
    pub region: Region,
    pub seconds: Option<f64>,
    /// Only hand-held recordings ask.
    pub slips_at_end: bool,
}

impl ResolvedRecipe {
    /// The object slips in this scenario.
    pub(crate) fn slips(&self) -> bool {
        match self.scenario {
            ScenarioChoice::SixStep | ScenarioChoice::FreePull | ScenarioChoice::Rotation => true,
            ScenarioChoice::HandHeld => self.slips_at_end,
            _ => false,
        }
    }

    /// Mean distance of the patch's points from its centre, mm: a twist has the recipe's speed there. A
    /// line's is a quarter of its length, a rectangle's about the same share of its diagonal.
    pub(crate) fn twist_radius_mm(&self) -> f64 {
        match self.object.shape {
            Shape::Sphere { .. } => 2.0,
            Shape::Cylinder { length_mm, .. } => length_mm.min(PAD_LENGTH_MM) / 4.0,
            Shape::Flat { width_mm, length_mm, .. } => {
                let (w, l) = (width_mm.min(PAD_WIDTH_MM), length_mm.min(PAD_LENGTH_MM));
                0.26 * (w * w + l * l).sqrt()
            }
        }
    }

    /// Crosshead or hand moves at the recipe's speed while the jaws are closed.
    pub(crate) fn pulls(&self) -> bool {
        self.slips() || self.scenario.on_rig()
    }
}
