//! What a recipe may name, and what is refused.

use super::*;
use crate::check::{near, within};
use crate::labels::SLIP;
use crate::objects::{CATALOGUE, Group, Object, Shape, named};

fn six_step(seed: u64) -> Recipe {
    Recipe { sensors: 1, seconds: Some(3.0), scenario: ScenarioChoice::SixStep, ..Recipe::new(seed) }
}

fn rod() -> Object {
    let shape = Shape::Cylinder { radius_mm: 4.5, length_mm: 90.0 };
    Object { name: "my-rod".to_owned(), shape, ..named("usb-a-plug").unwrap().clone() }
}

fn own(object: Object) -> Recipe {
    Recipe { object: ObjectChoice::Own(Box::new(object)), ..six_step(4) }
}

/// Frames labelled slip, and the share of them in which the object moves on the pad.
fn slip(e: &Episode) -> (usize, f64) {
    let speed: Vec<f64> = e.slip_true_mm_s.iter().flatten().map(|&v| v.into()).collect();
    let slip = levels::of_label(e, &speed, SLIP);
    (slip.len(), slip.iter().filter(|v| **v > 0.5).count() as f64 / slip.len() as f64)
}

#[test]
fn a_recipe_is_the_same_after_a_trip_through_json() {
    let old = r#"{"seed":7,"object":{"named":"usb-cable"},"scenario":"six_step","platform":"umi","region":"centre","sensors":2,"noise":1.0,"rig_leak":true,"vibration_content":"all","vibration":"modal"}"#;
    let recipe: Recipe = serde_json::from_str(old).unwrap();
    assert_eq!(serde_json::to_string(&recipe).unwrap(), old, "nothing new where nothing new is named");
    let older = old.replace("vibration_content", "heard");
    assert_eq!(serde_json::from_str::<Recipe>(&older).unwrap(), recipe, "the field's former name");

    let mut recipe = own(Object { mu_kinetic: 0.1 + 0.2, ..rod() });
    // Such values need all 17 digits.
    recipe.grip_n = Some(1.0 / 3.0);
    for nth in 0..1000 {
        recipe.grip_n = recipe.grip_n.map(|n| 0.3 + (n * 1.618_033_988_749_895 + f64::from(nth)) % 11.0);
        let text = serde_json::to_string(&recipe).unwrap();
        assert_eq!(serde_json::from_str::<Recipe>(&text).unwrap(), recipe, "{text}");
    }
}

/// Naming what would have been drawn changes no draw after it.
#[test]
fn a_named_grip_leaves_all_other_draws_alone() {
    let drawn = generate(&six_step(3)).unwrap();
    let base = drawn.meta.other["draws"]["plan"]["base_n"].as_f64().unwrap();
    let same = generate(&Recipe { grip_n: Some(base), ..six_step(3) }).unwrap();
    let counts = |e: &Episode| e.piezo.iter().map(|p| f64::from(p.sum())).sum::<f64>();
    near(format!("{base} N named: counts of the drawn"), counts(&same), counts(&drawn), 1e-3);
    assert_eq!((&drawn.label, &drawn.xl_end), (&same.label, &same.xl_end));

    let firm = generate(&Recipe { grip_n: Some(9.0), ..six_step(3) }).unwrap();
    assert_eq!(firm.meta.other["grip_n"], 9.0);
    assert_eq!(firm.meta.other["events"], drawn.meta.other["events"]);
    assert!(counts(&firm) > counts(&drawn));
}

#[test]
fn an_older_array_reads_less_and_nothing_else_changes() {
    let [new, old] = [0.0, 12.0].map(|months| {
        let e = generate(&Recipe { age_months: Some(months), ..six_step(3) }).unwrap();
        assert_eq!(e.meta.other["draws"]["finger_0"]["film"]["age_months"], months);
        e
    });
    let counts = |e: &Episode| e.piezo.iter().map(|p| f64::from(p.sum())).sum::<f64>();
    // At 12 months 0 to 45 % of the conductance is lost.
    within("counts, old over new", counts(&old) / counts(&new), 0.5..0.999);
    assert_eq!((&new.label, &new.xl), (&old.label, &old.xl));
}

/// Where the labels come from the encoder, nothing else would show that a firm grip held out.
#[test]
fn objects_slip_in_any_named_grip() {
    use ScenarioChoice::{FreePull, Rotation, SixStep};
    // Rubber, and the stickiest that is allowed.
    for (scenario, mu) in [(SixStep, 1.2), (SixStep, 3.0), (FreePull, 1.2), (Rotation, 1.2)] {
        for grip_n in [0.3, 2.0, 12.0] {
            let sticky = Object { mu_static: mu, mu_kinetic: 0.85 * mu, ..rod() };
            let recipes = Recipe { seed: 7, scenario, grip_n: Some(grip_n), ..own(sticky) }.series(4);
            let found = generate_set(&recipes, |_, e| (slip(&e), e.meta.other["grip_n"].clone())).unwrap();
            let (frames, moving): (Vec<_>, Vec<_>) = found.iter().map(|(slip, _)| *slip).unzip();
            println!("{scenario:?}, {mu}, {grip_n} N: frames of slip {frames:?}, moving in {moving:.2?}");
            assert!(found.iter().all(|(_, named)| *named == grip_n));
            // The encoder sees the pull from its start, before the interface slips. Hands are soft: a firm,
            // sticky grip may give way by jerks too short to count as slip, and then is not labelled so.
            let by_hand = scenario != SixStep && grip_n > 2.0;
            let honest = |(&n, &share): (&usize, &f64)| (n > 5 && share > 0.5) || (by_hand && n == 0);
            assert!(frames.iter().zip(&moving).all(honest));
        }
    }
}

