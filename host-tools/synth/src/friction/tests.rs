//! The brush against closed forms. Every test prints what it measured beside what it expected.

use std::f64::consts::{FRAC_PI_2, PI};

use libm::{asin, cos, pow, sin};

use super::*;
use crate::contact::{Contact, Pose};
use crate::draw::{Stream, stream};
use crate::objects::{CATALOGUE, Object, Shape, Surface, group, named};
use crate::recipe::{Region, SPEEDS_MM_S};

const CENTRED: Pose = Pose { x_mm: 0.0, y_mm: 0.0, yaw_rad: 0.0, tilt: [0.0; 2] };
const DT: f64 = 1.0 / STEP_HZ;

/// Pressure at each cell's centre.
fn map_of(kpa: impl Fn(f64, f64) -> f64) -> PressureMap {
    let mut map = PressureMap::empty();
    for cell in 0..TAXELS {
        let (x, y) = cell_mm(cell);
        map.kpa[cell] = kpa(x, y);
        if map.kpa[cell] > 0.0 {
            map.loaded.push(cell);
        }
    }
    map
}

fn hertz_ball(p0: f64, a: f64) -> PressureMap {
    map_of(|x, y| p0 * (1.0 - (x * x + y * y) / (a * a)).max(0.0).sqrt())
}

fn hertz_rod(p0: f64, b: f64) -> PressureMap {
    map_of(|x, _| p0 * (1.0 - x * x / (b * b)).max(0.0).sqrt())
}

/// Pull an interface whose friction does not weaken until it carries `share` of what it can, along y.
/// What it reached, and the load of the cells that stick over the whole load's area.
fn pulled(map: &PressureMap, k: f64, mu: f64, share: f64) -> (Interface, SlipState) {
    let mut interface = Interface::even(k, mu, 1.0);
    let force_n = share * mu * map.force_n();
    let soft = 1e-4;
    let mut last = SlipState::default();
    for i in 1..=50 {
        let position_mm = [0.0, force_n / soft * f64::from(i) / 50.0];
        let pull = Pull { position_mm, stiffness_n_per_mm: soft, ..Pull::default() };
        last = interface.step(map, 1.0, pull, DT);
    }
    (interface, last)
}

/// Cells whose stress is below their cap.
fn sticking<'a>(interface: &'a Interface, map: &'a PressureMap) -> impl Iterator<Item = usize> + 'a {
    map.loaded.iter().copied().filter(|&cell| {
        let [x, y] = interface.stress_kpa[cell];
        (x * x + y * y).sqrt() < interface.mu[cell] * map.kpa[cell] * (1.0 - 1e-9)
    })
}

/// Root of a function that rises from below 0 to above it between 0 and 1.
fn root(f: impl Fn(f64) -> f64) -> f64 {
    let (mut lo, mut hi) = (0.0, 1.0);
    for _ in 0..60 {
        let mid = 0.5 * (lo + hi);
        if f(mid) < 0.0 { lo = mid } else { hi = mid }
    }
    0.5 * (lo + hi)
}

/// Under Hertz's pressure the bristles of a brush all stretch by the same s (over that at full slip), and
/// those stick where `√(1 − r²/a²) > s`: c/a = √(1 − s²), with Q/μP = 1.5 s − 0.5 s³ under a ball and
/// (2/π)(asin s + s √(1 − s²)) under a rod.
#[test]
fn stick_radius_and_displacement_under_a_hertzian_pressure() {
    let (k, mu, p0) = (1000.0, 0.6, 120.0);
    println!("     Q/μP   c/a brush (closed form; Mindlin)   displacement (closed form; Mindlin)");
    let mut farthest = 0.0f64;
    for q in [0.1, 0.3, 0.5, 0.7, 0.9] {
        let map = hertz_ball(p0, 8.0);
        let (interface, last) = pulled(&map, k, mu, q);
        let s = root(|s| 1.5 * s - 0.5 * s * s * s - q);
        let touched = map.loaded.len() as f64;
        let c = (sticking(&interface, &map).count() as f64 / touched).sqrt();
        let (c_form, c_mindlin) = ((1.0 - s * s).sqrt(), pow(1.0 - q, 1.0 / 3.0));
        // Over the displacement at full slip, which 8 G*/(π a) makes the same for both.
        let moved = last.travel_mm[1] / (mu * p0 / k);
        let mindlin = 1.0 - pow(1.0 - q, 2.0 / 3.0);
        println!("ball {q:4}   {c:.3} ({c_form:.3}; {c_mindlin:.3})   {moved:.3} ({s:.3}; {mindlin:.3})");
        assert!((c / c_form - 1.0).abs() < 0.05 && (moved / s - 1.0).abs() < 0.05);
        farthest = farthest.max((s / mindlin - 1.0).abs());

        let map = hertz_rod(p0, 8.0);
        let (interface, last) = pulled(&map, k, mu, q);
        let s = root(|s| (asin(s) + s * (1.0 - s * s).sqrt()) / FRAC_PI_2 - q);
        let touched = map.loaded.len() as f64;
        let c = sticking(&interface, &map).count() as f64 / touched;
        let (c_form, c_mindlin) = ((1.0 - s * s).sqrt(), (1.0 - q).sqrt());
        let moved = last.travel_mm[1] / (mu * p0 / k);
        println!("rod  {q:4}   {c:.3} ({c_form:.3}; {c_mindlin:.3})   {moved:.3} ({s:.3})");
        // A rod's stick zone is a whole number of columns: 24 of them make up the patch.
        assert!((c - c_form).abs() < 0.05 && (moved / s - 1.0).abs() < 0.05);
    }
    println!("calibrated at full slip, the brush's displacement is within {farthest:.3} of Mindlin's");
    assert!(farthest < 0.12);
}

