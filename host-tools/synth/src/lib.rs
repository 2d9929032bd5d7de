//! Generator of labelled synthetic episodes.
//!
//! A [`Recipe`] names a seed and what may be left to it; [`generate`] makes the episode: scenario →
//! contact and partial slip → taxel film and finger vibration → counts and samples → labels. What it
//! makes is synthetic, says so in its metadata, and carries no claim about a real gripper.
//!
//! The same recipe gives the same episode to the bit. It is meant to do so on every platform, though it
//! has been checked on x86-64 Linux only: the draws are ChaCha's, and sines and powers come from the
//! `libm` crate, because the standard library's differ in their last bit from platform to platform,
//! which can move a count or a sample by one (`clippy.toml` keeps them out).

mod accelerometer;
mod draw;
mod friction;
mod recipe;
mod scenario;
mod timeline;
mod unit;
mod vibration;
pub mod contact;
pub mod film;
pub mod labels;
pub mod objects;
pub mod splits;

pub use recipe::{
    Heard, ObjectChoice, Platform, Recipe, Region, SECONDS, SPEEDS_MM_S, ScenarioChoice, VibrationModel,
};
pub use splits::{Split, content_hash};
pub use timeline::Event;

use rayon::prelude::*;
use serde_json::json;
use slipsense::params::{FRAME_RATE_HZ, XL_RATE_HZ};
use slipsense::sensor::{PiezoFrame, XlSample};
use slipsense_episode::{Episode, Meta};

use crate::contact::{Contact, Pose, PressureMap, Rocking};
use crate::draw::{Draw, Stream, stream};
use crate::film::Film;
use crate::friction::{Interface, Pull, STEP_HZ};
use crate::recipe::Resolved;
use crate::scenario::Plan;
use crate::unit::Unit;
use crate::vibration::{Carriage, Clock, Excitation, Slide, Sound};

/// Why a recipe cannot be generated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SynthError {
    /// Number of sensors.
    #[error("recipe: sensors is {0}, must be 1 to 3")]
    Sensors(usize),
    /// Length.
    #[error("recipe: seconds is {0}, must be 2.5 to 120")]
    Seconds(f64),
    /// Crosshead speed.
    #[error("recipe: speed_mm_s is {0}, must be above 0 and at most 50")]
    Speed(f64),
    /// Noise factor.
    #[error("recipe: noise is {0}, must be 0 to 4")]
    Noise(f64),
    /// Name of the object, and the names there are.
    #[error("recipe: object \"{0}\" is not in the catalogue ({1})")]
    Object(String, String),
}

/// Steps of the quasi-static physics per frame.
const STEPS: usize = STEP_HZ as usize / FRAME_RATE_HZ as usize;

/// What one sensor delivered, and what truly happened at its pad.
struct Sensor {
    scans: Vec<PiezoFrame>,
    xl: Vec<XlSample>,
    xl_end: Vec<u32>,
    slip_mm_s: Vec<f64>,
    fraction: Vec<f64>,
}

/// Number of frames that [`generate`] makes of a recipe, without simulating them.
pub fn plan_frames(recipe: &Recipe) -> Result<usize, SynthError> {
    let what = recipe.resolve()?;
    let plan = scenario::plan(&mut stream(recipe.seed, Stream::Scenario, 0), &what, recipe.seconds);
    Ok((plan.seconds * FRAME_RATE_HZ as f64).floor() as usize)
}

/// Generate one episode.
pub fn generate(recipe: &Recipe) -> Result<Episode, SynthError> {
    let what = recipe.resolve()?;
    let seed = recipe.seed;
    let plan = scenario::plan(&mut stream(seed, Stream::Scenario, 0), &what, recipe.seconds);
    let frames = (plan.seconds * FRAME_RATE_HZ as f64).floor() as usize;
    let shared = Shared::draw(recipe, &what, &plan, frames);
    let sensors: Vec<Sensor> = (0..recipe.sensors).map(|s| shared.sensor(s)).collect();

    let interleave = |f: usize| sensors.iter().map(move |s| (s, f));
    let piezo: Vec<_> = (0..frames).flat_map(interleave).map(|(s, f)| s.scans[f].clone()).collect();
    let mean = |of: fn(&Sensor) -> &Vec<f64>| {
        (0..frames)
            .map(|f| (sensors.iter().map(|s| of(s)[f]).sum::<f64>() / recipe.sensors as f64) as f32)
            .collect::<Vec<f32>>()
    };
    let displacement = labels::encoder(
        &mut stream(seed, Stream::Encoder, 0),
        |t| vibration::at(&plan.timeline.crosshead_mm, t),
        frames,
        FRAME_RATE_HZ as f64,
    );
    let slip = if plan.encoder_rule { labels::slip_interval(&displacement) } else { 0..0 };
    Ok(Episode {
        sensors: recipe.sensors,
        label: Some(labels::label(&piezo, recipe.sensors, slip)),
        piezo,
        xl_end: (0..frames).flat_map(interleave).map(|(s, f)| s.xl_end[f]).collect(),
        slip_true_mm_s: Some(mean(|s| &s.slip_mm_s)),
        slip_fraction: Some(mean(|s| &s.fraction)),
        displacement_mm: Some(displacement),
        meta: meta(recipe, &what, &plan, shared.lsb_g),
        xl: sensors.into_iter().map(|s| s.xl).collect(),
    })
}