#[test]
fn bad_recipes_are_refused_by_name() {
    type Change = fn(&mut Recipe);
    let cases: [(Change, &str); 24] = [
        (|r| r.sensors = 0, "sensors is 0, must be 1 to 3"),
        (|r| r.sensors = 4, "sensors is 4, must be 1 to 3"),
        (|r| r.sensors = 3, "sensors is 3, but platform umi has at most 2"),
        (|r| r.seconds = Some(1.0), "seconds is 1, must be 2.5 to 600"),
        (|r| r.seconds = Some(601.0), "seconds is 601, must be 2.5 to 600"),
        (|r| r.seconds = Some(f64::NAN), "seconds is NaN, must be 2.5 to 600"),
        (|r| r.speed_mm_s = Some(0.0), "speed_mm_s is 0, must be above 0 and at most 50"),
        (|r| r.speed_mm_s = Some(-3.0), "speed_mm_s is -3, must be above 0 and at most 50"),
        (|r| r.speed_mm_s = Some(f64::INFINITY), "speed_mm_s is inf, must be above 0 and at most 50"),
        (|r| r.noise = -1.0, "noise is -1, must be 0 to 4"),
        (|r| r.age_months = Some(13.0), "age_months is 13, must be 0 to 12"),
        (|r| r.grip_n = Some(-2.0), "grip_n is -2, must be 0.3 to 12"),
        (|r| r.grip_n = Some(0.0), "grip_n is 0, must be 0.3 to 12"),
        (|r| r.grip_n = Some(f64::NAN), "grip_n is NaN, must be 0.3 to 12"),
        (|r| r.grip_n = Some(12.5), "grip_n is 12.5, must be 0.3 to 12"),
        (|r| r.grip_n = Some(f64::INFINITY), "grip_n is inf, must be 0.3 to 12"),
        (|r| r.pull_angle_deg = Some(9.0), "pull_angle_deg is given, but only scenario free_pull takes one"),
        (|r| pull(r, 181.0), "pull_angle_deg is 181, must be -180 to 180"),
        (|r| pull(r, f64::NAN), "pull_angle_deg is NaN, must be -180 to 180"),
        (
            |r| r.object = ObjectChoice::Named("spoon".into()),
            "object \"spoon\" is not in the catalogue (usb-cable",
        ),
        (|r| r.object = ObjectChoice::Named(String::new()), "object \"\" is not in the catalogue (usb-cable"),
        (
            |r| *r = own(Object { mu_kinetic: 0.9, ..rod() }),
            "object \"my-rod\": mu_kinetic is 0.9, must be at most",
        ),
        (|r| *r = own_named("usb-cable"), "object.own.name is \"usb-cable\", must be a name that no other"),
        (|r| *r = own_named(" "), "object.own.name is \" \""),
    ];
    for (change, rule) in cases {
        let mut recipe = Recipe::new(1);
        change(&mut recipe);
        let error = generate(&recipe).unwrap_err();
        assert_eq!((&plan_frames(&recipe).unwrap_err(), &recipe.check().unwrap_err()), (&error, &error));
        assert!(error.to_string().starts_with(&format!("recipe: {rule}")), "{error} says {rule}");
    }
    assert!(serde_json::from_str::<Recipe>(r#"{"seed":1,"objekt":"train"}"#).is_err());
}

fn pull(recipe: &mut Recipe, angle_deg: f64) {
    (recipe.scenario, recipe.pull_angle_deg) = (ScenarioChoice::FreePull, Some(angle_deg));
}

fn own_named(name: &str) -> Recipe {
    own(Object { name: name.to_owned(), ..rod() })
}

#[test]
fn an_own_object_is_gripped_like_one_of_the_catalogue() {
    let recipe = own(rod());
    let e = generate(&recipe).unwrap();
    e.validate().unwrap();
    let (frames, moving) = slip(&e);
    assert!(frames > 12 && moving > 0.5, "{frames} frames of slip, moving in {moving:.2}");
    let meta = &e.meta.other;
    assert_eq!((&meta["object"], &meta["object_kind"]), (&"my-rod".into(), &"connector".into()));
    assert_eq!(meta["held_out"], false);
    let again: Recipe = serde_json::from_value(meta["recipe"].clone()).unwrap();
    assert_eq!(content_hash(&generate(&again).unwrap()), content_hash(&e));

    let held_out = generate(&own(Object { group: Group::HeldOut, ..rod() })).unwrap();
    assert_eq!(held_out.meta.other["held_out"], true);

    // One of the catalogue, written out, is that one.
    let usb = ObjectChoice::Named("usb-cable".into());
    let (named, written) = (Recipe { object: usb, ..six_step(4) }, own(CATALOGUE[0].clone()));
    let [named, written] = [named, written].map(|recipe| generate(&recipe).unwrap());
    assert_eq!(named.piezo[400].counts(), written.piezo[400].counts());
}
