//! What happens in an episode: when the jaws close, how hard they grip, what pulls, what hits.
//!
//! A [`Script`] says what follows what; [`plan`] writes it into series. Recordings are cut out of a longer
//! sequence, with durations of their own, so that no clock predicts slip.

pub(crate) mod direction;
pub(crate) mod levels;
pub(crate) mod script;
#[cfg(test)]
pub(crate) mod shortcuts;
mod disturbances;

use libm::{atan2, cos, exp, sin};
use serde::Serialize;

use crate::draw::{Draw, Rng};
use crate::friction::STEP_HZ;
use crate::labels::Rule;
use crate::mix::ScenarioChoice;
use crate::pulling_hand::PullLimit;
use crate::recipe::{Platform, ResolvedRecipe};
use crate::timeline::{Timeline, ramp, swing};
use direction::{SlipDirection, VERTICAL_WITHIN_DEG, unit_vector};
use disturbances::Disturbances;
use levels::*;
use script::{Phase, PhaseKind, Script};

/// What happens in an episode. Series have [`STEP_HZ`] values per second.
#[derive(Clone, Serialize)]
pub(crate) struct Plan {
    pub script: Script,
    #[serde(skip)]
    pub timeline: Timeline,
    /// Far end of the spring that pulls the object, in pad x and y of the first finger, mm.
    #[serde(skip)]
    pub pull_mm: Vec<[f64; 2]>,
    /// Far end of the spring that twists it, rad; empty where nothing does.
    #[serde(skip)]
    pub turn_rad: Vec<f64>,
    /// Stiffness of the pulling spring of one finger (0: nothing pulls).
    pub pull_n_per_mm: f64,
    pub twist_n_mm_per_rad: f64,
    /// The most that a hand pulls with; none where it moves on as hard as it has to.
    #[serde(skip)]
    pub pull_limit: Option<PullLimit>,
    /// Grip force of the first grasp before the operator changes it, newtons.
    pub base_n: f64,
    pub rule: Rule,
    /// When something pulls so that the object slips, with the standstill after it, seconds.
    pub slips: Vec<(f64, f64)>,
    /// The crosshead's vibration comes through the object while that is held.
    pub linked: bool,
    /// The gripper stands on the rig's table: the crosshead's vibration is as loud without the object.
    pub shared_table: bool,
    /// A hand holds the gripper: it sways, and there is no rig.
    pub hand_held: bool,
    /// Way of the object over the pad in a slip, mm.
    pub stroke_mm: [f64; 2],
    /// Interference of running motors in the arrays, counts rms.
    pub motor_pickup_counts: f64,
}

/// One grasp: times at which its phases begin, and where it ends.
pub(crate) struct Grasp {
    close: f64,
    pub touch: f64,
    pub held: f64,
    pub release: f64,
    pub let_go: f64,
    open: f64,
}

pub(crate) fn grasps(script: &Script) -> Vec<Grasp> {
    let ends = script.phases_of(PhaseKind::Fall).zip(script.phases_of(PhaseKind::Open));
    let starts = script.phases_of(PhaseKind::Close).zip(script.phases_of(PhaseKind::Rise));
    starts
        .zip(ends)
        .map(|((close, rise), (fall, open))| Grasp {
            close: close.start_s,
            touch: rise.start_s,
            held: rise.end_s(),
            release: fall.start_s,
            let_go: open.start_s,
            open: open.end_s(),
        })
        .collect()
}

pub(crate) fn plan(rng: &mut Rng, resolved: &ResolvedRecipe, script: Script) -> Plan {
    use ScenarioChoice as S;
    let on_rig = resolved.scenario.on_rig();
    let motors = resolved.recipe.platform == Platform::Tesollo;
    let linked = matches!(resolved.scenario, S::SixStep | S::FirmGrip)
        || (resolved.scenario == S::RigMotion && rng.chance(RIG_MOTION_LINKED));
    let disturbances = Disturbances {
        motors,
        carried: !on_rig,
        loose: matches!(resolved.scenario, S::Unlinked | S::FreeGrasp | S::HandHeld | S::Disturbances),
        factor: if resolved.scenario == S::Disturbances { DISTURBANCES_FACTOR } else { 1.0 },
    };
    let mut timeline = Timeline::new(script.seconds);
    for s in &script.phases {
        if s.kind == PhaseKind::Jog || (s.kind == PhaseKind::Pull && on_rig) {
            timeline.crosshead(&script.motion, s.towards, (s.start_s, s.end_s()));
        } else if s.kind == PhaseKind::Pull {
            timeline.event("pull", s.start_s, s.end_s());
        }
    }

    let stiffness = if on_rig { RIG_N_PER_MM } else { HAND_N_PER_MM };
    let mut plan = Plan {
        pull_n_per_mm: rng.log_uniform(stiffness),
        twist_n_mm_per_rad: rng.log_uniform(TWIST_N_MM_PER_RAD),
        pull_limit: None,
        base_n: GRIP_MEDIAN_N,
        rule: if on_rig { Rule::Encoder } else { Rule::Interface },
        slips: Vec::new(),
        linked,
        shared_table: on_rig && rng.chance(SHARED_TABLE),
        hand_held: !on_rig,
        stroke_mm: [0.0; 2],
        motor_pickup_counts: if motors { rng.log_uniform(MOTOR_PICKUP_COUNTS) } else { 0.0 },
        pull_mm: Vec::new(),
        turn_rad: Vec::new(),
        timeline,
        script,
    };
    let held = grasps(&plan.script);
    plan.grip(rng, resolved, &held, &disturbances);
    disturbances.anywhere(rng, &mut plan.timeline, plan.script.seconds);
    if resolved.slips() {
        let settles: Vec<_> = plan.script.phases_of(PhaseKind::Settle).map(Phase::end_s).collect();
        let until = |t: f64| settles.iter().copied().find(|&s| s > t).unwrap_or(t);
        plan.slips = plan.script.phases_of(PhaseKind::Pull).map(|s| (s.start_s, until(s.end_s()))).collect();
    }
    plan.pull(rng, resolved, &held);
    plan
}

