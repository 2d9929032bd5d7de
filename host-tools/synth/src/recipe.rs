//! What to generate: a recipe is small, is stored in the episode it made, and makes it again.

use serde::{Deserialize, Serialize};
use slipsense::params::MAX_SENSORS;

use crate::SynthError;
use crate::draw::{Draw, Stream, stream};
use crate::objects::{self, Object};

/// The five crosshead speeds of the paper's protocol, mm/s.
pub const SPEEDS_MM_S: [f64; 5] = [2.0, 5.0, 10.0, 15.0, 18.0];

/// Shortest and longest episode, seconds: shorter ones cannot hold the six steps, longer ones are
/// several episodes.
pub const SECONDS: std::ops::RangeInclusive<f64> = 2.5..=120.0;

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
    /// Sensors of the gripper, 1 to 3.
    #[serde(default = "two")]
    pub sensors: usize,
    /// Length of the episode; drawn (about 5 to 9 s) when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seconds: Option<f64>,
    /// Crosshead speed, above 0 to 50 mm/s; one of [`SPEEDS_MM_S`] when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub speed_mm_s: Option<f64>,
    /// Factor on the electrical noise of arrays and accelerometers, 0 to 4.
    #[serde(default = "one")]
    pub noise: f64,
    /// The crosshead's drive is heard by the accelerometers, as on a real rig.
    #[serde(default = "yes")]
    pub rig_leak: bool,
    /// What reaches the accelerometers.
    #[serde(default)]
    pub heard: Heard,
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
pub enum Heard {
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

/// Which object of the catalogue.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ObjectChoice {
    /// Any that training may see.
    #[default]
    Train,
    /// Any of the group that training must never see.
    HeldOut,
    /// This one.
    Named(String),
}

/// Which course of events to draw.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ScenarioChoice {
    /// One of the others, seven in ten of them [`ScenarioChoice::SixStep`].
    #[default]
    Random,
    /// Hold, close, vary the grip, crosshead moves and the object slips, stop, open.
    SixStep,
    /// The crosshead moves and the gripper opens and closes on nothing.
    Empty,
    /// The gripper holds an object that is not linked to the moving crosshead.
    Unlinked,
    /// The crosshead pulls a firmly gripped object and the gripper's mount gives way: no slip.
    FirmGrip,
    /// Hand-held grasps: lift, carry, knocks, drag over a table, set down, release.
    FreeGrasp,
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
            noise: 1.0,
            rig_leak: true,
            heard: Heard::All,
            vibration: VibrationModel::Modal,
        }
    }

    /// `count` recipes like this one, whose seeds follow from this one's and differ from each other.
    pub fn series(&self, count: usize) -> Vec<Self> {
        let mut rng = stream(self.seed, Stream::Recipe, 0);
        let seed = |rng: &mut crate::draw::Rng| rand::Rng::random::<u64>(rng) >> 11;
        (0..count).map(|_| Self { seed: seed(&mut rng), ..self.clone() }).collect()
    }

    /// Refuse what cannot be generated, and draw what was left open.
    pub(crate) fn resolve(&self) -> Result<Resolved, SynthError> {
        if self.sensors == 0 || self.sensors > MAX_SENSORS {
            return Err(SynthError::Sensors(self.sensors));
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
        // Fixed number of draws in fixed order: naming one thing does not change the others.
        let mut rng = stream(self.seed, Stream::Grasp, 0);
        let (pick, dice, speed) = (rng.between(0.0, 1.0), rng.between(0.0, 1.0), rng.count(0, 4));
        let object = match &self.object {
            ObjectChoice::Named(name) => objects::named(name).ok_or_else(|| {
                SynthError::Object(
                    name.clone(),
                    objects::CATALOGUE.iter().map(|o| o.name).collect::<Vec<_>>().join(", "),
                )
            })?,
            group => {
                let group: Vec<_> = objects::group(*group == ObjectChoice::HeldOut).collect();
                group[(pick * group.len() as f64) as usize % group.len()]
            }
        };
        let scenario = match self.scenario {
            ScenarioChoice::Random => match dice {
                d if d < 0.72 => ScenarioChoice::SixStep,
                d if d < 0.77 => ScenarioChoice::Empty,
                d if d < 0.83 => ScenarioChoice::Unlinked,
                d if d < 0.90 => ScenarioChoice::FirmGrip,
                _ => ScenarioChoice::FreeGrasp,
            },
            named => named,
        };
        let speed_mm_s = self.speed_mm_s.unwrap_or(SPEEDS_MM_S[speed]);
        Ok(Resolved { object, scenario, speed_mm_s })
    }
}

/// A recipe with nothing left open but the noise.
pub(crate) struct Resolved {
    pub object: &'static Object,
    pub scenario: ScenarioChoice,
    pub speed_mm_s: f64,
}
