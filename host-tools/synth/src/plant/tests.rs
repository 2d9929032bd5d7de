//! The plant: what was delivered never changes, commands act in time as a firmer grip does, what cannot be is refused.

use slipsense::params::TAXELS;
use slipsense::sensor::XlSample;

use super::*;
use crate::check::within;

type Delivered = Vec<([u16; TAXELS], Vec<XlSample>)>;

/// A command: after how many frames it comes, when it starts and ends, and what it commands.
type Command = (usize, f64, f64, f64);

fn collect(plant: &mut Plant, command: Option<Command>) -> Vec<Delivered> {
    let mut all = Vec::new();
    loop {
        if let Some((_, start_s, end_s, grip_n)) = command.filter(|command| command.0 == all.len()) {
            plant.command(start_s, end_s, grip_n).unwrap();
        }
        let Some(frame) = plant.step() else { return all };
        assert_eq!(frame.index, all.len());
        let of = |input: &slipsense::sensor::SensorInput<'_>| {
            let (piezo, xl) = (input.piezo.unwrap(), input.xl.unwrap());
            (*piezo.counts(), xl.to_vec())
        };
        all.push(frame.inputs().iter().map(of).collect());
    }
}

fn tick_s(frame: usize) -> f64 {
    (frame + 1) as f64 / 240.0
}

#[test]
fn what_lies_before_a_command_stays_to_the_bit_and_what_comes_after_is_another() {
    for hand in [Hand::Umi, Hand::Tesollo3] {
        // The first pull and the first twist that the grip does not hold.
        let (twists, pulls): (Vec<_>, Vec<_>) = trials(Objects::Val, hand, 3, 10)
            .into_iter()
            .partition(|trial| trial.direction == Direction::Twist);
        for of in [pulls, twists] {
            let slipping = |trial| {
                let plant = Trial::plant(&trial).unwrap();
                let onset = plant.slips().first()?.start;
                Some((trial, plant, onset))
            };
            let (trial, mut plain, onset) = of.into_iter().find_map(slipping).expect("one slips");
            let alone = collect(&mut plain, None);
            let start_s = tick_s(onset + 2);
            let command = (onset, start_s, start_s + 0.03, 8.0);
            let mut commanded = trial.plant().unwrap();
            let with = collect(&mut commanded, Some(command));
            let same = alone.iter().zip(&with).take_while(|(a, b)| a == b).count();
            // Up to the tick at which the force begins to rise, whose last sample may look ahead; it shows later.
            let expected = (onset + 2) as f64..(onset + 12) as f64;
            within(format!("{hand:?}, {:?}: frames alike", trial.direction), same as f64, expected);
            let again = collect(&mut trial.plant().unwrap(), Some(command));
            assert!(again == with, "the same commands, the same frames");
        }
    }
}

#[test]
fn a_weak_grip_loses_the_object_and_a_firm_one_in_time_holds_it() {
    for trial in &trials(Objects::Val, Hand::Tesollo2, 5, 6) {
        let mut plant = trial.plant().unwrap();
        let slips = plant.slips();
        assert!(!slips.is_empty() && plant.lost_at().is_some(), "{}", trial.object);
        let slid_mm = |p: &Plant| p.slid_mm(p.pulled().end - 1) - p.slid_mm(p.pulled().start);
        let weak_mm = slid_mm(&plant);
        let onset = slips[0].start;
        while plant.earliest_s() < tick_s(onset) {
            plant.step();
        }
        let (before_n, start_s) = (plant.target_n(), plant.earliest_s());
        plant.command(start_s, start_s + 0.025, GRIP_MAX_N).unwrap();
        assert_eq!((plant.lost_at(), plant.target_n()), (None, GRIP_MAX_N));
        let what = format!("{}, {:?}: mm, {weak_mm:.2} at {before_n:.1} N", trial.object, trial.direction);
        within(what, slid_mm(&plant), ..weak_mm.min(LOST_MM));
        // Smooth from the force that there was to the force commanded, at the times commanded.
        let at = |s: f64| plant.grip_n(start_s + s);
        assert!((at(0.0) - before_n).abs() < 1e-9 && (at(0.03) - GRIP_MAX_N).abs() < 1e-9);
        assert!(at(0.005) < at(0.0125) && at(0.0125) < at(0.02));
    }
}

