//! One finger of an episode: what its array and its accelerometer deliver, and what happens at its pad.

use serde_json::json;
use slipsense::params::{FRAME_RATE_HZ, MAX_SENSORS};
use slipsense::sensor::{PiezoFrame, XlSample};

use crate::accelerometer::{self, Quirk, XlSession};
use crate::contact::{AsperityNoise, Contact, Pose, PressureMap, Rocking};
use crate::draw::{Draw, Rng, Span, Stream, stream};
use crate::draw_log::DrawLog;
use crate::film::{Film, FilmSession};
use crate::friction::{self, Friction, Pull, STEP_HZ, SlipState};
use crate::objects::Shape;
use crate::pulling_hand::PullingHand;
use crate::recipe::{Platform, Recipe, Region, ResolvedRecipe, VibrationContent};
use crate::scenario::Plan;
use crate::timeline::Event;
use crate::unit::{Unit, UnitId};
use crate::vibration::{self, Clock, Modes, NoiseStreams, Scene, SlipSeries, Vibration};

/// Steps of the quasi-static physics per frame.
pub(crate) const STEPS: usize = STEP_HZ as usize / FRAME_RATE_HZ as usize;

/// How far the contact patch lies towards the palm there, mm. The pad ends at 11.2 mm, so that the outer
/// part of the 8–12 mm that palm contacts span is left to patches wider than a cable's.
const PALM_MM: Span = (8.6, 10.4);
/// Half the width of the patch under a round object, mm.
const ROUND_PATCH_MM: f64 = 1.0;
const PAD_HALF_MM: f64 = 11.2;
/// Change of the pressure at the ends of a patch, per shear over grip. Shear acts on the skin, t above the array, so
/// over a patch of length L it is 6 t / L: a skin of 0.1 to 0.3 mm, patches of 7.5 to 15 mm.
const LEAN: Span = (0.04, 0.24);

/// What one sensor delivered besides its scans, and the truth at its pad, one value per frame.
pub(crate) struct Finger {
    pub xl: Vec<XlSample>,
    pub xl_end: Vec<u32>,
    pub slip_mm_s: Vec<f64>,
    pub fraction: Vec<f64>,
    pub path_mm: Vec<f64>,
    /// Turn of the object since it was gripped.
    pub turn_rad: Vec<f64>,
    /// The object is between the fingers: some of the pad carries load.
    pub loaded: Vec<bool>,
    pub faults: Vec<Event>,
}

/// Mean of a series over the fingers, frame by frame.
pub(crate) fn mean(fingers: &[Finger], of: fn(&Finger) -> &Vec<f64>) -> Vec<f32> {
    let sum = |f: usize| fingers.iter().map(|finger| of(finger)[f]).sum::<f64>();
    (0..of(&fingers[0]).len()).map(|f| (sum(f) / fingers.len() as f64) as f32).collect()
}

/// What the sensors of one episode have in common.
pub(crate) struct EpisodeSetup<'a> {
    resolved: &'a ResolvedRecipe,
    /// What happens. A plant puts another in its place, with the commands that came since.
    pub plan: &'a Plan,
    /// The sources of vibration draw each from a stream of its own.
    pub sources_apart: bool,
    frames: usize,
    pub units: Vec<UnitId>,
    builds: Vec<SensorBuild>,
    pose: Pose,
    rocking: Rocking,
    /// Share of the pressure that shear shifts to the leading edge.
    lean: f64,
    shares: [f64; MAX_SENSORS],
    pub vibration: Vibration,
    pub lsb_g: f64,
}

/// One sensor with what its accelerometer is like in this recording.
struct SensorBuild {
    unit: Unit,
    modes: Modes,
    xl: XlSession,
    clock: Clock,
    quirk: Option<Quirk>,
    /// Goes on to draw the vibration.
    rng: Rng,
}

