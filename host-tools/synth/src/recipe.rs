//! What to generate: a recipe is small, is stored in the episode it made, and makes it again.

use serde::{Deserialize, Serialize};
use slipsense::params::MAX_SENSORS;

use crate::draw::{Draw, Span, Stream, stream};
use crate::families::{FAMILIES, Families, Family, SourceFamily, Stage};
use crate::mix::{PROTOCOL, ScenarioChoice, scenario_at};
use crate::objects::{self, Group, Object, PAD_LENGTH_MM, PAD_WIDTH_MM, Shape};
use crate::scenario::levels::{GRIP_N, HAND_HELD_SLIPS};

/// The five crosshead speeds of the paper's protocol, mm/s.
pub const SPEEDS_MM_S: [f64; 5] = [2.0, 5.0, 10.0, 15.0, 18.0];

/// Shortest and longest episode, seconds: shorter ones cannot hold the six steps, longer ones are
/// several episodes. Ten minutes of two sensors take about 1 GiB while they are made.
pub const SECONDS: (f64, f64) = (2.5, 600.0);

/// Why a recipe cannot be generated: field, value and what it must be.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{0}")]
pub struct SynthError(pub(crate) String);

impl SynthError {
    pub(crate) fn new(rule: impl std::fmt::Display) -> Self {
        Self(format!("recipe: {rule}"))
    }
}

/// Every third recipe as it is, the others with an object like their own, but of another size, surface, friction, mode
/// and mass.
///
/// # Errors
/// What [`generate`](crate::generate) refuses.
pub fn vary_two_of_three(recipes: impl Iterator<Item = Recipe>) -> Result<Vec<Recipe>, SynthError> {
    let vary = |(index, recipe): (usize, Recipe)| {
        if index % 3 == 0 {
            return Ok(recipe);
        }
        let object = recipe.resolve()?.object.varied(recipe.seed);
        Ok(Recipe { object: ObjectChoice::Own(Box::new(object)), ..recipe })
    };
    recipes.enumerate().map(vary).collect()
}

