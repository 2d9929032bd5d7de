//! The contact model against force balance and the closed forms of a Winkler foundation, and what the
//! sensor makes of an untouched pad.

use slipsense::params::ACTIVE_TAXELS;
use slipsense_synth::contact::{CELL_MM2, Contact, Pose, PressureMap};
use slipsense_synth::objects::{CATALOGUE, Kind, Object, Shape, named};
use slipsense_synth::{Recipe, ScenarioChoice, SynthError, generate};

const CENTRED: Pose = Pose { x_mm: 0.0, y_mm: 0.0, yaw_rad: 0.0, tilt: [0.0; 2] };

#[test]
fn pressures_carry_the_grip_force() {
    let mut map = PressureMap::empty();
    for object in &CATALOGUE {
        for (force_n, shear) in [(0.4, 0.0), (2.0, 0.5), (10.0, -0.6)] {
            let pose = Pose { x_mm: 2.0, y_mm: -6.0, yaw_rad: 0.2, tilt: [0.004, -0.003] };
            Contact::new(object, pose, 2500.0, 0.5).pressures(force_n, shear, &mut map);
            let error = (map.force_n() / force_n - 1.0).abs();
            assert!(error < 0.01, "{} at {force_n} N: off by {error}", object.name);
            assert!(map.loaded.iter().all(|&cell| map.kpa[cell] >= 0.0));
        }
    }
}

#[test]
fn shear_leans_towards_the_leading_edge() {
    let contact = Contact::new(named("paper-card").unwrap(), CENTRED, 2500.0, 0.5);
    let centre = |shear| {
        let mut map = PressureMap::empty();
        contact.pressures(2.0, shear, &mut map);
        let rows = |cell: usize| (cell / 32) as f64;
        map.loaded.iter().map(|&c| map.kpa[c] * rows(c)).sum::<f64>()
            / map.loaded.iter().map(|&c| map.kpa[c]).sum::<f64>()
    };
    assert!(centre(0.3) > centre(0.0) + 0.2 && centre(-0.3) < centre(0.0) - 0.2);
}

/// Per length, a cylinder pressed `d` deep into a Winkler layer of stiffness K bears
/// `K · 4/3 · d · √(2 R d)` (small `d`), and its peak pressure is `K · d`.
#[test]
fn cylinder_follows_the_closed_form() {
    static ROD: Object = Object {
        shape: Shape::Cylinder { radius_mm: 40.0, length_mm: 200.0 },
        layer_kpa_per_mm: f64::INFINITY,
        relief_depth_mm: 0.0,
        name: "rod",
        kind: Kind::Tool,
        ..CATALOGUE[0]
    };
    let k = 1000.0;
    let contact = Contact::new(&ROD, CENTRED, k, 0.0);
    let mut map = PressureMap::empty();
    for force_n in [2.0, 6.0, 12.0] {
        contact.pressures(force_n, 0.0, &mut map);
        let peak = map.kpa.iter().fold(0.0f64, |a, &p| a.max(p));
        let length_mm = 32.0 * 0.92;
        // N to mN: kPa · mm² is a millinewton.
        let depth = libm::pow(force_n * 1e3 / length_mm / k * 0.75 / 80f64.sqrt(), 2.0 / 3.0);
        // The columns next to the middle are half a pitch away from it.
        let expected = k * (depth - 0.35 * 0.35 / 80.0);
        let error = peak / expected - 1.0;
        println!("{force_n} N: peak {peak:.1} kPa, closed form {expected:.1}");
        assert!(error.abs() < 0.03, "{force_n} N: {error}");
    }
    assert!((CELL_MM2 - 0.644).abs() < 1e-6);
}

#[test]
fn an_untouched_pad_reads_below_one_count() {
    for seed in 0..6 {
        let recipe = Recipe { scenario: ScenarioChoice::Empty, seconds: Some(2.5), ..Recipe::new(seed) };
        let episode = generate(&recipe).unwrap();
        let sum: u64 = episode.piezo.iter().map(|p| u64::from(p.sum())).sum();
        let mean = sum as f64 / (episode.piezo.len() * ACTIVE_TAXELS) as f64;
        assert!(mean < 0.9 && mean > 0.0, "seed {seed}: {mean}");
    }
}

#[test]
fn the_same_recipe_gives_the_same_episode_and_another_seed_another() {
    let recipe = Recipe {
        seconds: Some(2.5),
        sensors: 3,
        platform: slipsense_synth::Platform::Tesollo,
        ..Recipe::new(5)
    };
    let (a, b) = (generate(&recipe).unwrap(), generate(&recipe).unwrap());
    assert_eq!(a, b);
    a.validate().unwrap();
    let other = generate(&Recipe { seed: 6, ..recipe }).unwrap();
    assert_ne!(a.xl, other.xl);
}

#[test]
fn a_recipe_survives_json_and_bad_ones_are_named() {
    let recipe = Recipe { seconds: Some(3.0), scenario: ScenarioChoice::FirmGrip, ..Recipe::new(9) };
    let text = serde_json::to_string(&recipe).unwrap();
    assert_eq!(serde_json::from_str::<Recipe>(&text).unwrap(), recipe);
    assert!(serde_json::from_str::<Recipe>(r#"{"seed":1,"objekt":"train"}"#).is_err());
    let error = |change: fn(&mut Recipe)| {
        let mut recipe = Recipe::new(1);
        change(&mut recipe);
        generate(&recipe).unwrap_err()
    };
    assert_eq!(error(|r| r.sensors = 4), SynthError::Sensors(4));
    assert_eq!(error(|r| r.seconds = Some(1.0)), SynthError::Seconds(1.0));
    assert!(matches!(error(|r| r.seconds = Some(f64::NAN)), SynthError::Seconds(_)));
    assert_eq!(error(|r| r.speed_mm_s = Some(0.0)), SynthError::Speed(0.0));
    assert_eq!(error(|r| r.noise = -1.0), SynthError::Noise(-1.0));
    assert!(
        generate(&Recipe { object: slipsense_synth::ObjectChoice::Named("spoon".into()), ..recipe })
            .unwrap_err()
            .to_string()
            .contains("\"spoon\" is not in the catalogue")
    );
}
