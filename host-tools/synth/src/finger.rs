//! One finger of an episode: what its array and its accelerometer deliver, and what truly happens at its
//! pad.

use serde_json::json;
use slipsense::params::{FRAME_RATE_HZ, MAX_SENSORS, XL_RATE_HZ};
use slipsense::sensor::{PiezoFrame, XlSample};

use crate::accelerometer;
use crate::contact::{Contact, Pose, PressureMap, Rocking};
use crate::draw::{Draw, Rng, Stream, stream};
use crate::film::Film;
use crate::friction::{Interface, Pull, STEP_HZ};
use crate::log::Log;
use crate::objects::Shape;
use crate::recipe::{Platform, Recipe, Region, Resolved};
use crate::scenario::Plan;
use crate::scenario::levels::{Span, TWIST_RADIUS_MM};
use crate::unit::{Unit, UnitId};
use crate::vibration::{self, Carriage, Clock, Excitation, Slide, Sound};

/// Steps of the quasi-static physics per frame.
pub(crate) const STEPS: usize = STEP_HZ as usize / FRAME_RATE_HZ as usize;

/// How far the contact patch lies towards the palm there, mm. The pad ends at 11.2 mm, so that the outer
/// part of the 8–12 mm that palm contacts span is left to patches wider than a cable's.
const PALM_MM: Span = (8.6, 10.4);
/// Half the width of the patch under a round object, mm.
const ROUND_PATCH_MM: f64 = 1.0;
/// Half the width of the pad, mm.
const PAD_HALF_MM: f64 = 11.2;

/// What one sensor delivered besides its scans, and the truth at its pad, one value per frame.
pub(crate) struct Finger {
    pub xl: Vec<XlSample>,
    pub xl_end: Vec<u32>,
    /// Interface speed.
    pub slip_mm_s: Vec<f64>,
    /// Share of the load that slides.
    pub fraction: Vec<f64>,
    /// Slid length so far.
    pub path_mm: Vec<f64>,
}

/// What the sensors of one episode have in common.
pub(crate) struct Shared<'a> {
    recipe: &'a Recipe,
    what: &'a Resolved,
    plan: &'a Plan,
    frames: usize,
    pub units: Vec<UnitId>,
    pose: Pose,
    rocking: Rocking,
    /// Share of the pressure that shear shifts to the leading edge.
    lean: f64,
    /// Share of the grip that each sensor carries.
    shares: [f64; MAX_SENSORS],
    sound: Sound,
    carriage: Carriage,
    pub lsb_g: f64,
    /// Samples that every accelerometer delivers, enough for the fastest clock.
    samples: usize,
}

/// Loads of the fingers relative to the plan's. Two jaws carry the same but for the friction of their
/// guide; of three fingers one stands against two that share its load unequally.
fn shares(rng: &mut Rng, platform: Platform, sensors: usize) -> [f64; MAX_SENSORS] {
    let (guide, split) = (rng.between(0.95, 1.05), rng.between(0.3, 0.7));
    let off_normal = rng.between(0.85, 1.0);
    match (platform, sensors) {
        (Platform::Tesollo, 3) => [1.0, split / off_normal, (1.0 - split) / off_normal],
        (Platform::Tesollo, _) => [1.0, off_normal, 0.0],
        (Platform::Umi, _) => [1.0, guide, 0.0],
    }
}

/// Shift of the object's centre that puts its patch `patch_mm` from the middle: a wide object must reach
/// over the pad's edge for that.
fn palm_shift_mm(shape: &Shape, patch_mm: f64) -> f64 {
    let half = match shape {
        Shape::Flat { width_mm, .. } => width_mm / 2.0,
        _ => ROUND_PATCH_MM,
    };
    // The patch spans from `shift − half` to the pad's edge if the object reaches over it.
    if patch_mm + half > PAD_HALF_MM { 2.0 * patch_mm - PAD_HALF_MM + half } else { patch_mm }
}