impl SensorBuild {
    fn draw(recipe: &Recipe, sensor: usize, id: UnitId, seconds: f64) -> Self {
        let mut rng = stream(recipe.seed, Stream::Vibration, 1 + sensor);
        let families = recipe.families;
        let mut unit = if families.is_laboratory() {
            Unit::new(id)
        } else {
            Unit::of_episode(recipe.seed, sensor, id, families.path)
        };
        let own = &mut stream(recipe.seed, Stream::Families, 8 + sensor);
        let quirk = Quirk::draw(families.sensor, own, &mut unit.xl);
        let modes = unit.modes.in_grasp(&mut rng, recipe.region);
        let xl = XlSession::draw(&mut rng, recipe.noise);
        let clock = xl.clock(&unit.xl, seconds);
        Self { unit, modes, xl, clock, quirk, rng }
    }
}

fn scene<'a>(resolved: &ResolvedRecipe, plan: &'a Plan) -> Scene<'a> {
    Scene {
        platform: resolved.recipe.platform,
        source: resolved.recipe.vibration,
        families: resolved.recipe.families,
        content: resolved.recipe.vibration_content,
        rig_leak: resolved.recipe.rig_leak,
        hand_held: plan.hand_held,
        linked: plan.linked,
        shared_table: plan.shared_table,
        object: resolved.object,
        timeline: &plan.timeline,
    }
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

/// Shift of the object that puts its patch `patch_mm` from the middle: a wide one must reach over the pad's edge.
fn palm_shift_mm(shape: &Shape, patch_mm: f64) -> f64 {
    let half = match shape {
        Shape::Flat { width_mm, .. } => width_mm / 2.0,
        _ => ROUND_PATCH_MM,
    };
    // The patch spans from `shift − half` to the pad's edge if the object reaches over it.
    if patch_mm + half > PAD_HALF_MM { 2.0 * patch_mm - PAD_HALF_MM + half } else { patch_mm }
}

impl<'a> EpisodeSetup<'a> {
    pub(crate) fn draw(resolved: &'a ResolvedRecipe, plan: &'a Plan, frames: usize) -> Self {
        let recipe = &resolved.recipe;
        let mut rng = stream(recipe.seed, Stream::Contact, 0);
        let scene = scene(resolved, plan);
        let own = &mut stream(recipe.seed, Stream::Families, 1);
        let vibration = Vibration::draw(&mut stream(recipe.seed, Stream::Vibration, 0), own, &scene);
        let mut mount = stream(recipe.seed, Stream::Mount, 0);
        let units = UnitId::mounted(&mut mount, resolved.recipe.platform, recipe.sensors);
        let seconds = frames as f64 / FRAME_RATE_HZ as f64;
        let builds: Vec<_> =
            units.iter().enumerate().map(|(s, &id)| SensorBuild::draw(recipe, s, id, seconds)).collect();
        let across = rng.normal();
        // At the palm a crooked object would reach into the middle of the pad.
        let (x_mm, yaw) = match resolved.recipe.region {
            Region::Centre => (2.5 * across, 0.15),
            Region::Palm => {
                (-palm_shift_mm(&resolved.object.shape, rng.uniform(PALM_MM)) + 0.1 * across, 0.03)
            }
        };
        Self {
            resolved,
            plan,
            sources_apart: false,
            frames,
            units,
            builds,
            pose: Pose {
                x_mm: x_mm - plan.stroke_mm[0] / 2.0,
                y_mm: 1.5 * rng.normal() - plan.stroke_mm[1] / 2.0,
                yaw_rad: yaw * rng.normal(),
                tilt: [0.004 * rng.normal(), 0.004 * rng.normal()],
            },
            lean: rng.uniform(LEAN),
            rocking: Rocking::draw(&mut rng),
            shares: shares(&mut rng, resolved.recipe.platform, recipe.sensors),
            vibration,
            lsb_g: if rng.chance(0.5) { 0.488e-3 } else { 0.244e-3 },
        }
    }

    pub(crate) fn log(&self, log: &mut DrawLog) {
        log.add(
            "grasp",
            &json!({
                "lean": self.lean,
                "shares": self.shares[..self.resolved.recipe.sensors],
                "xl_range_g": 32768.0 * self.lsb_g,
            }),
        );
        log.add("sound", &self.vibration);
    }

