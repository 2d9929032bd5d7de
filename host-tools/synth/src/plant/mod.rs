//! The generator's gripper, object and sensors, frame by frame: for a controller that commands the grip while it
//! reads the sensors.
//!
//! Contact, friction, film and vibration are those of [`generate`](crate::generate), line by line. An episode's
//! future is known before it is made; here a command may change what is still to come. The plant therefore looks
//! ahead under the commands that it has, and looks ahead anew when one more comes. What has been delivered stays
//! as it was, to the bit: every source draws from a stream of its own in the order of time, and a command acts
//! later than what was delivered.
//!
//! What it leaves out stands in the book's page on the world.

mod trials;
#[cfg(test)]
mod tests;

pub use trials::{Direction, Hand, Objects, Trial, trials};

use std::ops::Range;

use slipsense::params::{FRAME_RATE_HZ, MAX_SENSORS};
use slipsense::sensor::{PiezoFrame, SensorInput};

use crate::draw::{Draw, Stream, stream};
use crate::draw_log::DrawLog;
use crate::finger::{EpisodeSetup, Finger, STEPS, mean};
use crate::friction::STEP_HZ;
use crate::generate::frames;
use crate::labels::{GAP_FRAMES, interface_intervals};
use crate::mix::ScenarioChoice;
use crate::pulling_hand::PullLimit;
use crate::recipe::{Platform, Recipe, ResolvedRecipe, SynthError};
use crate::scenario::levels::GRIP_N;
use crate::scenario::script::{PhaseKind, Script};
use crate::scenario::{self, Plan};
use crate::timeline::ramp;
use crate::vibration;

/// An object that has slid this far is lost: a third of the pad's length, a modelling choice.
pub const LOST_MM: f64 = 10.0;
/// One that has turned this far is lost, rad; a modelling choice.
pub const LOST_TURN_RAD: f64 = std::f64::consts::FRAC_PI_4;
pub const GRIP_MAX_N: f64 = GRIP_N.1;
/// Way of the pulling hand: more than takes an object out of the grip.
const PULL_MM: f64 = 16.0;
/// Turn of the twisting hand.
const TWIST_RAD: f64 = 1.6;
/// A command acts this much later than what was delivered, s, at least: a tick knows of one step after it, no more.
const NOT_BEFORE_S: f64 = 2.0 / STEP_HZ;

#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum CommandError {
    /// It would change what was delivered.
    #[error("command: starts at {start_s} s, what comes before {earliest_s} s is past")]
    Past { start_s: f64, earliest_s: f64 },
    #[error(
        "command: from {start_s} to {end_s} s, must start and end in order within the grasp, {from_s} to {to_s} s"
    )]
    Outside { start_s: f64, end_s: f64, from_s: f64, to_s: f64 },
    #[error("command: grip of {0} N, must be {low} to {high}", low = GRIP_N.0, high = GRIP_N.1)]
    Grip(f64),
}

#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    /// Number of the frame; its tick is at `(index + 1) / 240` s.
    pub index: usize,
    sensors: usize,
    inputs: [SensorInput<'a>; MAX_SENSORS],
}

impl<'a> Frame<'a> {
    /// Scans and samples, in the order of the sensors.
    pub fn inputs(&self) -> &[SensorInput<'a>] {
        &self.inputs[..self.sensors]
    }
}

/// One grasp of an object that a hand pulls or twists.
pub struct Plant {
    resolved: ResolvedRecipe,
    /// As it goes without a command.
    planned: Plan,
    /// As it goes with the commands so far.
    plan: Plan,
    /// Starts of the commanded motions, seconds.
    motions_s: Vec<f64>,
    /// Force that the last command ends at.
    target_n: f64,
    frames: usize,
    /// Times between which the object is held as firmly as commanded.
    held_s: (f64, f64),
    /// Frames of the pull and of the standstill after it.
    pulled: Range<usize>,
    /// What will happen unless a command comes.
    piezo: Vec<PiezoFrame>,
    fingers: Vec<Finger>,
    delivered: usize,
}