impl Plan {
    /// The way in which the object slips over the pad; none where it does not.
    pub(crate) fn slip_direction(&self, resolved: &ResolvedRecipe) -> Option<SlipDirection> {
        if !resolved.slips() {
            return None;
        }
        let [x, y] = self.stroke_mm;
        Some(match resolved.scenario {
            ScenarioChoice::Rotation => SlipDirection::Rotational,
            _ if atan2(x, y).to_degrees().abs() <= VERTICAL_WITHIN_DEG => SlipDirection::Vertical,
            _ => SlipDirection::OtherInPlane,
        })
    }

    /// Jaws, grip force and its changes, and what else disturbs a held object.
    fn grip(
        &mut self,
        rng: &mut Rng,
        resolved: &ResolvedRecipe,
        grasps: &[Grasp],
        disturbances: &Disturbances,
    ) {
        let object = !resolved.scenario.empty();
        let most_n = self.gives_way_n(resolved);
        if let Some(named) = resolved.recipe.grip_n.filter(|&named| named > most_n) {
            // All forces of the pull grow alike, so that it reaches the slip as surely as with a drawn grip.
            self.pull_n_per_mm *= named / most_n;
            self.twist_n_mm_per_rad *= named / most_n;
        }
        let timeline = &mut self.timeline;
        for (n, g) in grasps.iter().enumerate() {
            let drawn = (GRIP_MEDIAN_N * exp(GRIP_SPREAD * rng.normal())).clamp(GRIP_N.0, GRIP_N.1);
            let base = resolved.recipe.grip_n.unwrap_or(drawn.min(most_n).max(GRIP_N.0));
            if n == 0 {
                self.base_n = base;
            }
            timeline.close(rng, (g.close, g.touch), object, disturbances.motors);
            if object {
                timeline.grip(rng, base, (g.touch, g.held), (g.release, g.let_go));
                for s in self.script.phases.iter().filter(|s| (g.held..g.release).contains(&s.start_s)) {
                    let inside = (s.start_s, s.end_s());
                    let per_s =
                        if s.kind == PhaseKind::Hold { GRIP_CHANGES_PER_S.0 } else { GRIP_CHANGES_PER_S.1 };
                    for at in rng.moments(inside, per_s, disturbances::LEAST) {
                        timeline.grip_change(rng, at, inside, g.let_go);
                    }
                    if !(s.kind == PhaseKind::Pull && resolved.slips()) {
                        disturbances.while_held(rng, timeline, inside, g.open);
                    }
                }
            }
            timeline.open(rng, (g.let_go, g.open), disturbances.motors);
        }
    }

    /// Base grip that surely lets the object slip before half the pull is over, newtons.
    fn gives_way_n(&self, resolved: &ResolvedRecipe) -> f64 {
        if !resolved.slips() {
            return GRIP_N.1;
        }
        let shortest = self.script.pulls_mm().map(f64::abs).fold(f64::INFINITY, f64::min);
        let force = if resolved.scenario == ScenarioChoice::Rotation {
            // The spring's torque over the patch's lever.
            self.twist_n_mm_per_rad * shortest / resolved.twist_radius_mm() / resolved.twist_radius_mm()
        } else {
            self.pull_n_per_mm * shortest
        };
        // Static friction may be a quarter above the object's, and a squeeze doubles the force.
        0.5 * force / (1.25 * resolved.object.mu_static * 2.0)
    }

    /// Tangential force that the weakest grip between two times holds for sure, newtons.
    fn sure_hold_n(&self, resolved: &ResolvedRecipe, from: f64, to: f64) -> f64 {
        let weakest =
            self.timeline.grip_n[self.timeline.span(from, to)].iter().fold(f64::INFINITY, |a, &f| a.min(f));
        // Cells differ in friction by 10 % and objects by 8 %; the weakest finger counts.
        0.75 * resolved.object.mu_kinetic * weakest
    }

