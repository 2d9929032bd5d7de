//! A recording as a sequence of phases: what follows what and how long it takes. Cheap to
//! draw, and all that is needed to know how long an episode is.

use serde::Serialize;

use crate::draw::{Draw, Rng};
use crate::mix::ScenarioChoice;
use crate::recipe::ResolvedRecipe;
use crate::scenario::levels::*;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum PhaseKind {
    /// Jaws open, nothing moves.
    Idle,
    /// Jaws open, the crosshead moves.
    Jog,
    Close,
    /// Jaws have met the object, the force builds up.
    Rise,
    /// The object is held and the operator varies the force.
    Hold,
    /// Crosshead or hand moves while the jaws are closed.
    Pull,
    /// The object is held after that.
    Settle,
    /// The force falls to nothing.
    Fall,
    Open,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Phase {
    pub kind: PhaseKind,
    /// Seconds from the start of the recording; negative if it began before.
    pub start_s: f64,
    pub seconds: f64,
    /// Sign of a movement, 0 for none.
    pub towards: f64,
}

impl Phase {
    pub(crate) fn end_s(&self) -> f64 {
        self.start_s + self.seconds
    }
}

/// Movement at a speed with equal acceleration and deceleration.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Trapezoid {
    pub speed_mm_s: f64,
    pub accel_mm_s2: f64,
}

impl Trapezoid {
    /// Time to move `mm`; short ways never reach the speed.
    pub(crate) fn seconds(&self, mm: f64) -> f64 {
        let (v, a) = (self.speed_mm_s, self.accel_mm_s2);
        if mm > v * v / a { mm / v + v / a } else { 2.0 * (mm / a).sqrt() }
    }

    /// Way moved within `seconds` from standstill to standstill.
    pub(crate) fn mm(&self, seconds: f64) -> f64 {
        let ramp_s = (self.speed_mm_s / self.accel_mm_s2).min(seconds / 2.0);
        self.accel_mm_s2 * ramp_s * (seconds - ramp_s)
    }

    /// Way moved `t` seconds after the start of a movement that takes `seconds`.
    pub(crate) fn at(&self, t: f64, seconds: f64) -> f64 {
        let ramp_s = (self.speed_mm_s / self.accel_mm_s2).min(seconds / 2.0);
        let (t, a) = (t.clamp(0.0, seconds), self.accel_mm_s2);
        if t < ramp_s {
            0.5 * a * t * t
        } else if t < seconds - ramp_s {
            a * ramp_s * (t - ramp_s / 2.0)
        } else {
            self.mm(seconds) - 0.5 * a * (seconds - t) * (seconds - t)
        }
    }
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Script {
    #[serde(rename = "stretches")]
    pub phases: Vec<Phase>,
    pub seconds: f64,
    pub motion: Trapezoid,
}

impl Script {
    /// Of the length that the recipe names, or cut out of a longer sequence at points where nothing touches.
    pub(crate) fn draw(rng: &mut Rng, resolved: &ResolvedRecipe) -> Self {
        let motion = Trapezoid { speed_mm_s: resolved.speed_mm_s, accel_mm_s2: rng.log_uniform(ACCEL_MM_S2) };
        let disturbances = resolved.scenario == ScenarioChoice::Disturbances;
        let open = disturbances.then(|| rng.log_uniform(DISTURBANCES_S));
        let length = resolved.recipe.seconds.or(open);
        let mut phases = run(rng, resolved, &motion);
        if let Some(seconds) = length {
            loop {
                let next = run(rng, resolved, &motion);
                if duration_s(&phases) + duration_s(&next) > seconds {
                    break;
                }
                phases.extend(next);
            }
            fit(&mut phases, seconds);
            return Self::from_phases(phases, 0.0, seconds, motion);
        }
        let again = run(rng, resolved, &motion);
        if rng.chance(REPEAT_CHANCE) && duration_s(&phases) + duration_s(&again) < REPEAT_LONGEST_S {
            phases.extend(again);
        }
        let idle = |s: &&Phase| matches!(s.kind, PhaseKind::Idle | PhaseKind::Jog);
        let lead: f64 = phases.iter().take_while(idle).map(|s| s.seconds).sum();
        let tail: f64 = phases.iter().rev().take_while(idle).map(|s| s.seconds).sum();
        let from = rng.between(0.0, lead - IDLE_S.0);
        let to = duration_s(&phases) - rng.between(0.0, tail - IDLE_S.0);
        Self::from_phases(phases, from, to - from, motion)
    }

