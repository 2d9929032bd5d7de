//! The contact model against force balance and the closed forms of a Winkler foundation, and what the
//! sensor makes of an untouched pad.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slipsense::params::ACTIVE_TAXELS;
use slipsense_synth::contact::{CELL_MM2, Contact, Pose, PressureMap, check_force_n};
use slipsense_synth::objects::{CATALOGUE, Object, PAD_WIDTH_MM, Shape, Surface, gent_mpa, named};
use slipsense_synth::{Recipe, ScenarioChoice, SynthError, generate};

const CENTRED: Pose = Pose { x_mm: 0.0, y_mm: 0.0, yaw_rad: 0.0, tilt: [0.0; 2] };

fn peak(map: &PressureMap) -> f64 {
    map.kpa.iter().fold(0.0, |a, &p| a.max(p))
}

/// A hard, even object that lives as long as the test program.
fn made_of(shape: Shape) -> &'static Object {
    let object = Object { shape, relief: None, surface: Surface::Hard, ..CATALOGUE[0].clone() };
    Box::leak(Box::new(object))
}

/// Every object of the catalogue in random poses, some hanging over an edge of the pad.
#[test]
fn pressures_carry_the_grip_force() {
    let mut rng = ChaCha8Rng::seed_from_u64(4711);
    let mut between = |lo: f64, hi: f64| lo + (hi - lo) * rng.random::<f64>();
    let mut map = PressureMap::empty();
    let (mut worst, mut overhanging) = (0.0f64, 0);
    for object in CATALOGUE.iter() {
        for _ in 0..12 {
            let (x_mm, y_mm) = (between(-9.0, 9.0), between(-12.0, 12.0));
            let tilt = [between(-0.05, 0.05), between(-0.05, 0.05)];
            let pose = Pose { x_mm, y_mm, yaw_rad: between(-1.6, 1.6), tilt };
            let mut contact = Contact::new(object, pose, between(1e3, 1e4), between(0.0, 1.2));
            let shift = [between(-3.0, 3.0), between(-3.0, 3.0)];
            contact.place(shift, between(-0.5, 0.5), [between(-0.01, 0.01), 0.0]);
            let force_n = libm::exp(between(-3.0, 2.7));
            contact.pressures(force_n, [between(-0.5, 0.5), between(-0.5, 0.5)], &mut map);
            worst = worst.max((map.force_n() / force_n - 1.0).abs());
            assert!(map.loaded.iter().all(|&cell| map.kpa[cell] > 0.0 && map.kpa[cell].is_finite()));
            let half = object.shape.extent_mm()[0] / 2.0;
            overhanging += usize::from((x_mm + shift[0]).abs() + half > PAD_WIDTH_MM / 2.0);
        }
    }
    println!("444 random grips, {overhanging} over an edge: force balance off by {worst:.1e} at most (0.01)");
    assert!(worst < 0.01 && overhanging > 50);
}

#[test]
fn shear_leans_towards_the_leading_edge_along_its_vector() {
    let contact = Contact::new(named("ball-knob").unwrap(), CENTRED, 2500.0, 0.5);
    let centre = |shear| {
        let mut map = PressureMap::empty();
        contact.pressures(4.0, shear, &mut map);
        let total: f64 = map.loaded.iter().map(|&c| map.kpa[c]).sum();
        let mean = |at: fn(usize) -> f64| map.loaded.iter().map(|&c| map.kpa[c] * at(c)).sum::<f64>() / total;
        [mean(|c| (c % 32) as f64 - 15.5) * 0.7, mean(|c| (c / 32) as f64 - 15.5) * 0.92]
    };
    for shear in [[0.0, 0.3], [0.3, 0.0], [-0.2, 0.2], [0.15, -0.25]] {
        let [x, y] = centre(shear);
        println!("shear {shear:?}: centre of pressure moves to ({x:.3}, {y:.3}) mm");
        let size = libm::hypot(shear[0], shear[1]);
        let along = (x * shear[0] + y * shear[1]) / size;
        let across = (x * shear[1] - y * shear[0]) / size;
        assert!(along > 0.1 * size && across.abs() < 0.1 * along);
    }
    let [x, y] = centre([0.0; 2]);
    assert!(x.abs() < 1e-6 && y.abs() < 1e-6);
}