#[test]
fn a_hand_pulls_no_harder_than_it_can() {
    // Friction alone cannot tell: twice the grip, given early, must hold what pulls with less than twice its force.
    let all = trials(Objects::Val, Hand::Umi, 8, 8);
    for trial in all.iter().filter(|trial| trial.direction != Direction::Twist) {
        let mut plant = trial.plant().unwrap();
        let (held_s, _) = plant.held_s();
        while plant.earliest_s() < held_s {
            plant.step();
        }
        let grip_n = (2.5 * plant.target_n()).min(GRIP_MAX_N);
        let start_s = plant.earliest_s();
        plant.command(start_s, start_s + 0.02, grip_n).unwrap();
        assert!(plant.slips().is_empty(), "{} with strength {}", trial.object, trial.strength);
    }
}

#[test]
fn commands_that_cannot_be_are_refused() {
    let trial = &trials(Objects::Val, Hand::Umi, 1, 1)[0];
    let mut plant = trial.plant().unwrap();
    let (from_s, to_s) = plant.held_s();
    while plant.earliest_s() < from_s + 0.05 {
        plant.step();
    }
    let now_s = plant.earliest_s();
    let past = plant.command(now_s - 0.001, now_s + 0.02, 5.0);
    assert_eq!(past, Err(CommandError::Past { start_s: now_s - 0.001, earliest_s: now_s }));
    for (start_s, end_s) in [(now_s, now_s), (now_s, to_s), (from_s - 0.1, now_s), (f64::NAN, now_s)] {
        let refused = plant.command(start_s, end_s, 5.0);
        assert!(matches!(refused, Err(CommandError::Outside { .. })), "{start_s} to {end_s}: {refused:?}");
    }
    for grip_n in [0.0, GRIP_MAX_N + 0.1, f64::NAN] {
        assert!(matches!(plant.command(now_s, now_s + 0.02, grip_n), Err(CommandError::Grip(_))));
    }
    let words = past.unwrap_err().to_string();
    assert!(words.starts_with("command: starts at") && words.ends_with("is past"), "{words}");
}

#[test]
fn plants_that_cannot_be_are_refused() {
    let recipe = Recipe { scenario: ScenarioChoice::SixStep, ..Recipe::new(1) };
    let refused = Plant::new(&recipe, 1.5).map(drop);
    let text = "recipe: scenario is SixStep, a plant takes free_pull or rotation";
    assert_eq!(refused.unwrap_err().to_string(), text);
    let recipe = Recipe { scenario: ScenarioChoice::FreePull, ..recipe };
    for strength in [0.0, -1.0, f64::INFINITY] {
        let refused = Plant::new(&recipe, strength).map(drop).unwrap_err().to_string();
        assert_eq!(refused, format!("strength is {strength}, must be a number above 0"));
    }
}

#[test]
fn a_hundred_trials_meet_every_object_from_every_direction() {
    let all = trials(Objects::Unseen, Hand::Tesollo3, 1, 100);
    let objects = Objects::Unseen.list();
    assert_eq!(objects.len(), 10);
    for object in &objects {
        object.check().unwrap();
        assert!(object.held_out(), "{}", object.name);
        let of: Vec<_> = all.iter().filter(|trial| trial.object == object.name).collect();
        let twists = of.iter().filter(|trial| trial.recipe.scenario == ScenarioChoice::Rotation).count();
        let slow = of.iter().filter(|trial| trial.recipe.speed_mm_s == Some(5.0)).count();
        assert_eq!((of.len(), twists, slow), (10, 2, 5), "{}", object.name);
        let mut angles: Vec<f64> = of.iter().filter_map(|trial| trial.recipe.pull_angle_deg).collect();
        angles.sort_by(f64::total_cmp);
        let once_around = angles[0] + 360.0;
        let turned = angles.iter().skip(1).chain([&once_around]);
        let gap = angles.iter().zip(turned).map(|(a, b)| b - a).fold(0.0, f64::max);
        assert!(gap < 80.0, "{}: {angles:?}", object.name);
    }
    let longer = trials(Objects::Unseen, Hand::Tesollo3, 1, 200);
    assert!(longer[..100] == all[..], "a longer list begins with the shorter one");
    let seeds = |of: &[Trial]| of.iter().map(|t| t.recipe.seed).collect::<Vec<_>>();
    let other = seeds(&trials(Objects::Val, Hand::Tesollo3, 1, 100));
    assert!(seeds(&all).iter().all(|seed| !other.contains(seed)));
}