/// The stiffness that makes brush and half-space slip through at the same displacement: 8 G*/(π a).
#[test]
fn full_slip_at_mindlins_displacement_by_calibration() {
    let (mu, p0, a, g_star) = (0.5, 150.0, 6.0, 700.0);
    let map = hertz_ball(p0, a);
    let load_mn = 2.0 / 3.0 * PI * a * a * p0;
    let mindlin_mm = 3.0 * mu * load_mn / (16.0 * a * g_star);
    let (_, last) = pulled(&map, 8.0 * g_star / (PI * a), mu, 0.999);
    let moved = last.travel_mm[1];
    println!("displacement at full slip: brush {moved:.4} mm, Mindlin {mindlin_mm:.4} mm");
    // At 0.999 of full slip the closed form of the brush is at 0.974 of it.
    let s = root(|s| 1.5 * s - 0.5 * s * s * s - 0.999);
    assert!((moved / (s * mindlin_mm) - 1.0).abs() < 0.05 && (moved / mindlin_mm - 1.0).abs() < 0.05);
}

/// Ciavarella and Jäger: the stick zone under Q is the patch of the load P − Q/μ. It holds for a layer as
/// it does for a half-space; there it makes c/a = (1 − Q/μP)^⅓ and ^½, here ^¼ and ^⅓.
#[test]
fn stick_zone_is_the_patch_of_a_smaller_load() {
    let leak = |shape| -> &'static Object {
        let object = Object { shape, relief: None, surface: Surface::Hard, ..CATALOGUE[0].clone() };
        Box::leak(Box::new(object))
    };
    let (force_n, mu) = (12.0, 0.6);
    for (name, shape, exponent) in [
        ("ball", Shape::Sphere { radius_mm: 60.0 }, 0.25),
        ("rod", Shape::Cylinder { radius_mm: 60.0, length_mm: 200.0 }, 1.0 / 3.0),
    ] {
        let contact = Contact::new(leak(shape), CENTRED, 300.0, 0.0);
        let (mut map, mut smaller) = (PressureMap::empty(), PressureMap::empty());
        contact.pressures(force_n, [0.0; 2], &mut map);
        for q in [0.2, 0.5, 0.8] {
            let (interface, _) = pulled(&map, 800.0, mu, q);
            contact.pressures((1.0 - q) * force_n, [0.0; 2], &mut smaller);
            let stuck = sticking(&interface, &map).count() as f64;
            let (patch, whole) = (smaller.loaded.len() as f64, map.loaded.len() as f64);
            let size = |cells: f64| if name == "ball" { (cells / whole).sqrt() } else { cells / whole };
            let form = pow(1.0 - q, exponent);
            let (stuck, patch) = (size(stuck), size(patch));
            println!("{name} at {q}: stick {stuck:.3}, patch of P − Q/μ {patch:.3}, closed form {form:.3}");
            assert!((stuck / patch - 1.0).abs() < 0.05);
            assert!((stuck - form).abs() < if name == "ball" { 0.05 * form } else { 0.08 });
        }
    }
}