    /// One grasp of an object that a hand pulls `travel_mm` far when it is held, from open jaws to open jaws.
    pub(crate) fn trial(rng: &mut Rng, resolved: &ResolvedRecipe, travel_mm: f64) -> Self {
        use PhaseKind::*;
        let motion = Trapezoid { speed_mm_s: resolved.speed_mm_s, accel_mm_s2: rng.log_uniform(ACCEL_MM_S2) };
        let mut phases = Vec::new();
        let mut add = |kind, seconds, towards| phases.push(Phase { kind, start_s: 0.0, seconds, towards });
        let twists_back = resolved.scenario == ScenarioChoice::Rotation && rng.chance(0.5);
        add(Idle, rng.between(IDLE_S.0, IDLE_UNIFORM_S), 0.0);
        add(Close, rng.log_uniform(CLOSE_S), 0.0);
        add(Rise, rng.log_uniform(RISE_S), 0.0);
        add(Hold, rng.log_uniform(VARY_S), 0.0);
        add(Pull, motion.seconds(travel_mm), if twists_back { -1.0 } else { 1.0 });
        add(Settle, SETTLE_S.1, 0.0);
        add(Fall, rng.log_uniform(FALL_S), 0.0);
        add(Open, rng.log_uniform(OPEN_S), 0.0);
        add(Idle, IDLE_S.0, 0.0);
        let seconds = duration_s(&phases);
        Self::from_phases(phases, 0.0, seconds, motion)
    }

    fn from_phases(mut phases: Vec<Phase>, from_s: f64, seconds: f64, motion: Trapezoid) -> Self {
        let mut at = -from_s;
        for phase in &mut phases {
            phase.start_s = at;
            at += phase.seconds;
        }
        phases.retain(|s| s.end_s() > 0.0 && s.start_s < seconds);
        Self { phases, seconds, motion }
    }

    pub(crate) fn phases_of(&self, kind: PhaseKind) -> impl Iterator<Item = &Phase> {
        self.phases.iter().filter(move |s| s.kind == kind)
    }

    /// Way of the crosshead or hand in one phase, with its sign.
    pub(crate) fn travel_mm(&self, phase: &Phase) -> f64 {
        phase.towards * self.motion.mm(phase.seconds)
    }