impl<'a> Shared<'a> {
    pub(crate) fn draw(recipe: &'a Recipe, what: &'a Resolved, plan: &'a Plan, frames: usize) -> Self {
        let mut rng = stream(recipe.seed, Stream::Contact, 0);
        let fastest = XL_RATE_HZ as f64 * 1.01;
        let across = rng.normal();
        // At the palm a crooked object would reach into the middle of the pad.
        let (x_mm, yaw) = match what.region {
            Region::Centre => (2.5 * across, 0.15),
            Region::Palm => {
                (-palm_shift_mm(&what.object.shape, rng.between(PALM_MM.0, PALM_MM.1)) + 0.1 * across, 0.03)
            }
        };
        Self {
            recipe,
            what,
            plan,
            frames,
            units: UnitId::mounted(&mut stream(recipe.seed, Stream::Mount, 0), what.platform, recipe.sensors),
            pose: Pose {
                x_mm: x_mm - plan.stroke_mm[0] / 2.0,
                y_mm: 1.5 * rng.normal() - plan.stroke_mm[1] / 2.0,
                yaw_rad: yaw * rng.normal(),
                tilt: [0.004 * rng.normal(), 0.004 * rng.normal()],
            },
            lean: rng.between(0.1, 0.6),
            rocking: Rocking::draw(&mut rng),
            shares: shares(&mut rng, what.platform, recipe.sensors),
            sound: Sound::draw(&mut stream(recipe.seed, Stream::Vibration, 0), what.object),
            carriage: Carriage::draw(&mut rng, plan.hand_held),
            lsb_g: if rng.chance(0.5) { 0.488e-3 } else { 0.244e-3 },
            samples: (frames as f64 / FRAME_RATE_HZ as f64 * fastest).ceil() as usize + 1,
        }
    }

    /// What all sensors share, for the log.
    pub(crate) fn log(&self, log: &mut Log) {
        log.add(
            "grasp",
            &json!({
                "lean": self.lean,
                "shares": self.shares[..self.recipe.sensors],
                "xl_range_g": self.range_g(),
            }),
        );
    }

    fn range_g(&self) -> f64 {
        32768.0 * self.lsb_g
    }

    /// The fingers face each other: the second sees the first's left as its right. Jaws are parallel; the
    /// fingers of a hand meet the object at angles of their own.
    fn pose_of(&self, sensor: usize) -> Pose {
        let mut rng = stream(self.recipe.seed, Stream::Contact, 1 + sensor);
        let side = if sensor == 0 { 1.0 } else { -1.0 };
        let loose = if self.what.platform == Platform::Tesollo { 4.0f64 } else { 1.0 };
        // At the palm the patch stays on the pad.
        let along_x = if self.what.region == Region::Palm { 0.1 } else { 0.5 };
        Pose {
            x_mm: side * self.pose.x_mm + along_x * rng.normal(),
            y_mm: self.pose.y_mm + 0.5 * loose.min(2.0) * rng.normal(),
            yaw_rad: side * self.pose.yaw_rad + 0.02 * loose * rng.normal(),
            tilt: [
                side * self.pose.tilt[0] + 0.001 * loose * rng.normal(),
                -self.pose.tilt[1] + 0.001 * loose * rng.normal(),
            ],
        }
    }

    /// Make one finger; its scans go to every `sensors`-th place of `piezo`.
    pub(crate) fn finger(&self, sensor: usize, piezo: &mut [PiezoFrame], log: &mut Log) -> Finger {
        let (seed, object) = (self.recipe.seed, self.what.object);
        let unit = Unit::new(self.units[sensor], self.recipe.noise, self.range_g());
        let mut rng = stream(seed, Stream::Friction, sensor);
        let pose = self.pose_of(sensor);
        let mut contact = Contact::draw(&mut rng, object, pose);
        let mut interface = Interface::draw(&mut rng, object);
        let mut film = Film::new(&unit.film, stream(seed, Stream::Film, sensor));
        log.add(
            format!("finger_{sensor}"),
            &json!({
                "unit": self.units[sensor],
                "x_mm": pose.x_mm, "y_mm": pose.y_mm, "yaw_rad": pose.yaw_rad, "tilt": pose.tilt,
            }),
        );
        let slide = self.touch(sensor, &mut contact, &mut interface, &mut film, piezo);
        let (xl, xl_end) = self.hear(sensor, &unit, &slide);
        let per_frame = |steps: &[f64]| -> Vec<f64> {
            steps.chunks_exact(STEPS).map(|s| s.iter().sum::<f64>() / STEPS as f64).collect()
        };
        let mut slid = 0.0;
        let slip_mm_s = per_frame(&slide.speed_mm_s);
        Finger {
            xl,
            xl_end,
            fraction: per_frame(&slide.fraction),
            path_mm: slip_mm_s
                .iter()
                .map(|v| {
                    slid += v / FRAME_RATE_HZ as f64;
                    slid
                })
                .collect(),
            slip_mm_s,
        }
    }