#[test]
fn full_slip_carries_kinetic_friction_and_the_spring_pulls_as_hard() {
    let mut map = PressureMap::empty();
    let mut rng = stream(11, Stream::Friction, 0);
    let (mut worst_full, mut worst_balance) = (0.0f64, 0.0f64);
    for (i, object) in CATALOGUE.iter().enumerate() {
        let pose = Pose { x_mm: 1.0, y_mm: -3.0, yaw_rad: 0.3, tilt: [0.003, 0.002] };
        let contact = Contact::draw(&mut rng, object, pose, Region::Centre);
        contact.pressures(0.5 + 0.2 * i as f64, [0.0; 2], &mut map);
        let (mu, share) = (object.mu_static, object.mu_kinetic / object.mu_static);
        let mut interface = Interface::even(1200.0, mu, share);
        let angle = i as f64;
        let stiffness_n_per_mm = 10.0 + 2.0 * i as f64;
        for step in 0..2400 {
            let reach = 0.004 * f64::from(step);
            let position_mm = [reach * cos(angle), reach * sin(angle)];
            let pull = Pull { position_mm, stiffness_n_per_mm, ..Pull::default() };
            let now = interface.step(&map, 1.0, pull, DT);
            let spring = [0, 1].map(|a| stiffness_n_per_mm * (position_mm[a] - now.travel_mm[a]));
            let off = libm::hypot(spring[0] - now.shear_n[0], spring[1] - now.shear_n[1]);
            worst_balance = worst_balance.max(off / (mu * map.force_n()));
            if step == 2399 {
                let full = libm::hypot(now.shear_n[0], now.shear_n[1]) / (object.mu_kinetic * map.force_n());
                worst_full = worst_full.max((full - 1.0).abs());
                assert!(now.fraction > 0.99, "{}: {}", object.name, now.fraction);
                assert!(now.direction[0] * cos(angle) + now.direction[1] * sin(angle) > 0.9999);
                assert!((now.speed_mm_s / (0.004 * STEP_HZ) - 1.0).abs() < 0.01);
            }
        }
    }
    println!("full slip off μk P by {worst_full:.1e}, spring off shear by {worst_balance:.1e} of μP (0.01)");
    assert!(worst_full < 0.01 && worst_balance < 0.01);
}

/// Pulled far and turned far at once, the friction of a patch reaches its limit surface, close to the
/// ellipsoid (F/μN)² + (M/μNc)² = 1.
#[test]
fn shift_and_turn_together_stay_on_the_limit_surface() {
    let contact = Contact::new(named("ball-knob").unwrap(), CENTRED, 1500.0, 0.6);
    let mut map = PressureMap::empty();
    contact.pressures(4.0, [0.0; 2], &mut map);
    let mu = 0.7;
    // Where the object ends up, per step, in mm and rad: `c` times the turn against the shift.
    let slipped = |speed: [f64; 2], spin: f64| {
        let mut interface = Interface::even(1500.0, mu, 1.0);
        let mut last = SlipState::default();
        for step in 0..3000 {
            let t = f64::from(step);
            let position_mm = speed.map(|v| v * t);
            let pull = Pull {
                position_mm,
                turn_rad: spin * t,
                stiffness_n_per_mm: 1e4,
                twist_n_mm_per_rad: if spin == 0.0 { 0.0 } else { 1e5 },
            };
            last = interface.step(&map, 1.0, pull, DT);
        }
        assert!(last.fraction > 0.99);
        (libm::hypot(last.shear_n[0], last.shear_n[1]), last.torque_n_mm)
    };
    let most_n = slipped([0.0, 2e-4], 0.0).0;
    let most_n_mm = slipped([0.0; 2], 2e-4).1;
    assert!((most_n / (mu * map.force_n()) - 1.0).abs() < 0.01);
    let moment: f64 = map.loaded.iter().map(|&c| map.kpa[c] * libm::hypot(cell_mm(c).0, cell_mm(c).1)).sum();
    let expected_n_mm = mu * moment * CELL_N;
    println!("turned only: {most_n_mm:.3} N mm, ∫ μ p r dA {expected_n_mm:.3} N mm");
    assert!((most_n_mm / expected_n_mm - 1.0).abs() < 0.01);
    let c_mm = most_n_mm / most_n;
    for mix in [0.2, 0.5, 1.0, 2.0, 5.0] {
        for angle in [0.0, 0.9, 2.2] {
            let speed = [2e-4 * cos(angle), 2e-4 * sin(angle)];
            let (force, torque) = slipped(speed, 2e-4 * mix / c_mm);
            let (f, m) = (force / most_n, torque / most_n_mm);
            let on = f * f + m * m;
            println!("turn over shift {mix}, at {angle} rad: F {f:.3}, M {m:.3}, sum of squares {on:.3}");
            assert!((0.9..=1.1).contains(&on));
        }
    }
}