/// One episode to generate. What is left open is drawn from the seed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recipe {
    pub seed: u64,
    #[serde(default)]
    pub object: ObjectChoice,
    #[serde(default)]
    pub scenario: ScenarioChoice,
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
    /// Age of the arrays, 0 to 12 months: they lose conductance. 0 to 4, drawn, when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub age_months: Option<f64>,
    /// The crosshead's drive reaches the accelerometers, as on a real rig.
    #[serde(default = "yes")]
    pub rig_leak: bool,
    /// Episodes of generator 2 and earlier name it `heard`.
    #[serde(alias = "heard", default)]
    pub vibration_content: VibrationContent,
    #[serde(default)]
    pub vibration: SourceFamily,
    /// Which families make everything else; the laboratory's when absent. With another than the laboratory's in any
    /// stage, arrays and accelerometers are units of this episode alone.
    #[serde(default, skip_serializing_if = "Families::is_laboratory")]
    pub families: Families,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Platform {
    /// Hand-held parallel jaw, one or two instrumented fingers.
    #[default]
    Umi,
    /// Motorised hand, two or three instrumented fingers.
    Tesollo,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Region {
    #[default]
    Centre,
    /// 8–12 mm towards the palm, where the pad is stiffer and the finger rings otherwise.
    Palm,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VibrationContent {
    #[default]
    All,
    /// The crosshead's drive and the parts' own noise: for the detector that shows whether the rig gives slip away.
    RigOnly,
    /// The parts' own noise, pads untouched: for the detector that shows whether idle noise gives slip away.
    IdleNoise,
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

/// Which object: any of a group of the catalogue (`"held_out"`), one by name (`{"named": "usb-cable"}`), or its own.
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
            age_months: None,
            rig_leak: true,
            vibration_content: VibrationContent::All,
            vibration: SourceFamily::Asperities,
            families: Families::default(),
        }
    }

    /// `count` recipes like this one, whose seeds follow from this one's and differ from each other.
    pub fn series(&self, count: usize) -> Vec<Self> {
        let mut rng = stream(self.seed, Stream::Recipe, 0);
        let seed = |rng: &mut crate::draw::Rng| rand::Rng::random::<u64>(rng) >> 11;
        (0..count).map(|_| Self { seed: seed(&mut rng), ..self.clone() }).collect()
    }

    /// This one in families that training may see, drawn from its seed.
    #[must_use]
    pub fn in_families(self) -> Self {
        let (families, vibration) = Families::draw(&mut stream(self.seed, Stream::Families, 0));
        Self { families, vibration, ..self }
    }

    /// This one with the held-out family of a stage.
    #[must_use]
    pub fn holding_out(self, stage: Stage) -> Self {
        self.with_family(stage, FAMILIES - 1)
    }

    /// This one with another family of a stage, by its place in [`Family::ALL`].
    #[must_use]
    pub fn with_family(mut self, stage: Stage, place: usize) -> Self {
        let families = &mut self.families;
        match stage {
            Stage::Contact => families.contact = Family::ALL[place],
            Stage::Friction => families.friction = Family::ALL[place],
            Stage::Film => families.film = Family::ALL[place],
            Stage::Source => self.vibration = Family::ALL[place],
            Stage::Path => families.path = Family::ALL[place],
            Stage::Disturbance => families.disturbance = Family::ALL[place],
            Stage::Sensor => families.sensor = Family::ALL[place],
        }
        self
    }

    /// Name of a stage's family, as recipes have it.
    pub fn family(&self, stage: Stage) -> String {
        let Families { contact, friction, film, path, disturbance, sensor } = self.families;
        let name = match stage {
            Stage::Contact => serde_json::to_value(contact),
            Stage::Friction => serde_json::to_value(friction),
            Stage::Film => serde_json::to_value(film),
            Stage::Source => serde_json::to_value(self.vibration),
            Stage::Path => serde_json::to_value(path),
            Stage::Disturbance => serde_json::to_value(disturbance),
            Stage::Sensor => serde_json::to_value(sensor),
        };
        let name = name.ok().and_then(|name| name.as_str().map(str::to_owned));
        name.expect("a family is written as its name")
    }

    /// Refuse what cannot be generated; the error names the field, its value and what it must be.
    pub fn check(&self) -> Result<(), SynthError> {
        let rule = |holds: bool, field: &str, value: f64, rule: &str| match holds {
            true => Ok(()),
            false => Err(SynthError::new(format!("{field} is {value}, {rule}"))),
        };
        let within = |field: &str, value: Option<f64>, (low, high): Span| {
            let holds = value.is_none_or(|x| (low..=high).contains(&x));
            rule(holds, field, value.unwrap_or_default(), &format!("must be {low} to {high}"))
        };
        let sensors = self.sensors;
        let most = if self.platform == Platform::Umi { 2 } else { 3 };
        rule((1..=MAX_SENSORS).contains(&sensors), "sensors", sensors as f64, "must be 1 to 3")?;
        let platform = format!("but platform {} has at most {most}", self.platform.name());
        rule(sensors <= most, "sensors", sensors as f64, &platform)?;
        within("seconds", self.seconds, SECONDS)?;
        let speed = self.speed_mm_s.unwrap_or(SPEEDS_MM_S[0]);
        rule(speed > 0.0 && speed <= 50.0, "speed_mm_s", speed, "must be above 0 and at most 50")?;
        within("noise", Some(self.noise), (0.0, 4.0))?;
        within("age_months", self.age_months, (0.0, 12.0))?;
        within("grip_n", self.grip_n, GRIP_N)?;
        if self.pull_angle_deg.is_some() && self.scenario != ScenarioChoice::FreePull {
            return Err(SynthError::new("pull_angle_deg is given, but only scenario free_pull takes one"));
        }
        within("pull_angle_deg", self.pull_angle_deg, (-180.0, 180.0))?;
        match &self.object {
            ObjectChoice::Named(name) => object_named(name).map(drop),
            ObjectChoice::Own(object) => {
                let taken = objects::named(&object.name).is_some_and(|known| *known != **object);
                if object.name.trim().is_empty() || taken {
                    return Err(SynthError::new(format!(
                        "object.own.name is \"{}\", must be a name that no other object of the catalogue has",
                        object.name
                    )));
                }
                object.check().map_err(SynthError::new)
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
            ScenarioChoice::Random => scenario_at(PROTOCOL, dice),
            named => named,
        };
        let speed_mm_s = self.speed_mm_s.unwrap_or(SPEEDS_MM_S[speed]);
        Ok(ResolvedRecipe { recipe: self.clone(), object, scenario, speed_mm_s, slips_at_end })
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
}

fn object_named(name: &str) -> Result<&'static Object, SynthError> {
    objects::named(name).ok_or_else(|| {
        let names: Vec<_> = objects::CATALOGUE.iter().map(|o| o.name.as_str()).collect();
        SynthError::new(format!("object \"{name}\" is not in the catalogue ({})", names.join(", ")))
    })
}

/// A recipe with nothing left open but the noise, the age, the length, the grip and the direction of the pull.
pub(crate) struct ResolvedRecipe {
    pub recipe: Recipe,
    pub object: &'static Object,
    pub scenario: ScenarioChoice,
    pub speed_mm_s: f64,
    /// Only hand-held recordings ask.
    pub slips_at_end: bool,
}

impl ResolvedRecipe {
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