    /// The fingers face each other: the second sees the first's left as its right. Jaws are parallel; the
    /// fingers of a hand meet the object at angles of their own.
    fn pose_of(&self, sensor: usize) -> Pose {
        let mut rng = stream(self.resolved.recipe.seed, Stream::Contact, 1 + sensor);
        let side = if sensor == 0 { 1.0 } else { -1.0 };
        let loose = if self.resolved.recipe.platform == Platform::Tesollo { 4.0f64 } else { 1.0 };
        // At the palm the patch stays on the pad.
        let along_x = if self.resolved.recipe.region == Region::Palm { 0.1 } else { 0.5 };
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
    pub(crate) fn finger(&self, sensor: usize, piezo: &mut [PiezoFrame], log: &mut DrawLog) -> Finger {
        let (seed, object) = (self.resolved.recipe.seed, self.resolved.object);
        let build = &self.builds[sensor];
        let mut rng = stream(seed, Stream::Friction, sensor);
        let pose = self.pose_of(sensor);
        let families = self.resolved.recipe.families;
        let own = &mut stream(seed, Stream::Families, 2 + sensor);
        let mut contact = Contact::draw(&mut rng, object, pose, self.resolved.recipe.region)
            .with_face(families.contact, own);
        let (mut interface, drawn_interface) = friction::draw(families.friction, object, &mut rng, own);
        let mut grain = (AsperityNoise::draw(&mut rng), rng);
        let mut rng = stream(seed, Stream::Film, sensor);
        let film_session = FilmSession::draw(&mut rng, self.resolved.recipe.noise);
        let film_session = film_session.aged(self.resolved.recipe.age_months);
        let faults = film_session.events(self.frames).into_iter().map(Event::rounded).collect();
        log.add(
            format!("finger_{sensor}"),
            &json!({
                "unit": self.units[sensor], "film_unit": build.unit.film, "xl_unit": build.unit.xl,
                "x_mm": pose.x_mm, "y_mm": pose.y_mm, "yaw_rad": pose.yaw_rad, "tilt": pose.tilt,
                "contact": contact, "interface": drawn_interface, "grain": grain.0,
                "film": film_session, "modes": build.modes, "xl": build.xl,
            }),
        );
        let (mut film, drawn) = Film::new(&build.unit.film, film_session, rng).with_families(families, own);
        if !families.is_laboratory() {
            let other = json!({ "film": drawn, "accelerometer": build.quirk });
            log.add(format!("finger_{sensor}_families"), &other);
        }
        let (slip, turn_rad, loaded) =
            self.contact(sensor, &mut contact, &mut *interface, &mut grain, &mut film, piezo);
        let (xl, xl_end) = self.accelerometer(sensor, &slip);
        let per_frame = |steps: &[f64]| -> Vec<f64> {
            steps.chunks_exact(STEPS).map(|s| s.iter().sum::<f64>() / STEPS as f64).collect()
        };
        let at_ticks = |steps: &[f64]| steps.iter().skip(STEPS - 1).step_by(STEPS).copied().collect();
        Finger {
            xl,
            xl_end,
            slip_mm_s: per_frame(&slip.speed_mm_s),
            fraction: per_frame(&slip.fraction),
            path_mm: at_ticks(&slip.path_mm),
            turn_rad,
            loaded,
            faults,
        }
    }

    /// Contact and friction by steps; at each tick the array's scan, the object's turn, whether the pad carries load.
    fn contact(
        &self,
        sensor: usize,
        contact: &mut Contact,
        interface: &mut dyn Friction,
        (grain, rng): &mut (AsperityNoise, Rng),
        film: &mut Film<'_>,
        piezo: &mut [PiezoFrame],
    ) -> (SlipSeries, Vec<f64>, Vec<bool>) {
        let share = self.shares[sensor];
        let timeline = &self.plan.timeline;
        let untouched = self.resolved.recipe.vibration_content == VibrationContent::IdleNoise;
        let grip = timeline.grip_n.iter().map(|n| if untouched { 0.0 } else { n * share });
        let grip: Vec<f64> = grip.collect();
        let mut map = PressureMap::empty();
        let (mut map_n, mut sliding) = (0.0, SlipState::default());
        let (mut slip, mut turn_rad, mut loaded) = (SlipSeries::default(), Vec::new(), Vec::new());
        let mut hand = PullingHand::default();
        let mut gripped_at = ([0.0; 2], 0.0);
        for frame in 0..self.frames {
            let steps = frame * STEPS..(frame + 1) * STEPS;
            for (step, &force) in steps.clone().zip(&grip[steps]) {
                if map_n <= 0.0 && force > 0.0 {
                    gripped_at = (sliding.travel_mm, sliding.turn_rad);
                    contact.place([0.0; 2], 0.0, [0.0; 2]);
                    contact.pressures(force, [0.0; 2], &mut map);
                    map_n = force;
                }
                let scale = if map_n > 0.0 { force / map_n } else { 0.0 };
                let mut pull = self.pull(step, sensor);
                if let Some(strength) = self.plan.pull_limit {
                    pull = hand.pull(pull, strength.shared(share), (sliding.travel_mm, sliding.turn_rad));
                }
                sliding = interface.step(&map, scale, pull);
                slip.speed_mm_s.push(sliding.speed_mm_s);
                slip.fraction.push(sliding.fraction);
                slip.path_mm.push(sliding.path_mm);
                slip.direction.push(sliding.direction);
                slip.grip_n.push(force);
            }
            let tick = (frame + 1) * STEPS;
            let force = grip[tick];
            if force > 0.0 {
                let excess = timeline.grip_n[tick] / self.plan.base_n - 1.0;
                let mut rock = self.rocking.at(tick as f64 / STEP_HZ, excess);
                rock.iter_mut().zip(timeline.roll_rad[tick]).for_each(|(rock, roll)| *rock += roll);
                let shift = [0, 1].map(|axis| sliding.travel_mm[axis] - gripped_at.0[axis]);
                contact.place(shift, sliding.turn_rad - gripped_at.1, rock);
            }
            let lean = if force > 0.05 { self.lean / force } else { 0.0 };
            contact.pressures(force, sliding.shear_n.map(|n| lean * n), &mut map);
            grain.apply(sliding.path_mm, rng, &mut map);
            map_n = force;
            turn_rad.push(sliding.turn_rad - gripped_at.1);
            loaded.push(!map.loaded.is_empty());
            interface.release_unloaded(&map);
            let pickup = timeline.pickup_counts(tick, self.plan.motor_pickup_counts);
            piezo[frame * self.resolved.recipe.sensors + sensor] = film.scan(frame, &map, pickup, |age_s| {
                let then = vibration::at(&grip, tick as f64 / STEP_HZ - age_s);
                if force > 0.0 { (then / force).min(4.0) } else { 0.0 }
            });
        }
        (slip, turn_rad, loaded)
    }

    /// What pulls one finger's contact in a step: every finger bears its share. The second finger and the
    /// third see the first's left as their right, and a turn the other way round.
    fn pull(&self, step: usize, sensor: usize) -> Pull {
        let (plan, share) = (self.plan, self.shares[sensor]);
        let side = if sensor == 0 { 1.0 } else { -1.0 };
        let [x, y] = plan.pull_mm[step];
        Pull {
            position_mm: [side * x, y],
            turn_rad: side * plan.turn_rad.get(step).copied().unwrap_or(0.0),
            stiffness_n_per_mm: plan.pull_n_per_mm * share,
            twist_n_mm_per_rad: plan.twist_n_mm_per_rad * share,
        }
    }

    /// What the accelerometer delivers, and how many of its samples are there at each tick.
    pub fn accelerometer(&self, sensor: usize, slip: &SlipSeries) -> (Vec<XlSample>, Vec<u32>) {
        let build = &self.builds[sensor];
        let scene = scene(self.resolved, self.plan);
        let streams = if self.sources_apart { NoiseStreams::apart } else { NoiseStreams::in_turn };
        let streams = &mut streams(build.rng.clone());
        let motion = self.vibration.motion(&scene, slip, &build.modes, (sensor, build.clock), streams);
        let noise = &mut stream(self.resolved.recipe.seed, Stream::Accelerometer, sensor);
        let own = &mut stream(self.resolved.recipe.seed, Stream::Families, 16 + sensor);
        let quirk = build.quirk.as_ref().map(|quirk| (quirk, own));
        let (unit, clock) = (&build.unit.xl, build.clock);
        let xl = accelerometer::sample(unit, &build.xl, clock, self.lsb_g, &motion.g, noise, quirk);
        (xl, build.clock.ends(self.frames))
    }
}
