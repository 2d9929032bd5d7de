//! The catalogue: what it holds, that its values are those of the materials, and that what cannot be is
//! refused.

use std::collections::BTreeSet;

use slipsense_synth::objects::{
    CATALOGUE, Form, Group, Kind, Object, Shape, Surface, gap_mm, gent_mpa, group, named, of_group,
};

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
        let lowest = heights.map(|(i, j)| gap_mm(o, 0.02 * i, 0.17 * j)).fold(f64::INFINITY, f64::min);
        assert!((0.0..0.02).contains(&lowest), "{}: top at {lowest} mm", o.name);
    }
}

/// Held out is not more of the same: reliefs that training never feels, or moduli it never meets.
#[test]
fn held_out_objects_are_shifted_and_built_otherwise() {
    let (known, new) = (forms(false), forms(true));
    println!("reliefs of training {known:?}, of the held-out group {new:?}");
    for form in [Form::Braid, Form::Lanes, Form::Twist, Form::Thread].map(|f| format!("{f:?}")) {
        assert!(new.contains(&form) && !known.contains(&form), "{form}");
    }
    let shore = |o: &Object| match o.surface {
        Surface::Rubber { shore_a, .. } => Some(shore_a),
        _ => None,
    };
    let hardest_known = group(false).filter_map(shore).fold(0.0, f64::max);
    let softest_new = group(true).filter_map(shore).fold(100.0, f64::min);
    println!("training rubbers up to {hardest_known} HA, held-out ones from {softest_new} HA");
    assert!(softest_new > hardest_known + 10.0);
    let mean = |held_out, of: fn(&Object) -> f64| {
        group(held_out).map(of).sum::<f64>() / group(held_out).count() as f64
    };
    let (known, new) = (mean(false, |o| o.texture_share), mean(true, |o| o.texture_share));
    println!("mean texture share: training {known:.2}, held out {new:.2}");
    assert!(new > 1.5 * known);
}

#[test]
fn gents_formula_gives_the_moduli_of_the_shore_blocks() {
    for (shore_a, expected) in [(81.0, 10.0), (88.0, 17.0)] {
        let mpa = gent_mpa(shore_a);
        println!("{shore_a} HA: {mpa:.2} MPa, expected about {expected}");
        assert!((mpa / expected - 1.0).abs() < 0.05);
    }
}

#[test]
fn what_cannot_be_is_refused_by_name() {
    let refused = |change: fn(&mut Object)| {
        let mut object = named("usb-a-plug").unwrap().clone();
        change(&mut object);
        object.check().unwrap_err()
    };
    assert_eq!(refused(|o| o.mu_static = 0.0).field, "mu_static");
    assert_eq!(refused(|o| o.mu_kinetic = 0.9).rule, "at most mu_static");
    assert_eq!(refused(|o| o.roughness_um = -1.0).field, "roughness_um");
    assert_eq!(refused(|o| o.roughness_um = f64::NAN).field, "roughness_um");
    assert_eq!(refused(|o| o.shape = Shape::Sphere { radius_mm: 0.0 }).field, "shape.radius_mm");
    assert_eq!(refused(|o| o.texture_mm = vec![0.5, 3.0]).value, 3.0);
    assert_eq!(refused(|o| o.mass_g = f64::INFINITY).field, "mass_g");
    let soft = |o: &mut Object| o.surface = Surface::Rubber { shore_a: 100.0, depth_mm: 1.0 };
    assert_eq!(refused(soft).field, "surface.shore_a");
    let edge = |o: &mut Object| o.shape = Shape::Flat { width_mm: 1.0, length_mm: 30.0, edge_mm: 0.8 };
    assert_eq!(refused(edge).field, "shape.edge_mm");
    let wide = refused(|o| o.shape = Shape::Sphere { radius_mm: 12.0 }).to_string();
    assert_eq!(
        wide,
        "object \"usb-a-plug\": shape (width across its axis) is 24, must be at most the pad's 22.4 mm"
    );
}