    /// Contact and friction, step by step, and the array's scan at each tick.
    fn touch(
        &self,
        sensor: usize,
        contact: &mut Contact,
        interface: &mut Interface,
        film: &mut Film<'_>,
        piezo: &mut [PiezoFrame],
    ) -> Slide {
        let share = self.shares[sensor];
        let line = &self.plan.timeline;
        let grip: Vec<f64> = line.grip_n.iter().map(|n| n * share).collect();
        let mut map = PressureMap::empty();
        let (mut map_n, mut shear_n) = (0.0, 0.0);
        let mut slide = Slide::default();
        let mut gripped_at_mm = 0.0;
        for frame in 0..self.frames {
            let steps = frame * STEPS..(frame + 1) * STEPS;
            for (step, &force) in steps.clone().zip(&grip[steps]) {
                if map_n <= 0.0 && force > 0.0 {
                    gripped_at_mm = interface.position_mm();
                    contact.place(0.0, [0.0; 2]);
                    contact.pressures(force, 0.0, &mut map);
                    map_n = force;
                }
                let scale = if map_n > 0.0 { force / map_n } else { 0.0 };
                let sliding = interface.step(&map, scale, self.pull(step, share), 1.0 / STEP_HZ);
                shear_n = sliding.shear_n;
                slide.speed_mm_s.push(sliding.speed_mm_s);
                slide.fraction.push(sliding.fraction);
                slide.travel_mm.push(sliding.travel_mm);
                slide.grip_n.push(force);
            }
            let tick = (frame + 1) * STEPS;
            let force = grip[tick];
            if force > 0.0 {
                let excess = line.grip_n[tick] / self.plan.base_n - 1.0;
                let mut rock = self.rocking.at(tick as f64 / STEP_HZ, excess);
                rock.iter_mut().zip(line.roll_rad[tick]).for_each(|(rock, roll)| *rock += roll);
                contact.place(slide.travel_mm[tick - 1] - gripped_at_mm, rock);
            }
            let shear = if force > 0.05 { self.lean * shear_n / force } else { 0.0 };
            contact.pressures(force, shear, &mut map);
            map_n = force;
            interface.release_unloaded(&map);
            piezo[frame * self.recipe.sensors + sensor] = film.scan(frame, &map, |age_s| {
                let then = vibration::at(&grip, tick as f64 / STEP_HZ - age_s);
                if force > 0.0 { (then / force).min(4.0) } else { 0.0 }
            });
        }
        slide
    }

    /// What pulls one finger's contact in a step: every finger bears its share. The interface has one axis:
    /// a pull in any direction is its way along that, and a twist the way at its radius.
    fn pull(&self, step: usize, share: f64) -> Pull {
        let plan = self.plan;
        let [x, y] = plan.pull_mm[step];
        let way = (x * x + y * y).sqrt() * if y < 0.0 || (y == 0.0 && x < 0.0) { -1.0 } else { 1.0 };
        let turned = plan.turn_rad.get(step).map_or(0.0, |rad| rad * TWIST_RADIUS_MM);
        Pull { position_mm: way + turned, stiffness_n_per_mm: plan.pull_n_per_mm * share }
    }

    /// What the accelerometer delivers, and how many of its samples are there at each tick.
    fn hear(&self, sensor: usize, unit: &Unit, slide: &Slide) -> (Vec<XlSample>, Vec<u32>) {
        let seed = self.recipe.seed;
        let mut rng = stream(seed, Stream::Vibration, 1 + sensor);
        let start = rng.between(0.0, 1.0);
        let clock =
            Clock { rate_hz: unit.xl.rate_hz, start_s: start / unit.xl.rate_hz, samples: self.samples };
        let mut excitation = Excitation::new(self.plan, &self.sound, slide, clock);
        let mut pulses = self.plan.timeline.pulses.clone();
        excitation.slip(&mut rng);
        excitation.stick_slip(&mut rng, &mut pulses);
        excitation.disturbances(&mut rng);
        excitation.impacts(&pulses, sensor);
        let mut motion_g = excitation.respond(&unit.modes, unit.coupling);
        self.carriage.add(clock, &mut motion_g);
        let noise = &mut stream(seed, Stream::Accelerometer, sensor);
        let xl = accelerometer::sample(&unit.xl, self.lsb_g, &motion_g, noise);
        (xl, accelerometer::ends(&unit.xl, start, self.frames, FRAME_RATE_HZ as f64))
    }
}