    fn pull(&mut self, rng: &mut Rng, resolved: &ResolvedRecipe, grasps: &[Grasp]) {
        use ScenarioChoice as S;
        let angle = rng.phase();
        // The rig pulls along the pad only.
        let towards = match resolved.recipe.pull_angle_deg {
            _ if resolved.scenario.on_rig() => [0.0, 1.0],
            Some(named_deg) => unit_vector(named_deg),
            None => [cos(angle), sin(angle)],
        };
        let timeline = &self.timeline;
        let mut way = vec![0.0; timeline.steps()];
        match resolved.scenario {
            S::SixStep => way.copy_from_slice(&timeline.crosshead_mm),
            S::FirmGrip => {
                way.copy_from_slice(&timeline.crosshead_mm);
                let reach = self.script.pulls_mm().map(f64::abs).fold(1e-3, f64::max);
                let hold = grasps.iter().map(|g| self.sure_hold_n(resolved, g.held, g.release));
                self.pull_n_per_mm = rng.uniform(FIRM_PULL) * hold.fold(f64::INFINITY, f64::min) / reach;
            }
            S::FreePull => self.by_hand(rng, &mut way),
            S::Rotation => {
                self.by_hand(rng, &mut way);
                self.turn_rad = way.iter().map(|mm| mm / resolved.twist_radius_mm()).collect();
                // What twists also keeps the object where it is.
                way.fill(0.0);
            }
            S::FreeGrasp | S::HandHeld | S::Disturbances => {
                self.weights(rng, resolved, grasps, &mut way);
                if resolved.slips() {
                    self.by_hand(rng, &mut way);
                }
            }
            S::Empty | S::CarriedEmpty | S::Unlinked | S::RigMotion | S::Random => self.pull_n_per_mm = 0.0,
        }
        if resolved.scenario != S::Rotation {
            self.twist_n_mm_per_rad = 0.0;
        }
        if resolved.slips() && resolved.scenario != S::Rotation {
            let stroke = self.script.pulls_mm().fold(0.0, f64::max);
            self.stroke_mm = towards.map(|t| t * stroke);
        }
        self.pull_mm = way.iter().map(|&mm| towards.map(|t| t * mm)).collect();
    }

    /// Pulls by hand: the way of the script at a speed that wavers by up to a half.
    fn by_hand(&self, rng: &mut Rng, way: &mut [f64]) {
        for s in self.script.phases_of(PhaseKind::Pull) {
            let waver: [_; 2] =
                std::array::from_fn(|_| (rng.between(0.5, 4.0), rng.phase(), rng.between(0.0, 0.3)));
            let times: Vec<_> = self.timeline.times(s.start_s, s.end_s()).collect();
            let mut speeds: Vec<f64> = times
                .iter()
                .map(|&(_, t)| {
                    let (motion, since) = (&self.script.motion, t - s.start_s);
                    (motion.at(since + 1.0 / STEP_HZ, s.seconds) - motion.at(since, s.seconds))
                        * (1.0 + swing(&waver, t))
                })
                .collect();
            let scale = self.script.travel_mm(s) / speeds.iter().sum::<f64>().max(1e-9);
            speeds.iter_mut().for_each(|v| *v *= scale);
            let mut moved = 0.0;
            for ((i, _), step) in times.iter().zip(&speeds) {
                moved += step;
                way[*i] += moved;
            }
            if let Some(&(last, _)) = times.last() {
                way[last + 1..].iter_mut().for_each(|w| *w += moved);
            }
        }
    }

    /// The object's weight hangs between lift and set-down of each grasp, by a soft spring; what it is dragged over
    /// pulls the same way.
    fn weights(&mut self, rng: &mut Rng, resolved: &ResolvedRecipe, grasps: &[Grasp], way: &mut [f64]) {
        for g in grasps {
            let last = self.script.phases_of(PhaseKind::Hold).filter(|s| s.start_s < g.release).last();
            let end = last.map_or(g.release, Phase::end_s);
            let length = end - g.held;
            let (lift, down) =
                (g.held + rng.between(0.1, 0.3) * length, g.held + rng.between(0.75, 0.92) * length);
            let sure_hold_n = self.sure_hold_n(resolved, g.held, g.release);
            let (weight, drag) = (rng.uniform(WEIGHT_SHARE), rng.uniform(DRAG_SHARE));
            for (name, at, peak) in [("lift", lift, (0.05, 0.3)), ("set_down", down, (0.1, 1.0))] {
                self.timeline.event(name, at, at + 0.02);
                self.timeline.pulse(rng, at, TAP_S, peak);
            }
            let rise = rng.between(0.05, 0.2);
            for (i, t) in self.timeline.times(g.held, g.release) {
                let hangs = ramp(t, lift, lift + rise) * (1.0 - ramp(t, down - rise, down));
                let share = weight * hangs + drag * self.timeline.drag[i];
                way[i] += share * sure_hold_n / self.pull_n_per_mm;
            }
        }
    }
}
