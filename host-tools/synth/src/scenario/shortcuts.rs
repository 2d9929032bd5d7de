//! Does anything but slip itself predict slip? Class shares of the mixes, and the likeliest class given
//! only the time since the start, or only what the rig does: it must be no contact everywhere, so that
//! neither is worth more than always answering the most frequent class. From scripts alone: nothing is simulated.

use crate::draw::{Stream, stream};
use crate::mix::{ANYWHERE, Mix, PROTOCOL, ScenarioChoice, scenario_at};
use crate::recipe::Recipe;
use crate::scenario::levels::{RIG_MOTION_LINKED, SHARED_TABLE};
use crate::scenario::script::{PhaseKind, Script};

const RECORDINGS: usize = 3000;
const HZ: f64 = 60.0;

/// A moment of a recording: class 0 no contact, 1 no slip, 2 slip; the crosshead moves; its drive is loud.
struct Moment {
    t: f64,
    class: usize,
    moves: bool,
    loud: bool,
    speed_mm_s: f64,
}

/// Moments of a recording by its script, [`HZ`] per second; `shared_table` and `linked` are drawn later.
fn moments(recipe: &Recipe, shared_table: bool, linked: bool) -> Vec<Moment> {
    let resolved = recipe.resolve().unwrap();
    let script = Script::draw(&mut stream(recipe.seed, Stream::Script, 0), &resolved);
    let linked = matches!(resolved.scenario, ScenarioChoice::SixStep | ScenarioChoice::FirmGrip)
        || (resolved.scenario == ScenarioChoice::RigMotion && linked);
    let moment = |n: usize| {
        use PhaseKind::*;
        let t = n as f64 / HZ;
        let phase = script.phases.iter().find(|phase| phase.start_s <= t && t < phase.end_s())?;
        let closed = matches!(phase.kind, Rise | Hold | Pull | Settle | Fall);
        let contact = closed && !resolved.scenario.empty();
        let travel = script.motion.mm(phase.seconds);
        let moved = script.motion.at(t - phase.start_s, phase.seconds);
        let slip = resolved.slips() && phase.kind == Pull && moved > 0.07 && travel - moved >= 0.07;
        let moves = matches!(phase.kind, Jog | Pull) && resolved.scenario.on_rig();
        Some(Moment {
            t,
            class: if contact { 1 + usize::from(slip) } else { 0 },
            moves,
            loud: moves && (shared_table || (linked && contact)),
            speed_mm_s: resolved.speed_mm_s,
        })
    };
    (0..(script.seconds * HZ) as usize).filter_map(moment).collect()
}

pub(crate) fn class_seconds(recipe: &Recipe) -> [f64; 3] {
    let mut seconds = [0.0; 3];
    moments(recipe, true, true).iter().for_each(|moment| seconds[moment.class] += 1.0 / HZ);
    seconds
}

fn shares<'a>(of: impl Iterator<Item = &'a Moment>) -> ([f64; 3], usize) {
    let mut counts = [0usize; 3];
    of.for_each(|m| counts[m.class] += 1);
    let total = counts.iter().sum::<usize>();
    (counts.map(|c| c as f64 / total.max(1) as f64), total)
}

/// Macro F1 of always answering the likeliest class of the group that a moment is in.
fn macro_f1(all: &[Moment], group: impl Fn(&Moment) -> usize) -> f64 {
    let groups = all.iter().map(&group).max().unwrap() + 1;
    let mut counts = vec![[0usize; 3]; groups];
    all.iter().for_each(|m| counts[group(m)][m.class] += 1);
    let mut confusion = [[0usize; 3]; 3];
    for of_group in &counts {
        let answer = (0..3).max_by_key(|&c| of_group[c]).unwrap();
        (0..3).for_each(|truth| confusion[truth][answer] += of_group[truth]);
    }
    let f1 = |c: usize| {
        let answered: usize = (0..3).map(|truth| confusion[truth][c]).sum();
        let there: usize = confusion[c].iter().sum();
        2.0 * confusion[c][c] as f64 / (answered + there) as f64
    };
    (0..3).map(f1).sum::<f64>() / 3.0
}

/// Moments of recordings of a mix, the scenarios in turn.
fn all_moments(mix: Mix) -> Vec<Moment> {
    let recordings = Recipe::new(0x0c1a55).series(RECORDINGS).into_iter().enumerate();
    let of = |(n, recipe): (usize, Recipe)| {
        let turn = |step: f64| (n as f64 * step).fract();
        let recipe = Recipe { scenario: scenario_at(mix, turn(0.754_878)), ..recipe };
        moments(&recipe, turn(0.618_034) < SHARED_TABLE, turn(0.1) < RIG_MOTION_LINKED)
    };
    recordings.flat_map(of).collect()
}

/// No contact is the likeliest class whether or not the crosshead moves, so that the rig gains nothing.
fn rig_gains_nothing(all: &[Moment]) {
    for (name, wanted) in
        [("still", [false, false]), ("moving softly", [true, false]), ("moving loud", [true, true])]
    {
        let (share, moments) = shares(all.iter().filter(|m| [m.moves, m.loud] == wanted));
        println!("crosshead {name}: {share:.3?} of {:.0} s", moments as f64 / HZ);
        assert!(share[0] > share[1].max(share[2]), "{name}: {share:?}");
    }
    let rig = |m: &Moment| usize::from(m.moves) + usize::from(m.loud);
    let [chance, rig] = [macro_f1(all, |_| 0), macro_f1(all, rig)];
    println!("macro F1: majority {chance:.4}, rig {rig:.4}");
    assert!(rig - chance < 0.02);
}

#[test]
fn the_rig_does_not_predict_slip_anywhere() {
    let all = all_moments(ANYWHERE);
    println!("no contact, no slip, slip: {:.3?}", shares(all.iter()).0);
    rig_gains_nothing(&all);
}

#[test]
fn neither_clock_nor_rig_predicts_slip() {
    let all = all_moments(PROTOCOL);
    let (mix, _) = shares(all.iter());
    println!("no contact, no slip, slip: {mix:.4?}; the paper has 0.576, 0.188, 0.237");
    println!("{:.1} s per recording", all.len() as f64 / HZ / RECORDINGS as f64);
    println!("time since the start:");
    for second in 0..40 {
        let (share, moments) = shares(all.iter().filter(|m| m.t as usize == second));
        println!("  {second:2} s: {share:.3?} of {:.0} s", moments as f64 / HZ);
        assert!(share[0] >= share[1].max(share[2]), "{second} s: {share:?}");
    }
    rig_gains_nothing(&all);
    let chance = macro_f1(&all, |_| 0);
    let clock = macro_f1(&all, |m| (m.t * 2.0) as usize);
    let speed = macro_f1(&all, |m| 3 * (m.speed_mm_s as usize) + usize::from(m.moves) + usize::from(m.loud));
    println!("macro F1: clock {clock:.4}, rig with its speed {speed:.4}");
    for (share, paper) in mix.iter().zip([0.576, 0.188, 0.237]) {
        assert!((share - paper).abs() < 0.02, "{mix:?}");
    }
    assert!(clock - chance < 0.02 && speed - chance < 0.02);
}