/// Generate many episodes on all cores and hand each to `each`, with its position in `recipes`. The
/// results come in the order of the recipes; the first recipe that fails stops the rest.
pub fn generate_set<T: Send>(
    recipes: &[Recipe],
    each: impl Fn(usize, Episode) -> T + Sync,
) -> Result<Vec<T>, SynthError> {
    recipes.par_iter().enumerate().map(|(i, recipe)| Ok(each(i, generate(recipe)?))).collect()
}

fn meta(recipe: &Recipe, what: &Resolved, plan: &Plan, lsb_g: f64) -> Meta {
    let mut meta = Meta::nominal(lsb_g);
    for (key, value) in [
        ("platform", json!("synthetic")),
        ("source", json!("synthetic, slipsense-synth")),
        ("licence", json!("CC0-1.0")),
        ("object", json!(what.object.name)),
        ("held_out", json!(what.object.held_out)),
        ("scenario", json!(what.scenario)),
        ("speed_mm_s", json!(what.speed_mm_s)),
        ("seed", json!(recipe.seed)),
        ("recipe", json!(recipe)),
        ("events", json!(plan.timeline.events)),
    ] {
        meta.other.insert(key.to_owned(), value);
    }
    meta
}

/// What the sensors of one episode have in common.
struct Shared<'a> {
    recipe: &'a Recipe,
    what: &'a Resolved,
    plan: &'a Plan,
    frames: usize,
    pose: Pose,
    rocking: Rocking,
    /// Share of the pressure that shear shifts to the leading edge.
    lean: f64,
    /// Share of the grip that each sensor carries.
    shares: [f64; 3],
    sound: Sound,
    carriage: Carriage,
    lsb_g: f64,
    /// Samples that every accelerometer delivers, enough for the fastest clock.
    samples: usize,
}

impl<'a> Shared<'a> {
    fn draw(recipe: &'a Recipe, what: &'a Resolved, plan: &'a Plan, frames: usize) -> Self {
        let mut rng = stream(recipe.seed, Stream::Contact, 0);
        let split = rng.between(0.35, 0.65);
        let fastest = XL_RATE_HZ as f64 * 1.01;
        Self {
            recipe,
            what,
            plan,
            frames,
            pose: Pose {
                x_mm: 2.5 * rng.normal(),
                y_mm: 1.5 * rng.normal() - plan.stroke_mm / 2.0,
                yaw_rad: 0.15 * rng.normal(),
                tilt: [0.004 * rng.normal(), 0.004 * rng.normal()],
            },
            lean: rng.between(0.1, 0.6),
            rocking: Rocking::draw(&mut rng),
            shares: if recipe.sensors == 3 { [1.0, split, 1.0 - split] } else { [1.0; 3] },
            sound: Sound::draw(&mut stream(recipe.seed, Stream::Vibration, 0), what.object),
            carriage: Carriage::draw(&mut rng, plan.hand_held),
            lsb_g: if rng.chance(0.5) { 0.488e-3 } else { 0.244e-3 },
            samples: (frames as f64 / FRAME_RATE_HZ as f64 * fastest).ceil() as usize + 1,
        }
    }

    /// The fingers face each other: the second sees the first's left as its right.
    fn pose_of(&self, sensor: usize) -> Pose {
        let mut rng = stream(self.recipe.seed, Stream::Contact, 1 + sensor);
        let side = if sensor == 0 { 1.0 } else { -1.0 };
        Pose {
            x_mm: side * self.pose.x_mm + 0.5 * rng.normal(),
            y_mm: self.pose.y_mm + 0.5 * rng.normal(),
            yaw_rad: side * self.pose.yaw_rad + 0.02 * rng.normal(),
            tilt: [side * self.pose.tilt[0], -self.pose.tilt[1]],
        }
    }

