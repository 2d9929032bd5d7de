//! What happens in the scenarios: what slips and what does not, who holds it where, what is written down.

use slipsense::params::{COL_PITCH_MM, TAXEL_COLS};
use slipsense_recording::Episode;
use slipsense_synth::labels::{NO_CONTACT, NO_SLIP, SLIP};
use slipsense_synth::{
    ObjectChoice, Platform, Recipe, Region, ScenarioChoice, SynthError, generate, generate_set, mix,
    plan_frames,
};

use ScenarioChoice::*;

const ALL: [ScenarioChoice; 10] =
    [SixStep, Empty, Unlinked, FreeGrasp, FirmGrip, RigMotion, FreePull, Rotation, HandHeld, Disturbances];

fn labels(e: &Episode) -> &[u8] {
    e.label.as_deref().unwrap()
}

fn count(e: &Episode, label: u8) -> usize {
    labels(e).iter().filter(|&&l| l == label).count()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

#[test]
fn scenarios_without_slip_neither_slip_nor_say_so() {
    for scenario in [Empty, Unlinked, FreeGrasp, FirmGrip, RigMotion, Disturbances] {
        let seconds = Some(if scenario == Disturbances { 8.0 } else { 4.0 });
        let recipes = Recipe { scenario, seconds, sensors: 1, ..Recipe::new(7) }.series(6);
        let gross = generate_set(&recipes, |_, e| {
            assert_eq!(count(&e, SLIP), 0, "{scenario:?}");
            assert_eq!(count(&e, NO_SLIP) > 0, scenario != Empty, "{scenario:?}");
            let (speed, fraction) =
                (e.slip_true_mm_s.as_deref().unwrap(), e.slip_fraction.as_deref().unwrap());
            let slips = |f: &usize| labels(&e)[*f] == NO_SLIP && speed[*f] > 1.0 && fraction[*f] > 0.95;
            (0..e.frames()).filter(slips).count()
        })
        .unwrap();
        println!("{scenario:?}: {} frames of gross slip", gross.iter().sum::<usize>());
        assert_eq!(gross.iter().sum::<usize>(), 0, "{scenario:?}: {gross:?}");
    }
}

#[test]
fn scenarios_with_slip_slip_at_about_the_speed_of_the_recipe() {
    for scenario in [SixStep, FreePull, Rotation] {
        for (speed, seconds) in [(2.0, 9.0), (10.0, 4.0), (18.0, 3.0)] {
            let base = Recipe {
                scenario,
                seconds: Some(seconds),
                speed_mm_s: Some(speed),
                sensors: 1,
                ..Recipe::new(11)
            };
            let medians = generate_set(&base.series(5), |_, e| {
                let of = |v: &Option<Vec<f32>>, f: usize| f64::from(v.as_deref().unwrap()[f]);
                let whole =
                    (0..e.frames()).filter(|&f| labels(&e)[f] == SLIP && of(&e.slip_fraction, f) > 0.95);
                let speeds: Vec<f64> = whole.map(|f| of(&e.slip_true_mm_s, f)).collect();
                assert!(count(&e, SLIP) > 10, "{scenario:?} {speed}: {} slip frames", count(&e, SLIP));
                median(speeds)
            })
            .unwrap();
            println!("{scenario:?} at {speed} mm/s: median speeds of whole slip {medians:.1?}");
            for median in medians {
                // Short recordings leave little room to get up to speed. A twist has the recipe's speed 3 mm
                // from its axis; a patch may lie anywhere within the pad's half diagonal of 18 mm from it.
                let most = if scenario == Rotation { 6.0 } else { 1.3 };
                assert!((0.5 * speed..most * speed).contains(&median), "{scenario:?} at {speed}: {median}");
            }
        }
    }
}

#[test]
fn hand_held_recordings_slip_sometimes_and_at_the_end() {
    let recipes = Recipe { scenario: HandHeld, seconds: Some(5.0), sensors: 1, ..Recipe::new(3) }.series(16);
    let slips = generate_set(&recipes, |_, e| {
        let event = |name: &str| {
            let events = e.meta.other["events"].as_array().unwrap();
            let found = events.iter().rfind(|event| event["name"] == name).unwrap();
            (found["start_s"].as_f64().unwrap() * 240.0) as usize
        };
        let (close, open) = (event("close"), event("open"));
        let slip = labels(&e).iter().position(|&l| l == SLIP);
        if let Some(slip) = slip {
            assert!(close + 60 < slip && slip < open, "{close} {slip} {open}");
        }
        slip.is_some()
    })
    .unwrap();
    let share = slips.iter().filter(|&&s| s).count() as f64 / slips.len() as f64;
    println!("{:.0} % of 16 hand-held recordings slip; two in five are meant to", 100.0 * share);
    assert!((0.1..0.8).contains(&share));
}

#[test]
fn three_fingers_of_a_tesollo_carry_unequal_loads() {
    let recipes = Recipe {
        platform: Platform::Tesollo,
        sensors: 3,
        seconds: Some(3.0),
        scenario: SixStep,
        ..Recipe::new(5)
    }
    .series(3);
    generate_set(&recipes, |_, e| {
        e.validate().unwrap();
        assert!(count(&e, SLIP) > 0 && count(&e, NO_SLIP) > 0);
        let load = |s: usize| e.piezo.iter().skip(s).step_by(3).map(|p| f64::from(p.sum())).sum::<f64>();
        let (a, b, c) = (load(0), load(1), load(2));
        println!("counts of the fingers: {a:.2e} {b:.2e} {c:.2e}, units {}", e.meta.other["units"]);
        assert!(a > b && a > c && (b / c - 1.0).abs() > 0.02);
        let mut units: Vec<String> = serde_json::from_value(e.meta.other["units"].clone()).unwrap();
        units.sort();
        assert_eq!(units, ["tesollo-a", "tesollo-b", "tesollo-c"]);
    })
    .unwrap();
}

#[test]
fn both_units_of_a_umi_take_part_in_either_order() {
    let recipes = Recipe { seconds: Some(2.5), scenario: Empty, ..Recipe::new(5) }.series(8);
    let units = generate_set(&recipes, |_, e| e.meta.other["units"].to_string()).unwrap();
    println!("{units:?}");
    for order in [r#"["umi-a","umi-b"]"#, r#"["umi-b","umi-a"]"#] {
        assert!(units.iter().any(|u| u == order), "{order} never");
    }
}

#[test]
fn pulls_by_hand_go_where_the_recipe_says_and_say_where_they_went() {
    use slipsense_synth::SlipDirection::{OtherInPlane, Rotational, Vertical};
    let base = Recipe { seconds: Some(3.0), speed_mm_s: Some(10.0), scenario: FreePull, ..Recipe::new(17) };
    for (angle_deg, direction) in [
        (0.0, Vertical),
        (-15.0, Vertical),
        (30.0, OtherInPlane),
        (90.0, OtherInPlane),
        (-120.0, OtherInPlane),
        (180.0, OtherInPlane),
    ] {
        let e = generate(&Recipe { pull_angle_deg: Some(angle_deg), ..base.clone() }).unwrap();
        let meta = &e.meta.other;
        assert_eq!(meta["slip_direction"], serde_json::to_value(direction).unwrap(), "{angle_deg}");
        let way: [f64; 2] = serde_json::from_value(meta["draws"]["plan"]["stroke_mm"].clone()).unwrap();
        // Counter-clockwise from the pad's y.
        let found_deg = libm::atan2(-way[0], way[1]).to_degrees();
        println!("{angle_deg}° asked for, pulled at {found_deg:.3}°: {direction:?}");
        assert!(((found_deg - angle_deg + 540.0) % 360.0 - 180.0).abs() < 0.01, "{angle_deg}: {found_deg}");
        assert!(count(&e, SLIP) > 10);
    }
    let twist = generate(&Recipe { scenario: Rotation, ..base.clone() }).unwrap();
    assert_eq!(twist.meta.other["slip_direction"], serde_json::to_value(Rotational).unwrap());
    let held = generate(&Recipe { scenario: FreeGrasp, ..base.clone() }).unwrap();
    assert!(held.meta.other["slip_direction"].is_null());
    // The drawn direction leaves all else alone: the named one does too.
    let drawn = generate(&base).unwrap();
    let named = generate(&Recipe { pull_angle_deg: Some(45.0), ..base }).unwrap();
    assert_eq!(drawn.meta.other["events"], named.meta.other["events"]);
    assert_eq!(drawn.meta.other["grip_n"], named.meta.other["grip_n"]);
}

/// Distance of the contact's centroid from the middle across the pad, mm, by counts above idle.
fn centroid_mm(e: &Episode) -> f64 {
    let (mut sum, mut moment) = (0.0, 0.0);
    for scan in e.piezo.iter().step_by(e.sensors).zip(labels(e)).filter(|(_, l)| **l == NO_SLIP).map(|x| x.0)
    {
        for (cell, &count) in scan.counts().iter().enumerate().filter(|(_, c)| **c > 20) {
            let x = ((cell % TAXEL_COLS) as f64 - 15.5) * f64::from(COL_PITCH_MM);
            sum += f64::from(count);
            moment += f64::from(count) * x;
        }
    }
    moment / sum
}

#[test]
fn palm_moves_the_patch_8_to_12_mm() {
    for object in ["usb-cable", "usb-a-plug", "shore-60-block", "ball-knob"] {
        let base = Recipe {
            object: ObjectChoice::Named(object.into()),
            scenario: SixStep,
            seconds: Some(2.5),
            sensors: 1,
            region: Region::Palm,
            ..Recipe::new(21)
        };
        let shifts = generate_set(&base.series(3), |_, e| centroid_mm(&e)).unwrap();
        println!("{object}: centroid at {shifts:.1?} mm");
        assert!(shifts.iter().all(|x| (8.0..12.0).contains(&-x)), "{object}: {shifts:?}");
    }
}

#[test]
fn metadata_say_what_was_made() {
    for scenario in ALL {
        let recipe = Recipe { scenario, seconds: Some(2.5), ..Recipe::new(31) };
        let e = generate(&recipe).unwrap();
        e.validate().unwrap();
        assert_eq!(e.frames(), plan_frames(&recipe).unwrap());
        let meta = &e.meta.other;
        for key in [
            "platform",
            "synthetic",
            "source",
            "licence",
            "object",
            "object_kind",
            "held_out",
            "scenario",
            "region",
            "speed_mm_s",
            "grip_n",
            "units",
            "rig_leak",
            "seed",
            "recipe",
            "events",
            "draws",
            "label_rule",
            "slip_frames_without_contact",
        ] {
            assert!(meta.contains_key(key), "{key}");
        }
        assert_eq!((&meta["platform"], &meta["synthetic"]), (&"umi".into(), &true.into()));
        let rig = [SixStep, Empty, Unlinked, FirmGrip, RigMotion].contains(&scenario);
        assert_eq!(meta["label_rule"], if rig { "encoder" } else { "interface" });
        assert_eq!(meta.contains_key("slip_direction"), !rig, "{scenario:?}");
        let pulls = rig || [FreePull, Rotation].contains(&scenario) || count(&e, SLIP) > 0;
        assert_eq!(meta["speed_mm_s"].is_number(), pulls, "{scenario:?}");
        assert!(meta["draws"]["plan"]["script"]["stretches"].as_array().unwrap().len() > 5);
        assert!(meta["draws"]["finger_1"]["yaw_rad"].is_number());
        let text = meta["draws"].to_string();
        println!("{scenario:?}: {} bytes of draws", text.len());
        assert_eq!(serde_json::from_str::<serde_json::Value>(&text).unwrap(), meta["draws"]);
    }
}

#[test]
fn every_disturbance_comes_with_contact_and_without() {
    let recipes =
        Recipe { scenario: Disturbances, seconds: Some(60.0), sensors: 1, ..Recipe::new(8) }.series(2);
    let mut seconds = [0.0; 2];
    let mut seen = std::collections::BTreeMap::<String, [usize; 2]>::new();
    let found = generate_set(&recipes, |_, e| {
        let mut events = Vec::new();
        for event in e.meta.other["events"].as_array().unwrap() {
            let frame = (event["start_s"].as_f64().unwrap() * 240.0) as usize;
            let held = labels(&e)[frame.min(e.frames() - 1)] != NO_CONTACT;
            events.push((event["name"].as_str().unwrap().to_owned(), held));
        }
        let idle = count(&e, NO_CONTACT) as f64 / 240.0;
        (events, idle, e.frames() as f64 / 240.0 - idle)
    })
    .unwrap();
    for (events, idle, held) in found {
        seconds[0] += idle;
        seconds[1] += held;
        events.into_iter().for_each(|(name, held)| seen.entry(name).or_default()[usize::from(held)] += 1);
    }
    println!("{:.0} s without contact, {:.0} s with: {seen:?}", seconds[0], seconds[1]);
    for name in ["tap", "jaw", "motion", "ambient"] {
        assert!(seen[name].iter().all(|&n| n > 0), "{name}: {:?}", seen[name]);
    }
    for name in ["rolling", "drag", "grip_change", "lift", "set_down"] {
        assert!(seen[name][1] > 0, "{name}: {:?}", seen[name]);
    }
    for name in ["close", "open"] {
        assert!(seen[name].iter().sum::<usize>() > 2, "{name}");
    }
}

#[test]
fn class_mix_of_generated_episodes_is_the_papers() {
    // Labels come from simulated scans here; the same shares from scripts alone are tested in the crate.
    let recipes = Recipe { sensors: 1, ..Recipe::new(2024) }.series(96);
    let mut counts = [0usize; 3];
    for found in generate_set(&recipes, |_, e| [NO_CONTACT, NO_SLIP, SLIP].map(|l| count(&e, l))).unwrap() {
        counts.iter_mut().zip(found).for_each(|(c, n)| *c += n);
    }
    let total = counts.iter().sum::<usize>() as f64;
    let share = counts.map(|c| c as f64 / total);
    println!("no contact, no slip, slip: {share:.3?} of {:.0} s (synthetic)", total / 240.0);
    for (share, paper) in share.iter().zip([0.576, 0.188, 0.237]) {
        // Slow slips are few and long: 96 recordings tell the shares to a few points only.
        assert!((share - paper).abs() < 0.06, "{share} against {paper}");
    }
}

#[test]
fn random_recipes_follow_the_protocol_mix() {
    let (scenario, weight) = mix::PROTOCOL.weights()[0];
    let meant = weight as f64 / 100.0;
    assert_eq!(scenario, SixStep);
    let recipes = Recipe { seconds: Some(2.5), sensors: 1, ..Recipe::new(12) }.series(40);
    let six = generate_set(&recipes, |_, e| e.meta.other["scenario"] == "six_step").unwrap();
    let share = six.iter().filter(|&&s| s).count() as f64 / 40.0;
    println!("six steps in {share} of 40 recordings, meant {meant}");
    assert!((share - meant).abs() < 0.2);
}

#[test]
fn held_out_objects_never_appear_in_training() {
    for (choice, expected) in [(ObjectChoice::Train, false), (ObjectChoice::HeldOut, true)] {
        let recipes = Recipe { object: choice, seconds: Some(2.5), sensors: 1, ..Recipe::new(1) }.series(20);
        let held_out = generate_set(&recipes, |_, e| e.meta.other["held_out"] == true).unwrap();
        assert!(held_out.iter().all(|&h| h == expected));
    }
}

#[test]
fn bad_recipes_are_refused_by_name() {
    let error = |change: fn(&mut Recipe)| {
        let mut recipe = Recipe::new(1);
        change(&mut recipe);
        assert_eq!(plan_frames(&recipe).unwrap_err().to_string(), recipe.check().unwrap_err().to_string());
        generate(&recipe).unwrap_err()
    };
    for (e, words) in [
        (error(|r| r.sensors = 0), "sensors is 0, must be 1 to 3"),
        (error(|r| r.sensors = 4), "sensors is 4, must be 1 to 3"),
        (error(|r| r.sensors = 3), "sensors is 3, but platform umi has at most 2"),
        (error(|r| r.seconds = Some(1.0)), "seconds is 1, must be 2.5 to 600"),
        (error(|r| r.seconds = Some(601.0)), "seconds is 601, must be 2.5 to 600"),
        (error(|r| r.seconds = Some(f64::NAN)), "seconds is NaN"),
        (error(|r| r.speed_mm_s = Some(0.0)), "speed_mm_s is 0, must be above 0"),
        (error(|r| r.speed_mm_s = Some(-3.0)), "speed_mm_s is -3"),
        (error(|r| r.speed_mm_s = Some(f64::INFINITY)), "speed_mm_s is inf"),
        (error(|r| r.noise = -1.0), "noise is -1, must be 0 to 4"),
        (error(|r| r.pull_angle_deg = Some(9.0)), "pull_angle_deg is given, but only scenario free_pull"),
        (
            error(|r| (r.scenario, r.pull_angle_deg) = (FreePull, Some(181.0))),
            "pull_angle_deg is 181, must be -180 to 180",
        ),
        (
            error(|r| (r.scenario, r.pull_angle_deg) = (FreePull, Some(f64::NAN))),
            "pull_angle_deg is NaN, must be -180 to 180",
        ),
        (
            error(|r| r.object = ObjectChoice::Named("spoon".into())),
            "\"spoon\" is not in the catalogue (usb-cable",
        ),
    ] {
        println!("{e}");
        assert!(e.to_string().contains(words), "{e}");
    }
    assert!(matches!(error(|r| r.sensors = 3), SynthError::PlatformSensors { sensors: 3, most: 2, .. }));
}