/// The search over shifts alone is the search over shifts and turns of an object that cannot turn.
#[test]
fn a_held_turn_is_an_endlessly_stiff_one() {
    let contact = Contact::new(named("usb-a-plug").unwrap(), CENTRED, 2500.0, 0.5);
    let mut map = PressureMap::empty();
    contact.pressures(2.0, [0.0; 2], &mut map);
    let drawn = || Interface::draw(&mut stream(5, Stream::Friction, 0), named("usb-a-plug").unwrap());
    let (mut held, mut stiff) = (drawn(), drawn());
    let mut farthest = 0.0f64;
    for step in 0..2000 {
        let t = f64::from(step) * DT;
        let position_mm = [2.0 * sin(9.0 * t), 8.0 * t];
        let pull = Pull { position_mm, stiffness_n_per_mm: 30.0, ..Pull::default() };
        let a = held.step(&map, 1.0, pull, DT);
        let b = stiff.step(&map, 1.0, Pull { twist_n_mm_per_rad: 1e9, ..pull }, DT);
        farthest =
            farthest.max(libm::hypot(a.travel_mm[0] - b.travel_mm[0], a.travel_mm[1] - b.travel_mm[1]));
    }
    println!("held against endlessly stiff turn: {farthest:.1e} mm apart at most, after 7 mm");
    assert!(farthest < 1e-4);
}

/// Grips that come and go, jumping springs from nearly slack to nearly rigid, pulls that reverse and turn:
/// after every step springs and friction balance, no brush holds more than its cap, and the path only grows.
#[test]
fn every_step_balances_whatever_happens() {
    let mut rng = stream(77, Stream::Friction, 1);
    let object = named("spruce-strip").unwrap();
    let (mut worst, mut path) = (0.0f64, 0.0);
    for _ in 0..12 {
        let pose =
            Pose { x_mm: 3.0 * rng.normal(), y_mm: 3.0 * rng.normal(), yaw_rad: rng.phase(), ..CENTRED };
        let contact = Contact::draw(&mut rng, object, pose, Region::Palm);
        let mut interface = Interface::draw(&mut rng, object);
        let mut map = PressureMap::empty();
        for _ in 0..60 {
            let gone = rng.chance(0.15);
            let force_n = if gone { 0.0 } else { rng.log_between(0.05, 20.0) };
            contact.pressures(force_n, [0.0; 2], &mut map);
            interface.release_unloaded(&map);
            let pull = Pull {
                position_mm: [5.0 * rng.normal(), 5.0 * rng.normal()],
                turn_rad: 0.5 * rng.normal(),
                stiffness_n_per_mm: rng.log_between(0.05, 500.0),
                twist_n_mm_per_rad: if rng.chance(0.5) { rng.log_between(1.0, 5000.0) } else { 0.0 },
            };
            for _ in 0..4 {
                let now = interface.step(&map, rng.between(0.9, 1.1), pull, DT);
                let held_n = 1.3 * object.mu_static * map.force_n() + 1e-6;
                for axis in 0..2 {
                    let spring = pull.stiffness_n_per_mm * (pull.position_mm[axis] - now.travel_mm[axis]);
                    worst = worst.max((spring - now.shear_n[axis]).abs() / held_n);
                }
                if pull.twist_n_mm_per_rad > 0.0 {
                    let spring = pull.twist_n_mm_per_rad * (pull.turn_rad - now.turn_rad);
                    worst = worst.max((spring - now.torque_n_mm).abs() / (3.0 * held_n));
                }
                assert!(libm::hypot(now.shear_n[0], now.shear_n[1]) < 1.6 * held_n);
                assert!(now.path_mm.is_finite() && now.fraction <= 1.0 + 1e-12);
                path += now.speed_mm_s * DT;
            }
        }
    }
    println!("2880 steps, {path:.0} mm slid: off balance by {worst:.1e} of μP at most (0.01)");
    assert!(worst < 0.01);
}

