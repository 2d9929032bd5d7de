//! The catalogue: what it holds, that its values are those of the materials; what cannot be is refused.

use std::collections::BTreeSet;

use super::*;
use crate::check::{largest, near, within};

/// The 28 objects that training may draw on, those kept for validation among them, or the 9 held out.
fn group(held_out: bool) -> impl Iterator<Item = &'static Object> {
    CATALOGUE.iter().filter(move |o| o.held_out() == held_out)
}

fn forms(held_out: bool) -> BTreeSet<String> {
    group(held_out).filter_map(|o| o.relief).map(|r| format!("{:?}", r.form)).collect()
}

#[test]
fn thirty_seven_objects_of_four_kinds_nine_held_out() {
    assert_eq!(CATALOGUE.len(), 37);
    let of = |kind, held_out| group(held_out).filter(|o| o.kind == kind).count();
    for (kind, known, held_out) in
        [(Kind::Cable, 11, 3), (Kind::Connector, 5, 2), (Kind::Material, 7, 2), (Kind::Tool, 5, 2)]
    {
        assert_eq!((of(kind, false), of(kind, true)), (known, held_out), "{kind:?}");
    }
    let val: Vec<_> = of_group(Group::Val).map(|o| &o.name).collect();
    assert_eq!(val, ["ethernet-cable", "rj45-plug", "spruce-strip", "hex-key"]);
    let names: BTreeSet<_> = CATALOGUE.iter().map(|o| &o.name).collect();
    assert_eq!(names.len(), CATALOGUE.len(), "names are unique");
    for name in ["braided-cable", "dsub-hood", "shore-81-block", "shore-88-block", "threaded-rod"] {
        assert!(named(name).unwrap().held_out(), "{name}");
    }
}

#[test]
fn every_object_is_possible_and_typical() {
    for o in CATALOGUE.iter() {
        o.check().unwrap();
        assert!((0.1..=1.2).contains(&o.mu_static), "{}", o.name);
        assert!((0.75..=0.95).contains(&(o.mu_kinetic / o.mu_static)), "{}", o.name);
        match o.shape {
            Shape::Flat { edge_mm, .. } => assert!((0.3..=0.8).contains(&edge_mm), "{}", o.name),
            Shape::Cylinder { radius_mm, .. } if o.kind == Kind::Cable => {
                assert!((1.0..=6.0).contains(&radius_mm), "{}", o.name);
            }
            _ => {}
        }
        // The face touches somewhere at its top, and nowhere above it.
        let heights = (-400..400).flat_map(|i| (-40..40).map(move |j| (f64::from(i), f64::from(j))));
        let lowest = heights.map(|(i, j)| o.gap_mm(0.02 * i, 0.17 * j)).fold(f64::INFINITY, f64::min);
        assert!((0.0..0.02).contains(&lowest), "{}: top at {lowest} mm", o.name);
    }
}

/// Held out is not more of the same: reliefs that training never feels, or moduli it never meets.
#[test]
fn held_out_objects_are_shifted_and_built_otherwise() {
    let (known, new) = (forms(false), forms(true));
    for form in [Form::Braid, Form::Lanes, Form::Twist, Form::Thread].map(|f| format!("{f:?}")) {
        assert!(new.contains(&form) && !known.contains(&form), "{form}");
    }
    let shore = |o: &Object| match o.surface {
        Surface::Rubber { shore_a, .. } => Some(shore_a),
        _ => None,
    };
    let hardest_known = largest(group(false).filter_map(shore));
    let softest_new = group(true).filter_map(shore).fold(100.0, f64::min);
    within("softest held-out rubber over the hardest of training, HA", softest_new - hardest_known, 10.0..);
    let mean = |held_out, of: fn(&Object) -> f64| {
        group(held_out).map(of).sum::<f64>() / group(held_out).count() as f64
    };
    let (known, new) = (mean(false, |o| o.texture_share), mean(true, |o| o.texture_share));
    within("mean texture share, held out over training", new / known, 1.5..);
}

#[test]
fn gents_formula_gives_the_moduli_of_the_shore_blocks() {
    for (shore_a, expected) in [(81.0, 10.0), (88.0, 17.0)] {
        near(format!("{shore_a} HA, MPa"), gent_mpa(shore_a), expected, 0.05);
    }
}

const fn ball(radius_mm: f64) -> Shape {
    Shape::Sphere { radius_mm }
}

const fn flat(edge_mm: f64) -> Shape {
    Shape::Flat { width_mm: 1.0, length_mm: 30.0, edge_mm }
}

#[test]
fn what_cannot_be_is_refused_by_field() {
    type Change = fn(&mut Object);
    let cases: [(Change, &str); 17] = [
        (|o| o.mu_static = 0.0, "mu_static is 0, must be a finite number above 0"),
        (|o| o.mu_static = 50.0, "mu_static is 50, must be at most 3"),
        (|o| o.mu_static = f64::NAN, "mu_static is NaN, must be a finite number above 0"),
        (|o| o.mu_kinetic = 0.9, "mu_kinetic is 0.9, must be at most mu_static"),
        (|o| o.roughness_um = -1.0, "roughness_um is -1, must be a finite number above 0"),
        (|o| o.roughness_um = f64::NAN, "roughness_um is NaN, must be a finite number above 0"),
        (|o| o.roughness_um = 1e4, "roughness_um is 10000, must be at most 100"),
        (|o| o.texture_mm = vec![0.5, 3.0], "texture_mm is 3, must be 0.05 to 2"),
        (|o| o.texture_mm = vec![-0.5], "texture_mm is -0.5, must be 0.05 to 2"),
        (|o| o.mass_g = f64::INFINITY, "mass_g is inf, must be a finite number above 0"),
        (|o| o.mass_g = -3.0, "mass_g is -3, must be a finite number above 0"),
        (|o| o.shape = ball(0.0), "shape.radius_mm is 0, must be a finite number above 0"),
        (|o| o.shape = ball(12.0), "shape (width across its axis) is 24, must be at most the pad's 22.4 mm"),
        (|o| o.shape = ball(0.1), "shape (smallest width) is 0.2, must be at least 1 mm, about a taxel"),
        (|o| o.shape = flat(0.8), "shape.edge_mm is 0.8, must be at most half the width and half the length"),
        (
            |o| o.surface = Surface::Rubber { shore_a: 100.0, depth_mm: 1.0 },
            "surface.shore_a is 100, must be 10 to 98, where Gent's formula holds",
        ),
        (
            |o| o.surface = Surface::Elastic { modulus_mpa: 0.01, depth_mm: 10.0 },
            "surface (modulus over depth, kPa/mm) is 1, must be at least 100",
        ),
    ];
    for (change, rule) in cases {
        let mut object = named("usb-a-plug").unwrap().clone();
        change(&mut object);
        let error = object.check().unwrap_err();
        assert_eq!(error, format!("object \"usb-a-plug\": {rule}"));
    }
}
