//! What happens in an episode: when the jaws close, how hard they grip, what pulls, what knocks.
//! All scenarios share one skeleton with durations of their own draw, so that no clock predicts slip.

use crate::draw::{Draw, Rng};
use crate::friction::STEP_HZ;
use crate::recipe::{Resolved, ScenarioChoice};
use crate::timeline::Timeline;
use libm::exp;

/// The course of an episode. Series have [`STEP_HZ`] values per second.
pub(crate) struct Plan {
    pub seconds: f64,
    pub timeline: Timeline,
    /// Far end of the spring that pulls the object, and its stiffness (0: nothing pulls).
    pub pull_mm: Vec<f64>,
    pub pull_n_per_mm: f64,
    /// Grip force before the operator changes it, newtons.
    pub base_n: f64,
    /// The gripper stands still and the object is linked to the crosshead: the encoder tells slip.
    pub encoder_rule: bool,
    /// The crosshead's vibration comes through the object.
    pub linked: bool,
    pub hand_held: bool,
    /// Crosshead travel of the slip, mm.
    pub stroke_mm: f64,
}

/// Median, spread and range of the grip force of one finger, newtons (field decision D-7).
const GRIP_N: (f64, f64, f64, f64) = (2.2, 0.55, 0.4, 10.0);

/// Durations of the skeleton, seconds.
struct Phases {
    idle: f64,
    closing: f64,
    rise: f64,
    vary: f64,
    moving: f64,
    after: f64,
    fall: f64,
    opening: f64,
    rest: f64,
}

impl Phases {
    fn draw(rng: &mut Rng, seconds: Option<f64>, longest_move: f64) -> Self {
        let mut p = Self {
            idle: rng.between(0.4, 1.6),
            closing: rng.between(0.2, 0.5),
            rise: rng.between(0.08, 0.3),
            vary: rng.between(0.25, 1.4),
            moving: rng.between(1.6, 3.6).min(longest_move),
            after: rng.between(0.15, 0.7),
            fall: rng.between(0.05, 0.15),
            opening: rng.between(0.2, 0.45),
            rest: rng.between(0.5, 1.6),
        };
        if let Some(seconds) = seconds {
            let fixed = p.closing + p.rise + p.fall + p.opening;
            let flexible = p.idle + p.vary + p.moving + p.after + p.rest;
            let scale = (seconds - fixed) / flexible;
            p.idle *= scale;
            p.vary *= scale;
            p.moving = (p.moving * scale).min(longest_move);
            p.after *= scale;
            p.rest = seconds - fixed - p.idle - p.vary - p.moving - p.after;
        }
        p
    }

    fn total(&self) -> f64 {
        self.idle
            + self.closing
            + self.rise
            + self.vary
            + self.moving
            + self.after
            + self.fall
            + self.opening
            + self.rest
    }
}

pub(crate) fn plan(rng: &mut Rng, what: &Resolved, seconds: Option<f64>) -> Plan {
    match what.scenario {
        ScenarioChoice::FreeGrasp => free_grasp(rng, what, seconds),
        _ => on_the_rig(rng, what, seconds),
    }
}

fn grip(rng: &mut Rng) -> f64 {
    (GRIP_N.0 * exp(GRIP_N.1 * rng.normal())).clamp(GRIP_N.2, GRIP_N.3)
}