/// Slip that a turn makes grows from the point it turns about, and has no direction.
#[test]
fn a_turn_slides_without_a_direction() {
    let contact = Contact::new(named("ball-knob").unwrap(), CENTRED, 1500.0, 0.6);
    let mut map = PressureMap::empty();
    contact.pressures(4.0, [0.0; 2], &mut map);
    let mut interface = Interface::even(1500.0, 0.6, 0.85);
    let (mut path, mut last) = (0.0, SlipState::default());
    for step in 0..1200 {
        let turn_rad = 1.0 * f64::from(step) * DT;
        let pull = Pull { turn_rad, twist_n_mm_per_rad: 500.0, ..Pull::default() };
        last = interface.step(&map, 1.0, pull, DT);
        assert!(last.path_mm >= path);
        path = last.path_mm;
    }
    let (moment, total) = map.loaded.iter().fold((0.0, 0.0), |(m, t), &c| {
        (m + map.kpa[c] * libm::hypot(cell_mm(c).0, cell_mm(c).1), t + map.kpa[c])
    });
    // One radian per second.
    let expected = moment / total;
    println!("turning at 1 rad/s: {:.3} mm/s, mean lever {expected:.3} mm", last.speed_mm_s);
    assert!((last.speed_mm_s / expected - 1.0).abs() < 0.03);
    assert_eq!((last.direction, last.travel_mm), ([0.0, 1.0], [0.0; 2]));
    assert!((last.turn_rad - interface.turn_rad()).abs() < 1e-12);
}

/// Frames from the crosshead's 0.07 mm to full slip of the interface, sorted.
fn delays(speed_mm_s: f64, n_per_mm: (f64, f64)) -> Vec<f64> {
    let mut frames: Vec<f64> = (0..48)
        .map(|seed| {
            let mut rng = stream(seed, Stream::Friction, 0);
            let objects: Vec<_> = group(false).collect();
            let object = objects[rng.count(0, objects.len() - 1)];
            let pose = Pose {
                x_mm: 2.5 * rng.normal(),
                y_mm: 1.5 * rng.normal() - 5.0,
                yaw_rad: 0.15 * rng.normal(),
                tilt: [0.004 * rng.normal(), 0.004 * rng.normal()],
            };
            let contact = Contact::draw(&mut rng, object, pose, Region::Centre);
            let mut interface = Interface::draw(&mut rng, object);
            let force_n = (2.2 * exp(0.55 * rng.normal())).clamp(0.4, 10.0);
            let stiffness_n_per_mm = rng.log_between(n_per_mm.0, n_per_mm.1);
            let mut map = PressureMap::empty();
            contact.pressures(force_n, [0.0; 2], &mut map);
            let reach = |step: usize| speed_mm_s * step as f64 * DT;
            let slips = (1..4800).find(|&step| {
                let position_mm = [0.0, reach(step)];
                let pull = Pull { position_mm, stiffness_n_per_mm, ..Pull::default() };
                let now = interface.step(&map, 1.0, pull, DT);
                now.fraction > 0.95 && now.speed_mm_s > 0.1
            });
            let slips = slips.map_or(f64::INFINITY, |step| step as f64 * DT);
            (slips - 0.07 / speed_mm_s) * 240.0
        })
        .collect();
    frames.sort_by(f64::total_cmp);
    frames
}

/// The crosshead has moved 0.07 mm long before a slow pull has stretched finger and fixture far enough. One
/// finger's share of a fixture that two fingers hang on is half its stiffness: the last range.
#[test]
fn full_slip_comes_after_the_encoders_onset_and_latest_when_slow() {
    println!("another brush calculation, 5–50 N/mm: median [23, 6.5, 3.3, 2.4, 2.1], 90th at 2 mm/s 103");
    for range in [(10.0, 100.0), (5.0, 50.0), (2.5, 25.0)] {
        let all = SPEEDS_MM_S.map(|speed| delays(speed, range));
        let medians = all.each_ref().map(|d| d[d.len() / 2]);
        let late = all.each_ref().map(|d| d[d.len() * 9 / 10]);
        println!("{range:?} N/mm, speeds {SPEEDS_MM_S:?} mm/s: frames from 0.07 mm to full slip");
        println!("  median {medians:.1?}, 90th percentile {late:.1?}");
        assert!(medians.windows(2).all(|w| w[0] > w[1] && w[1] > 0.0), "slower is later");
        assert!(late[0] > 20.0, "a long tail at 2 mm/s");
    }
}

/// Everything that [`Interface::draw`] draws can be written down; what follows from it is left out.
#[test]
fn the_draws_of_a_grasp_can_be_logged() {
    let drawn = Interface::draw(&mut stream(1, Stream::Friction, 0), named("hex-key").unwrap());
    let log = serde_json::to_value(&drawn).unwrap();
    let mut keys: Vec<_> = log.as_object().unwrap().keys().map(String::as_str).collect();
    keys.sort_unstable();
    let expected = [
        "brush_kpa_per_mm",
        "healing_s",
        "kinetic_share",
        "mu_correlation_mm",
        "mu_spread",
        "mu_static",
        "weakening_mm",
    ];
    assert_eq!(keys, expected);
}