    fn sensor(&self, sensor: usize) -> Sensor {
        let (seed, object) = (self.recipe.seed, self.what.object);
        let unit = Unit::draw(
            &mut stream(seed, Stream::Unit, sensor),
            self.recipe.noise,
            XL_RATE_HZ as f64,
            32768.0 * self.lsb_g,
        );
        let mut rng = stream(seed, Stream::Friction, sensor);
        let mut contact = Contact::draw(&mut rng, object, self.pose_of(sensor));
        let mut interface = Interface::draw(&mut rng, object);
        let mut film = Film::new(&unit.film, stream(seed, Stream::Film, sensor));
        let grip: Vec<f64> = self.plan.timeline.grip_n.iter().map(|n| n * self.shares[sensor]).collect();
        let (scans, slide) = self.touch(&grip, &mut contact, &mut interface, &mut film);

        let mut rng = stream(seed, Stream::Vibration, 1 + sensor);
        let start = rng.between(0.0, 1.0);
        let clock =
            Clock { rate_hz: unit.xl.rate_hz, start_s: start / unit.xl.rate_hz, samples: self.samples };
        let mut excitation = Excitation::new(self.plan, &self.sound, &slide, clock);
        let mut pulses = self.plan.timeline.pulses.clone();
        excitation.slip(&mut rng);
        excitation.stick_slip(&mut rng, &mut pulses);
        excitation.disturbances(&mut rng);
        excitation.impacts(&pulses, sensor);
        let mut motion_g = excitation.respond(&unit.modes, unit.coupling);
        self.carriage.add(clock, &mut motion_g);

        let per_frame = |steps: &[f64]| -> Vec<f64> {
            steps.chunks_exact(STEPS).map(|s| s.iter().sum::<f64>() / STEPS as f64).collect()
        };
        Sensor {
            scans,
            xl: accelerometer::sample(
                &unit.xl,
                self.lsb_g,
                &motion_g,
                &mut stream(seed, Stream::Accelerometer, sensor),
            ),
            xl_end: accelerometer::ends(&unit.xl, start, self.frames, FRAME_RATE_HZ as f64),
            slip_mm_s: per_frame(&slide.speed_mm_s),
            fraction: per_frame(&slide.fraction),
        }
    }

    /// Contact and friction of one finger, step by step, and the array's scan at each tick.
    fn touch(
        &self,
        grip: &[f64],
        contact: &mut Contact,
        interface: &mut Interface,
        film: &mut Film<'_>,
    ) -> (Vec<PiezoFrame>, Slide) {
        let mut map = PressureMap::empty();
        let (mut map_n, mut shear_n) = (0.0, 0.0);
        let mut slide = Slide::default();
        let mut gripped_at_mm = 0.0;
        let scans = (0..self.frames)
            .map(|frame| {
                let steps = frame * STEPS..(frame + 1) * STEPS;
                for (&force, &position_mm) in grip[steps.clone()].iter().zip(&self.plan.pull_mm[steps]) {
                    if map_n <= 0.0 && force > 0.0 {
                        gripped_at_mm = interface.position_mm();
                        contact.place(0.0, [0.0; 2]);
                        contact.pressures(force, 0.0, &mut map);
                        map_n = force;
                    }
                    let scale = if map_n > 0.0 { force / map_n } else { 0.0 };
                    let pull = Pull { position_mm, stiffness_n_per_mm: self.plan.pull_n_per_mm };
                    let sliding = interface.step(&map, scale, pull, 1.0 / STEP_HZ);
                    shear_n = sliding.shear_n;
                    slide.speed_mm_s.push(sliding.speed_mm_s);
                    slide.fraction.push(sliding.fraction);
                    slide.travel_mm.push(sliding.travel_mm);
                    slide.grip_n.push(force);
                }
                let tick = (frame + 1) * STEPS;
                let force = grip[tick];
                if force > 0.0 {
                    let rock = self.rocking.at(tick as f64 / STEP_HZ, force / self.plan.base_n - 1.0);
                    contact.place(slide.travel_mm[tick - 1] - gripped_at_mm, rock);
                }
                let shear = if force > 0.05 { self.lean * shear_n / force } else { 0.0 };
                contact.pressures(force, shear, &mut map);
                map_n = force;
                interface.release_unloaded(&map);
                film.scan(frame, &map, |age_s| {
                    let then = vibration::at(grip, tick as f64 / STEP_HZ - age_s);
                    if force > 0.0 { (then / force).min(4.0) } else { 0.0 }
                })
            })
            .collect();
        (scans, slide)
    }
}