fn on_the_rig(rng: &mut Rng, what: &Resolved, seconds: Option<f64>) -> Plan {
    let speed = what.speed_mm_s;
    let p = Phases::draw(rng, seconds, what.object.shape.travel_mm() / speed);
    let mut line = Timeline::new(p.total());
    let touch = p.idle + p.closing;
    let (held, moves) = (touch + p.rise, touch + p.rise + p.vary);
    let (stops, release) = (moves + p.moving, moves + p.moving + p.after);
    let base = grip(rng);
    let accel = rng.log_between(50.0, 500.0);

    let empty = what.scenario == ScenarioChoice::Empty;
    let firm = what.scenario == ScenarioChoice::FirmGrip;
    line.close(rng, p.idle, touch);
    if !empty {
        line.grip(rng, if firm { 1.3 * base } else { base }, (touch, held), (release, release + p.fall));
        line.grip_changes(rng, (held, moves), 0.8);
        line.grip_changes(rng, (moves, stops), if firm { 0.8 } else { 0.3 });
        line.grip_changes(rng, (stops, release), 0.3);
    }
    line.open(rng, release + p.fall, release + p.fall + p.opening, !empty);
    line.event("move", moves, stops);
    let (turn, back) = (moves + 0.4 * p.moving, moves + 0.6 * p.moving);
    let stroke_mm = if firm {
        // Pull, hold, let go again, so that opening the jaws does not release a stretched mount.
        line.crosshead(moves, turn, speed, accel);
        line.crosshead(back, stops, -speed, accel)
    } else {
        line.crosshead(moves, stops, speed, accel)
    };
    if rng.chance(0.65) {
        for (from, to) in [(0.0, p.idle), (held, moves), (stops, release), (p.total() - p.rest, p.total())] {
            line.taps(rng, from, to, 0.35);
        }
    }
    if what.scenario == ScenarioChoice::Unlinked && rng.chance(0.5) {
        line.drag(rng, held, release);
    }

    let (pull_mm, pull_n_per_mm) = match what.scenario {
        ScenarioChoice::SixStep => (line.crosshead_mm.clone(), rng.log_between(10.0, 100.0)),
        ScenarioChoice::FirmGrip => {
            let reach = line.crosshead_mm.iter().fold(1e-3f64, |a, &x| a.max(x));
            let share = rng.between(0.25, 0.6);
            (line.crosshead_mm.clone(), share * sure_hold_n(what, &line, held, release) / reach)
        }
        _ => (vec![0.0; line.steps()], 0.0),
    };
    Plan {
        seconds: p.total(),
        timeline: line,
        base_n: base,
        pull_mm,
        pull_n_per_mm,
        encoder_rule: what.scenario == ScenarioChoice::SixStep,
        linked: matches!(what.scenario, ScenarioChoice::SixStep | ScenarioChoice::FirmGrip),
        hand_held: false,
        stroke_mm: if what.scenario == ScenarioChoice::SixStep { stroke_mm } else { 0.0 },
    }
}

/// Tangential force that the weakest grip between two times holds for sure, newtons.
fn sure_hold_n(what: &Resolved, line: &Timeline, from: f64, to: f64) -> f64 {
    let steps = (from * STEP_HZ) as usize..((to * STEP_HZ) as usize).min(line.steps());
    let weakest = line.grip_n[steps].iter().fold(f64::INFINITY, |a, &f| a.min(f));
    // Cells differ in friction by 10 % and objects by 8 %; the weakest finger counts.
    0.75 * what.object.mu_kinetic * weakest
}

fn free_grasp(rng: &mut Rng, what: &Resolved, seconds: Option<f64>) -> Plan {
    let grasps = if seconds.is_some_and(|s| s < 6.0) { 1 } else { rng.count(1, 2) };
    let share = seconds.map(|s| s / grasps as f64);
    let phases: Vec<Phases> = (0..grasps).map(|_| Phases::draw(rng, share, 1.5)).collect();
    let total = phases.iter().map(Phases::total).sum();
    let mut line = Timeline::new(total);
    let mut pull_n = vec![0.0; line.steps()];
    let mut start = 0.0;
    for p in &phases {
        let touch = start + p.idle + p.closing;
        let held = touch + p.rise;
        let release = held + p.vary + p.moving + p.after;
        let base = grip(rng);
        line.close(rng, start + p.idle, touch);
        line.grip(rng, base, (touch, held), (release, release + p.fall));
        line.grip_changes(rng, (held, release), 0.7);
        line.open(rng, release + p.fall, release + p.fall + p.opening, true);
        // Lift after a quarter, set down before the release: the weight hangs in between.
        let (lift, down) = (held + 0.25 * (release - held), held + 0.85 * (release - held));
        let weight = rng.between(0.2, 0.6) * sure_hold_n(what, &line, held, release);
        line.knock(rng, "lift", lift, 0.05, 0.3);
        line.knock(rng, "set_down", down, 0.1, 1.0);
        let ramp = rng.between(0.05, 0.2);
        for (i, n) in pull_n.iter_mut().enumerate() {
            let t = i as f64 / STEP_HZ;
            let up = ((t - lift) / ramp).clamp(0.0, 1.0);
            *n += weight * up.min(((down - t) / ramp).clamp(0.0, 1.0));
        }
        line.taps(rng, held, release, 0.6);
        if rng.chance(0.4) {
            line.drag(rng, lift, down);
        }
        start += p.total();
    }
    line.taps(rng, 0.0, total, 0.4);
    // A weight is a soft spring pulled far.
    let soft = 0.05;
    Plan {
        seconds: total,
        base_n: GRIP_N.0,
        pull_mm: pull_n.iter().map(|n| n / soft).collect(),
        pull_n_per_mm: soft,
        timeline: line,
        encoder_rule: false,
        linked: false,
        hand_held: true,
        stroke_mm: 0.0,
    }
}