    pub(crate) fn pulls_mm(&self) -> impl Iterator<Item = f64> {
        self.phases_of(PhaseKind::Pull).map(|pull| self.travel_mm(pull))
    }
}

fn duration_s(phases: &[Phase]) -> f64 {
    phases.iter().map(|s| s.seconds).sum()
}

/// Make a phases last `seconds`: longer by its idles and holds; shorter by leaving out the crosshead's idle
/// moves, then by shrinking what has no duration of its own, of which pulls keep up to [`PULL_SHARE_KEPT`].
fn fit(phases: &mut Vec<Phase>, seconds: f64) {
    use PhaseKind::{Hold, Idle, Jog, Pull, Settle};
    if duration_s(phases) > seconds {
        phases.retain(|s| s.kind != Jog);
    }
    let rests = |s: &Phase| matches!(s.kind, Idle | Hold | Settle);
    let pulls = |s: &Phase| s.kind == Pull;
    let sum = |phases: &[Phase], of: &dyn Fn(&Phase) -> bool| -> f64 {
        phases.iter().filter(|s| of(s)).map(|s| s.seconds).sum()
    };
    let (resting, pulling) = (sum(phases, &rests), sum(phases, &pulls));
    let room = seconds - (duration_s(phases) - resting - pulling);
    let pulled = pulling.min((PULL_SHARE_KEPT * room).max(room - resting));
    for s in phases {
        if pulls(s) {
            s.seconds *= pulled / pulling;
        } else if rests(s) {
            s.seconds *= (room - pulled) / resting;
        }
    }
}

fn idle(rng: &mut Rng) -> f64 {
    if rng.chance(0.5) {
        rng.between(IDLE_S.0, IDLE_UNIFORM_S)
    } else {
        (IDLE_S.0 + rng.exponential(1e-9) * IDLE_MEAN_S).min(IDLE_S.1)
    }
}

/// One pass through the scenario, from open jaws to open jaws.
fn run(rng: &mut Rng, resolved: &ResolvedRecipe, motion: &Trapezoid) -> Vec<Phase> {
    use PhaseKind::*;
    use ScenarioChoice as S;
    let mut phases = Vec::new();
    let mut add = |kind, seconds, towards| phases.push(Phase { kind, start_s: 0.0, seconds, towards });
    let on_rig = resolved.scenario.on_rig();
    let stroke = rng.uniform(STROKE_MM).min(resolved.object.shape.travel_mm());
    let jog_s = motion.seconds(stroke);
    let home_s = motion.seconds(stroke * rng.uniform(PARKING_TRAVEL));

    add(Idle, idle(rng), 0.0);
    if on_rig || (resolved.scenario == S::Disturbances && rng.chance(0.3)) {
        add(Jog, home_s, -1.0);
        add(Idle, idle(rng), 0.0);
    }
    add(Close, rng.log_uniform(CLOSE_S), 0.0);
    add(Rise, rng.log_uniform(RISE_S), 0.0);
    let vary = rng.log_uniform(VARY_S);
    match resolved.scenario {
        S::FirmGrip => {
            let pull_s = motion.seconds(rng.uniform(FIRM_TRAVEL_MM));
            add(Hold, vary, 0.0);
            add(Pull, pull_s, 1.0);
            add(Hold, rng.log_uniform(SETTLE_S), 0.0);
            add(Pull, pull_s, -1.0);
        }
        S::RigMotion => {
            for _ in 0..rng.count(1, 3) {
                let towards = rng.sign();
                add(Hold, rng.log_uniform(SETTLE_S), 0.0);
                add(Pull, motion.seconds(rng.uniform(FIRM_TRAVEL_MM)), towards);
            }
        }
        S::FreePull => {
            add(Hold, vary, 0.0);
            add(Pull, motion.seconds(rng.uniform(HAND_TRAVEL_MM)), 1.0);
        }
        S::Rotation => {
            let way = rng.uniform(TWIST_RAD) * resolved.twist_radius_mm();
            add(Hold, vary, 0.0);
            add(Pull, motion.seconds(way), rng.sign());
        }
        S::FreeGrasp | S::CarriedEmpty => add(Hold, rng.log_uniform(CARRY_S), 0.0),
        S::HandHeld => {
            add(Hold, rng.log_uniform(CARRY_S), 0.0);
            if resolved.slips_at_end {
                add(Pull, motion.seconds(rng.uniform(HAND_TRAVEL_MM)), 1.0);
            }
        }
        S::Disturbances => add(Hold, rng.log_uniform(LONG_HOLD_S), 0.0),
        S::SixStep | S::Empty | S::Unlinked | S::Random => {
            add(Hold, vary, 0.0);
            add(Pull, jog_s, 1.0);
        }
    }
    add(Settle, rng.log_uniform(SETTLE_S), 0.0);
    add(Fall, rng.log_uniform(FALL_S), 0.0);
    add(Open, rng.log_uniform(OPEN_S), 0.0);
    add(Idle, idle(rng), 0.0);
    // Without its way back a moving crosshead would mean slip.
    if on_rig {
        add(Jog, home_s, 1.0);
        add(Idle, idle(rng), 0.0);
    }
    phases
}
