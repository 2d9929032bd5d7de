//! Force balance, the closed forms of a Winkler layer, and what a grasp's draw adds to the layer.

use super::*;
use crate::check::{largest, near, within};
use crate::draw::{Stream, stream};
use crate::objects::{CATALOGUE, PAD_WIDTH_MM, Shape, Surface, gent_mpa, named};

pub(crate) const CENTRED: Pose = Pose { x_mm: 0.0, y_mm: 0.0, yaw_rad: 0.0, tilt: [0.0; 2] };

/// A hard, even object that lives as long as the test program.
pub(crate) fn hard(shape: Shape) -> &'static Object {
    let object = Object { shape, relief: None, surface: Surface::Hard, ..CATALOGUE[0].clone() };
    Box::leak(Box::new(object))
}

/// Pressures under a grip that nothing shears.
pub(crate) fn pressed(contact: &Contact, force_n: f64) -> PressureMap {
    let mut map = PressureMap::empty();
    contact.pressures(force_n, [0.0; 2], &mut map);
    map
}

pub(crate) fn peak(map: &PressureMap) -> f64 {
    largest(map.kpa.iter().copied())
}

/// Every object of the catalogue in random poses, some hanging over an edge of the pad.
#[test]
fn pressures_carry_the_grip_force() {
    let rng = &mut stream(4711, Stream::Contact, 0);
    let mut map = PressureMap::empty();
    let (mut worst, mut overhanging) = (0.0f64, 0);
    for object in CATALOGUE.iter() {
        for _ in 0..12 {
            let pose = Pose {
                x_mm: rng.between(-9.0, 9.0),
                y_mm: rng.between(-12.0, 12.0),
                yaw_rad: rng.between(-1.6, 1.6),
                tilt: [rng.between(-0.05, 0.05), rng.between(-0.05, 0.05)],
            };
            let mut contact = Contact::new(object, pose, rng.between(1e3, 1e4), rng.between(0.0, 1.2));
            let shift = [rng.between(-3.0, 3.0), rng.between(-3.0, 3.0)];
            contact.place(shift, rng.between(-0.5, 0.5), [rng.between(-0.01, 0.01), 0.0]);
            let force_n = rng.log_between(0.05, 15.0);
            contact.pressures(force_n, [rng.between(-0.5, 0.5), rng.between(-0.5, 0.5)], &mut map);
            worst = worst.max((map.force_n() / force_n - 1.0).abs());
            assert!(map.loaded.iter().all(|&cell| map.kpa[cell] > 0.0 && map.kpa[cell].is_finite()));
            let half = object.shape.extent_mm()[0] / 2.0;
            overhanging += usize::from((pose.x_mm + shift[0]).abs() + half > PAD_WIDTH_MM / 2.0);
        }
    }
    within(format!("444 random grips, {overhanging} over an edge: force balance off"), worst, ..0.01);
    assert!(overhanging > 50);
}

#[test]
fn shear_leans_towards_the_leading_edge_along_its_vector() {
    let contact = Contact::new(named("ball-knob").unwrap(), CENTRED, 2500.0, 0.5);
    let mut map = PressureMap::empty();
    let mut centre = |shear| {
        contact.pressures(4.0, shear, &mut map);
        let sum = |of: fn(usize) -> f64| map.loaded.iter().map(|&c| map.kpa[c] * of(c)).sum::<f64>();
        [sum(|c| cell_mm(c).0) / sum(|_| 1.0), sum(|c| cell_mm(c).1) / sum(|_| 1.0)]
    };
    for shear in [[0.0, 0.3], [0.3, 0.0], [-0.2, 0.2], [0.15, -0.25]] {
        let [x, y] = centre(shear);
        let size = libm::hypot(shear[0], shear[1]);
        let along = (x * shear[0] + y * shear[1]) / size;
        let across = (x * shear[1] - y * shear[0]) / size;
        assert!(along > 0.1 * size && across.abs() < 0.1 * along, "shear {shear:?}: centre at ({x}, {y}) mm");
    }
    assert!(centre([0.0; 2]).iter().all(|mm| mm.abs() < 1e-6));
}