impl Plant {
    /// A grasp of `recipe`, which a hand pulls (`free_pull`) or twists (`rotation`); other scenarios are refused.
    /// `strength` is the most that the hand pulls with, over the force at which the object would slip as a whole
    /// if its friction were the same everywhere; it has to be above 0.
    pub fn new(recipe: &Recipe, strength: f64) -> Result<Self, SynthError> {
        let twists = match recipe.scenario {
            ScenarioChoice::FreePull => false,
            ScenarioChoice::Rotation => true,
            other => {
                let rule = format!("scenario is {other:?}, a plant takes free_pull or rotation");
                return Err(SynthError::new(rule));
            }
        };
        if !(strength > 0.0 && strength.is_finite()) {
            return Err(SynthError(format!("strength is {strength}, must be a number above 0")));
        }
        let resolved = recipe.resolve()?;
        let seed = recipe.seed;
        let radius_mm = resolved.twist_radius_mm();
        let travel_mm = if twists { TWIST_RAD * radius_mm } else { PULL_MM };
        let script = Script::trial(&mut stream(seed, Stream::Script, 0), &resolved, travel_mm);
        let frames = frames(&script);
        let mut plan = scenario::plan(&mut stream(seed, Stream::Scenario, 0), &resolved, script);
        let of = |kind| plan.script.phases_of(kind).next().copied();
        let (Some(grasp), Some(pull), Some(settle)) =
            (scenario::grasps(&plan.script).pop(), of(PhaseKind::Pull), of(PhaseKind::Settle))
        else {
            unreachable!("the script of a trial has one grasp with a pull")
        };
        // A motor holds the force commanded: nobody varies the grip.
        let base_n = plan.base_n;
        for (i, t) in plan.timeline.times(0.0, f64::INFINITY) {
            plan.timeline.grip_n[i] =
                base_n * ramp(t, grasp.touch, grasp.held) * (1.0 - ramp(t, grasp.release, grasp.let_go));
        }
        // The object lies in the middle when the pull begins, not when half of it is over.
        plan.stroke_mm = [0.0; 2];
        let slips_at_n = resolved.object.mu_static * base_n;
        plan.pull_limit =
            Some(PullLimit { pull_n: strength * slips_at_n, twist_n_mm: strength * slips_at_n * radius_mm });
        let frame = |t: f64| (t * FRAME_RATE_HZ as f64) as usize;
        let mut plant = Self {
            resolved,
            plan: plan.clone(),
            planned: plan,
            motions_s: Vec::new(),
            target_n: base_n,
            frames,
            held_s: (grasp.held, grasp.release),
            pulled: frame(pull.start_s)..frame(settle.end_s()).min(frames),
            piezo: Vec::new(),
            fingers: Vec::new(),
            delivered: 0,
        };
        plant.predict();
        Ok(plant)
    }

    /// Frames from open jaws to open jaws.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// Instrumented fingers.
    pub fn sensors(&self) -> usize {
        self.resolved.recipe.sensors
    }

    /// Frames while a hand pulls, and stands still after that.
    pub fn pulled(&self) -> Range<usize> {
        self.pulled.clone()
    }

    /// Times between which commands may move the gripper, seconds.
    pub fn held_s(&self) -> (f64, f64) {
        self.held_s
    }