/// A ball pressed `d` deep into a Winkler layer of stiffness K bears `π K R d²` over a patch of radius
/// `√(2 R d)`; a cylinder bears `K · 4/3 · d · √(2 R d)` per length. The peak pressure of both is `K · d`.
#[test]
fn sphere_and_cylinder_follow_the_closed_forms_of_the_layer() {
    let (k, r) = (1000.0, 60.0);
    let ball = Contact::new(made_of(Shape::Sphere { radius_mm: r }), CENTRED, k, 0.0);
    let rod = Contact::new(made_of(Shape::Cylinder { radius_mm: r, length_mm: 200.0 }), CENTRED, k, 0.0);
    // A cylinder along the rows loads the columns cut at the corners less; stay in the middle.
    let length_mm = 32.0 * 0.92;
    let mut map = PressureMap::empty();
    for force_n in [4.0, 10.0, 20.0] {
        // N to mN: kPa · mm² is a millinewton.
        let load = force_n * 1e3;
        ball.pressures(force_n, [0.0; 2], &mut map);
        let depth = (load / (std::f64::consts::PI * k * r)).sqrt();
        let (p0, a) = (peak(&map), (map.loaded.len() as f64 * CELL_MM2 / std::f64::consts::PI).sqrt());
        let (p0_form, a_form) = (k * depth, (2.0 * r * depth).sqrt());
        println!("ball {force_n} N: p0 {p0:.1} kPa ({p0_form:.1}), a {a:.2} mm ({a_form:.2})");
        assert!((p0 / p0_form - 1.0).abs() < 0.05 && (a / a_form - 1.0).abs() < 0.05);

        rod.pressures(force_n, [0.0; 2], &mut map);
        let depth = libm::pow(load / length_mm / k * 0.75 / (2.0 * r).sqrt(), 2.0 / 3.0);
        let touched = map.loaded.iter().filter(|&&c| c / 32 == 16).count();
        let (p0, b) = (peak(&map), touched as f64 * 0.7 / 2.0);
        let (p0_form, b_form) = (k * depth, (2.0 * r * depth).sqrt());
        println!("rod {force_n} N: p0 {p0:.1} kPa ({p0_form:.1}), b {b:.2} mm ({b_form:.2})");
        assert!((p0 / p0_form - 1.0).abs() < 0.05);
        // Columns come in pairs.
        assert!((b - b_form).abs() < 0.7);
    }
    assert!((CELL_MM2 - 0.644).abs() < 1e-6);
}

#[test]
fn a_soft_object_gives_way_in_series_with_the_layer() {
    let (block, hard) = (named("shore-60-block").unwrap(), named("ptfe-strip").unwrap());
    let own = 1e3 * gent_mpa(60.0) / 1.4;
    let both = Contact::new(block, CENTRED, 2500.0, 0.5).stiffness_kpa_per_mm();
    println!("layer 2500 kPa/mm, block {own:.0} kPa/mm, in series {both:.0}");
    assert!((both - 1.0 / (1.0 / 2500.0 + 1.0 / own)).abs() < 1e-9);
    assert_eq!(Contact::new(hard, CENTRED, 2500.0, 0.5).stiffness_kpa_per_mm(), 2500.0);
}

#[test]
fn forces_that_cannot_be_are_refused() {
    for force_n in [-0.1, f64::NAN, f64::INFINITY] {
        let text = check_force_n(force_n).unwrap_err().to_string();
        assert!(text.contains("must be a finite number, 0 or above"), "{text}");
        let mut map = PressureMap::empty();
        let contact = Contact::new(named("usb-cable").unwrap(), CENTRED, 2500.0, 0.5);
        contact.pressures(2.0, [0.0; 2], &mut map);
        contact.pressures(force_n, [0.0; 2], &mut map);
        assert_eq!((map.loaded.len(), map.force_n()), (0, 0.0));
    }
    assert_eq!(check_force_n(0.0), Ok(0.0));
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