/// A ball pressed `d` deep into a Winkler layer of stiffness K bears `π K R d²` over a patch of radius
/// `√(2 R d)`; a cylinder bears `K · 4/3 · d · √(2 R d)` per length. The peak pressure of both is `K · d`.
#[test]
fn sphere_and_cylinder_follow_the_closed_forms_of_the_layer() {
    use std::f64::consts::PI;
    let (k, r) = (1000.0, 60.0);
    let ball = Contact::new(hard(Shape::Sphere { radius_mm: r }), CENTRED, k, 0.0);
    let rod = Contact::new(hard(Shape::Cylinder { radius_mm: r, length_mm: 200.0 }), CENTRED, k, 0.0);
    // A cylinder along the rows loads the columns cut at the corners less; stay in the middle.
    let length_mm = 32.0 * 0.92;
    for force_n in [4.0, 10.0, 20.0] {
        // kPa · mm² is a millinewton.
        let load = force_n * 1e3;
        let map = pressed(&ball, force_n);
        let depth = (load / (PI * k * r)).sqrt();
        let (p0, a) = (peak(&map), (map.loaded.len() as f64 * CELL_MM2 / PI).sqrt());
        let (p0_form, a_form) = (k * depth, (2.0 * r * depth).sqrt());
        near(format!("ball {force_n} N: p0, kPa"), p0, p0_form, 0.05);
        near("a, mm", a, a_form, 0.05);

        let map = pressed(&rod, force_n);
        let depth = libm::pow(load / length_mm / k * 0.75 / (2.0 * r).sqrt(), 2.0 / 3.0);
        let touched = map.loaded.iter().filter(|&&c| c / 32 == 16).count();
        let (p0, b) = (peak(&map), touched as f64 * 0.7 / 2.0);
        let (p0_form, b_form) = (k * depth, (2.0 * r * depth).sqrt());
        near(format!("rod {force_n} N: p0, kPa"), p0, p0_form, 0.05);
        // Columns come in pairs.
        within(format!("b off {b_form:.2} mm"), b - b_form, -0.7..0.7);
    }
    assert!((CELL_MM2 - 0.644).abs() < 1e-6);
}

#[test]
fn a_soft_object_gives_way_in_series_with_the_layer() {
    let stiffness = |name| Contact::new(named(name).unwrap(), CENTRED, 2500.0, 0.5).stiffness_kpa_per_mm;
    let own = 1e3 * gent_mpa(60.0) / 1.4;
    let both = stiffness("shore-60-block");
    near("layer and block in series, kPa/mm", both, 1.0 / (1.0 / 2500.0 + 1.0 / own), 1e-12);
    assert_eq!(stiffness("ptfe-strip"), 2500.0);
}

#[test]
fn forces_that_cannot_be_touch_nothing() {
    let contact = Contact::new(named("usb-cable").unwrap(), CENTRED, 2500.0, 0.5);
    for force_n in [-0.1, 0.0, f64::NAN, f64::INFINITY] {
        let mut map = pressed(&contact, 2.0);
        contact.pressures(force_n, [0.0; 2], &mut map);
        assert_eq!((map.loaded.len(), map.force_n()), (0, 0.0));
    }
}

/// Relative rms of the pressure well inside the patch while the object slides 12 mm, and the rms drawn; means of grasps.
fn flutter(name: &str) -> (f64, f64) {
    let object = named(name).unwrap();
    let (mut measured, mut drawn) = (0.0, 0.0);
    for seed in 0..20 {
        let mut rng = stream(seed, Stream::Contact, 1);
        let pose = Pose { x_mm: 0.2, y_mm: -4.0, ..CENTRED };
        let mut contact = Contact::draw(&mut rng, object, pose, Region::Centre);
        drawn += contact.uneven_rms / 20.0;
        // Rows 12–19 of the middle columns stay under the object all the way.
        let cells: Vec<usize> = (12..20).flat_map(|row| [15, 16].map(|col| row * TAXEL_COLS + col)).collect();
        let mut sums = vec![(0.0, 0.0); cells.len()];
        for step in 0..=60 {
            contact.place([0.0, 0.2 * f64::from(step)], 0.0, [0.0; 2]);
            let map = pressed(&contact, 3.0);
            for (sum, &cell) in sums.iter_mut().zip(&cells) {
                *sum = (sum.0 + map.kpa[cell], sum.1 + map.kpa[cell] * map.kpa[cell]);
            }
        }
        let relative = |&(first, second): &(f64, f64)| (second * 61.0 / (first * first) - 1.0).max(0.0);
        measured += (sums.iter().map(relative).sum::<f64>() / sums.len() as f64).sqrt() / 20.0;
    }
    println!("{name} sliding 12 mm: pressure varies by {measured:.3} rms, drawn {drawn:.3}");
    (measured, drawn)
}

#[test]
fn pressure_flutters_as_drawn_while_a_block_slides_and_hardly_under_a_cable() {
    let (block, drawn) = flutter("shore-60-block");
    assert!((0.02..0.08).contains(&block) && (0.7..1.2).contains(&(block / drawn)));
    assert!(flutter("coax-cable").0 < 0.6 * block);
}

#[test]
fn a_relief_travels_over_the_pad() {
    let mut contact = Contact::new(named("dsub-hood").unwrap(), CENTRED, 2500.0, 0.3);
    let mut column = |shift_mm: f64| -> Vec<f64> {
        contact.place([0.0, shift_mm], 0.0, [0.0; 2]);
        let map = pressed(&contact, 4.0);
        (8..24).map(|row| map.kpa[row * TAXEL_COLS + 16]).collect()
    };
    let (start, half, whole) = (column(0.0), column(2.5), column(5.0));
    let apart = |a: &[f64], b: &[f64]| {
        let (d, s) = a.iter().zip(b).fold((0.0, 0.0), |(d, s), (x, y)| (d + (x - y).abs(), s + x + y));
        d / s
    };
    let (far, near) = (apart(&start, &half), apart(&start, &whole));
    println!("ridges 5 mm apart: pattern differs by {far:.3} after 2.5 mm and by {near:.3} after 5 mm");
    assert!(far > 0.1 && near < 0.3 * far);
}