    /// Scans and samples of the next tick; `None` after the last.
    pub fn step(&mut self) -> Option<Frame<'_>> {
        let index = self.delivered;
        if index == self.frames {
            return None;
        }
        self.delivered += 1;
        let sensors = self.resolved.recipe.sensors;
        let mut inputs = [SensorInput::default(); MAX_SENSORS];
        for (sensor, finger) in self.fingers.iter().enumerate() {
            let end = |frame: usize| finger.xl_end[frame] as usize;
            inputs[sensor] = SensorInput {
                piezo: Some(&self.piezo[index * sensors + sensor]),
                xl: Some(&finger.xl[index.checked_sub(1).map_or(0, end)..end(index)]),
                xl_end: finger.xl_end[index],
            };
        }
        Some(Frame { index, sensors, inputs })
    }

    /// Earliest time at which a command can act, seconds.
    pub fn earliest_s(&self) -> f64 {
        self.delivered as f64 / FRAME_RATE_HZ as f64 + NOT_BEFORE_S
    }

    /// Move the fingers so that each grips with `grip_n` at `end_s`, from the force that there is at `start_s`.
    pub fn command(&mut self, start_s: f64, end_s: f64, grip_n: f64) -> Result<(), CommandError> {
        if !(GRIP_N.0..=GRIP_N.1).contains(&grip_n) {
            return Err(CommandError::Grip(grip_n));
        }
        let (from_s, to_s) = self.held_s;
        if !(from_s <= start_s && start_s < end_s && end_s < to_s) {
            return Err(CommandError::Outside { start_s, end_s, from_s, to_s });
        }
        let earliest_s = self.earliest_s();
        if start_s < earliest_s {
            return Err(CommandError::Past { start_s, earliest_s });
        }
        let timeline = &mut self.plan.timeline;
        let before_n = vibration::at(&timeline.grip_n, start_s);
        for (i, t) in timeline.times(start_s, f64::INFINITY) {
            let let_go = self.planned.timeline.grip_n[i] / self.planned.base_n;
            timeline.grip_n[i] = let_go * (before_n + (grip_n - before_n) * ramp(t, start_s, end_s));
        }
        let mut rng = stream(self.resolved.recipe.seed, Stream::Motion, self.motions_s.len());
        // Against closing.
        let vigour = rng.between(0.3, 0.8);
        let motors = self.resolved.recipe.platform == Platform::Tesollo;
        timeline.travel(&mut rng, (start_s, end_s), vigour, motors);
        self.motions_s.push(start_s);
        self.target_n = grip_n;
        self.predict();
        Ok(())
    }

    /// Force of one finger that the last command ends at, newtons.
    pub fn target_n(&self) -> f64 {
        self.target_n
    }

    pub fn grip_n(&self, t_s: f64) -> f64 {
        vibration::at(&self.plan.timeline.grip_n, t_s)
    }

    /// Way that the object has slid over the fingers at a tick, mean over them, mm.
    pub fn slid_mm(&self, frame: usize) -> f64 {
        self.mean(|finger| finger.path_mm[frame])
    }

    /// First frame up to the gripper's letting go at which the object is lost: it has slid [`LOST_MM`] since the
    /// pull began, turned in the grip by [`LOST_TURN_RAD`] (means over the fingers), or left a finger.
    pub fn lost_at(&self) -> Option<usize> {
        let start = self.slid_mm(self.pulled.start);
        self.pulled().find(|&frame| {
            self.slid_mm(frame) - start > LOST_MM
                || self.mean(|finger| finger.turn_rad[frame].abs()) > LOST_TURN_RAD
                || self.fingers.iter().any(|finger| !finger.loaded[frame])
        })
    }

    /// Frames of the pull in which the interface slips as a whole ([`interface_intervals`]): past ones, and those to
    /// come unless a command prevents them.
    pub fn slips(&self) -> Vec<Range<usize>> {
        let speed_mm_s = mean(&self.fingers, |f| &f.slip_mm_s);
        let fraction = mean(&self.fingers, |f| &f.fraction);
        interface_intervals(&speed_mm_s, &fraction, self.pulled(), GAP_FRAMES)
    }

    fn mean(&self, of: impl Fn(&Finger) -> f64) -> f64 {
        self.fingers.iter().map(of).sum::<f64>() / self.fingers.len() as f64
    }

    fn predict(&mut self) {
        // What is drawn once is drawn of the plan, which no command changes.
        let mut setup = EpisodeSetup::draw(&self.resolved, &self.planned, self.frames);
        setup.plan = &self.plan;
        setup.sources_apart = true;
        for (motion, &start_s) in self.motions_s.iter().enumerate() {
            let mut rng = stream(self.resolved.recipe.seed, Stream::Motion, motion);
            // Beyond what else the motion draws.
            rng.set_word_pos(1 << 16);
            setup.vibration.handling.moves_again(&mut rng, self.resolved.recipe.platform, start_s);
        }
        let sensors = self.resolved.recipe.sensors;
        let mut piezo = vec![PiezoFrame::zeroed(); self.frames * sensors];
        let mut log = DrawLog::default();
        self.fingers = (0..sensors).map(|sensor| setup.finger(sensor, &mut piezo, &mut log)).collect();
        self.piezo = piezo;
    }
}

const _: () = assert!(STEPS as f64 * FRAME_RATE_HZ as f64 == STEP_HZ);
