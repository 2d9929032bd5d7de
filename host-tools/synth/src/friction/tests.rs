//! The brush against closed forms.

use std::f64::consts::{FRAC_PI_2, PI};

use libm::{asin, cos, hypot, pow, sin};

use super::*;
use crate::check::{largest, near, quantile, within};
use crate::contact::tests::{CENTRED, hard, pressed};
use crate::contact::{Contact, Pose};
use crate::draw::{Stream, stream};
use crate::objects::{CATALOGUE, Shape, named};
use crate::recipe::{Region, SPEEDS_MM_S};

/// Pressure at each cell's centre, kPa at mm.
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

/// Pressures of a catalogue object that lies in the middle.
fn gripped(name: &str, layer_kpa_per_mm: f64, spread_mm: f64, force_n: f64) -> PressureMap {
    pressed(&Contact::new(named(name).unwrap(), CENTRED, layer_kpa_per_mm, spread_mm), force_n)
}

fn hertz_ball(p0: f64, a: f64) -> PressureMap {
    map_of(|x, y| p0 * (1.0 - (x * x + y * y) / (a * a)).max(0.0).sqrt())
}

/// Pull an interface whose friction does not weaken until it carries `share` of what it can, along y.
fn pulled(map: &PressureMap, k: f64, mu: f64, share: f64) -> (Interface, SlipState) {
    let mut interface = Interface::even(k, mu, 1.0);
    let force_n = share * mu * map.force_n();
    let stiffness_n_per_mm = 1e-4;
    let mut last = SlipState::default();
    for i in 1..=50 {
        let position_mm = [0.0, force_n / stiffness_n_per_mm * f64::from(i) / 50.0];
        last = interface.step(map, 1.0, Pull { position_mm, stiffness_n_per_mm, ..Pull::default() });
    }
    (interface, last)
}

/// Cells whose stress is below their cap.
fn sticking(interface: &Interface, map: &PressureMap) -> f64 {
    let sticks = |&&cell: &&usize| {
        let [x, y] = interface.stress_kpa[cell];
        (x * x + y * y).sqrt() < interface.mu[cell] * map.kpa[cell] * (1.0 - 1e-9)
    };
    map.loaded.iter().filter(sticks).count() as f64
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
    let (ball, rod) = (hertz_ball(p0, 8.0), map_of(|x, _| p0 * (1.0 - x * x / 64.0).max(0.0).sqrt()));
    let mut farthest = 0.0f64;
    for q in [0.1, 0.3, 0.5, 0.7, 0.9] {
        let (interface, last) = pulled(&ball, k, mu, q);
        let s = root(|s| 1.5 * s - 0.5 * s * s * s - q);
        let c = (sticking(&interface, &ball) / ball.loaded.len() as f64).sqrt();
        println!("ball at Q/μP {q}, c/a of Mindlin {:.3}", pow(1.0 - q, 1.0 / 3.0));
        near("c/a", c, (1.0 - s * s).sqrt(), 0.05);
        // Over the displacement at full slip, which 8 G*/(π a) makes the same for both.
        near("displacement", last.travel_mm[1] / (mu * p0 / k), s, 0.05);
        farthest = farthest.max((s / (1.0 - pow(1.0 - q, 2.0 / 3.0)) - 1.0).abs());

        let (interface, last) = pulled(&rod, k, mu, q);
        let s = root(|s| (asin(s) + s * (1.0 - s * s).sqrt()) / FRAC_PI_2 - q);
        let c = sticking(&interface, &rod) / rod.loaded.len() as f64;
        println!("rod at Q/μP {q}, c/a of Cattaneo {:.3}", (1.0 - q).sqrt());
        // A rod's stick zone is a whole number of columns: 24 of them make up the patch.
        within("c/a off", c - (1.0 - s * s).sqrt(), -0.05..0.05);
        near("displacement", last.travel_mm[1] / (mu * p0 / k), s, 0.05);
    }
    within("calibrated at full slip, the brush's displacement off Mindlin's", farthest, ..0.12);
}

/// The stiffness that makes brush and half-space slip through at the same displacement: 8 G*/(π a).
#[test]
fn full_slip_at_mindlins_displacement_by_calibration() {
    let (mu, p0, a, g_star) = (0.5, 150.0, 6.0, 700.0);
    let load_mn = 2.0 / 3.0 * PI * a * a * p0;
    let mindlin_mm = 3.0 * mu * load_mn / (16.0 * a * g_star);
    let (_, last) = pulled(&hertz_ball(p0, a), 8.0 * g_star / (PI * a), mu, 0.999);
    // At 0.999 of full slip the closed form of the brush is at 0.974 of it.
    let s = root(|s| 1.5 * s - 0.5 * s * s * s - 0.999);
    near("displacement at full slip, closed form", last.travel_mm[1], s * mindlin_mm, 0.05);
    near("displacement at full slip, Mindlin", last.travel_mm[1], mindlin_mm, 0.05);
}

/// Ciavarella and Jäger: the stick zone under Q is the patch of the load P − Q/μ. It holds for a layer as
/// it does for a half-space; there it makes c/a = (1 − Q/μP)^⅓ and ^½, here ^¼ and ^⅓.
#[test]
fn stick_zone_is_the_patch_of_a_smaller_load() {
    let (force_n, mu) = (12.0, 0.6);
    for (ball, shape) in [
        (true, Shape::Sphere { radius_mm: 60.0 }),
        (false, Shape::Cylinder { radius_mm: 60.0, length_mm: 200.0 }),
    ] {
        let contact = Contact::new(hard(shape), CENTRED, 300.0, 0.0);
        let map = pressed(&contact, force_n);
        for q in [0.2, 0.5, 0.8] {
            let (interface, _) = pulled(&map, 800.0, mu, q);
            let smaller = pressed(&contact, (1.0 - q) * force_n);
            let whole = map.loaded.len() as f64;
            let size = |cells: f64| if ball { (cells / whole).sqrt() } else { cells / whole };
            let (stuck, patch) = (size(sticking(&interface, &map)), size(smaller.loaded.len() as f64));
            let form = pow(1.0 - q, if ball { 0.25 } else { 1.0 / 3.0 });
            near(format!("{shape:?} at {q}: stick zone, patch of P − Q/μ"), stuck, patch, 0.05);
            near("closed form", stuck, form, if ball { 0.05 } else { 0.08 / form });
        }
    }
}

#[test]
fn full_slip_carries_kinetic_friction_and_the_spring_pulls_as_hard() {
    let mut rng = stream(11, Stream::Friction, 0);
    let (mut worst_full, mut worst_balance) = (0.0f64, 0.0f64);
    for (i, object) in CATALOGUE.iter().enumerate() {
        let pose = Pose { x_mm: 1.0, y_mm: -3.0, yaw_rad: 0.3, tilt: [0.003, 0.002] };
        let contact = Contact::draw(&mut rng, object, pose, Region::Centre);
        let map = pressed(&contact, 0.5 + 0.2 * i as f64);
        let (mu, share) = (object.mu_static, object.mu_kinetic / object.mu_static);
        let mut interface = Interface::even(1200.0, mu, share);
        let angle = i as f64;
        let stiffness_n_per_mm = 10.0 + 2.0 * i as f64;
        let mut now = SlipState::default();
        for step in 0..2400 {
            let reach = 0.004 * f64::from(step);
            let position_mm = [reach * cos(angle), reach * sin(angle)];
            now = interface.step(&map, 1.0, Pull { position_mm, stiffness_n_per_mm, ..Pull::default() });
            let off =
                [0, 1].map(|a| stiffness_n_per_mm * (position_mm[a] - now.travel_mm[a]) - now.shear_n[a]);
            worst_balance = worst_balance.max(hypot(off[0], off[1]) / (mu * map.force_n()));
        }
        let full = hypot(now.shear_n[0], now.shear_n[1]) / (object.mu_kinetic * map.force_n());
        worst_full = worst_full.max((full - 1.0).abs());
        assert!(now.fraction > 0.99, "{}: {}", object.name, now.fraction);
        assert!(now.direction[0] * cos(angle) + now.direction[1] * sin(angle) > 0.9999);
        assert!((now.speed_mm_s / (0.004 * STEP_HZ) - 1.0).abs() < 0.01);
    }
    within("full slip off μk P", worst_full, ..0.01);
    within("spring off shear, over μP", worst_balance, ..0.01);
}

/// Pulled and turned far, a patch reaches its limit surface, close to the ellipsoid (F/μN)² + (M/μNc)² = 1.
#[test]
fn shift_and_turn_together_stay_on_the_limit_surface() {
    let map = gripped("ball-knob", 1500.0, 0.6, 4.0);
    let mu = 0.7;
    let slipped = |speed: [f64; 2], spin: f64| {
        let mut interface = Interface::even(1500.0, mu, 1.0);
        let mut last = SlipState::default();
        for step in 0..3000 {
            let t = f64::from(step);
            let pull = Pull {
                position_mm: speed.map(|v| v * t),
                turn_rad: spin * t,
                stiffness_n_per_mm: 1e4,
                twist_n_mm_per_rad: if spin == 0.0 { 0.0 } else { 1e5 },
            };
            last = interface.step(&map, 1.0, pull);
        }
        assert!(last.fraction > 0.99);
        (hypot(last.shear_n[0], last.shear_n[1]), last.torque_n_mm)
    };
    let most_n = slipped([0.0, 2e-4], 0.0).0;
    let most_n_mm = slipped([0.0; 2], 2e-4).1;
    near("pulled only, N", most_n, mu * map.force_n(), 0.01);
    let moment: f64 = map.loaded.iter().map(|&c| map.kpa[c] * hypot(cell_mm(c).0, cell_mm(c).1)).sum();
    near("turned only, ∫ μ p r dA, N mm", most_n_mm, mu * moment * CELL_N, 0.01);
    // `c` times the turn against the shift.
    let c_mm = most_n_mm / most_n;
    for mix in [0.2, 0.5, 1.0, 2.0, 5.0] {
        for angle in [0.0, 0.9, 2.2] {
            let (force, torque) = slipped([2e-4 * cos(angle), 2e-4 * sin(angle)], 2e-4 * mix / c_mm);
            let (f, m) = (force / most_n, torque / most_n_mm);
            within(format!("turn over shift {mix}, at {angle} rad: F² + M²"), f * f + m * m, 0.9..=1.1);
        }
    }
}

/// The search over shifts alone is the search over shifts and turns of an object that cannot turn.
#[test]
fn a_held_turn_is_an_endlessly_stiff_one() {
    let map = gripped("usb-a-plug", 2500.0, 0.5, 2.0);
    let drawn = || Interface::draw(&mut stream(5, Stream::Friction, 0), named("usb-a-plug").unwrap());
    let (mut held, mut stiff) = (drawn(), drawn());
    let farthest = largest((0..2000).map(|step| {
        let t = f64::from(step) * STEP_S;
        let position_mm = [2.0 * sin(9.0 * t), 8.0 * t];
        let pull = Pull { position_mm, stiffness_n_per_mm: 30.0, ..Pull::default() };
        let a = held.step(&map, 1.0, pull).travel_mm;
        let b = stiff.step(&map, 1.0, Pull { twist_n_mm_per_rad: 1e9, ..pull }).travel_mm;
        hypot(a[0] - b[0], a[1] - b[1])
    }));
    within("held against endlessly stiff turn, mm apart after 7 mm", farthest, ..1e-4);
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
        for _ in 0..60 {
            let force_n = if rng.chance(0.15) { 0.0 } else { rng.log_between(0.05, 20.0) };
            let map = pressed(&contact, force_n);
            interface.release_unloaded(&map);
            let pull = Pull {
                position_mm: [5.0 * rng.normal(), 5.0 * rng.normal()],
                turn_rad: 0.5 * rng.normal(),
                stiffness_n_per_mm: rng.log_between(0.05, 500.0),
                twist_n_mm_per_rad: if rng.chance(0.5) { rng.log_between(1.0, 5000.0) } else { 0.0 },
            };
            for _ in 0..4 {
                let now = interface.step(&map, rng.between(0.9, 1.1), pull);
                let held_n = 1.3 * object.mu_static * map.force_n() + 1e-6;
                for axis in 0..2 {
                    let spring = pull.stiffness_n_per_mm * (pull.position_mm[axis] - now.travel_mm[axis]);
                    worst = worst.max((spring - now.shear_n[axis]).abs() / held_n);
                }
                if pull.twist_n_mm_per_rad > 0.0 {
                    let spring = pull.twist_n_mm_per_rad * (pull.turn_rad - now.turn_rad);
                    worst = worst.max((spring - now.torque_n_mm).abs() / (3.0 * held_n));
                }
                assert!(hypot(now.shear_n[0], now.shear_n[1]) < 1.6 * held_n);
                assert!(now.path_mm.is_finite() && now.fraction <= 1.0 + 1e-12);
                path += now.speed_mm_s * STEP_S;
            }
        }
    }
    within(format!("2880 steps, {path:.0} mm slid: off balance, over μP"), worst, ..0.01);
}

/// Slip that a turn makes grows from the point it turns about, and has no direction.
#[test]
fn a_turn_slides_without_a_direction() {
    let map = gripped("ball-knob", 1500.0, 0.6, 4.0);
    let mut interface = Interface::even(1500.0, 0.6, 0.85);
    let (mut path, mut last) = (0.0, SlipState::default());
    for step in 0..1200 {
        let pull = Pull { turn_rad: f64::from(step) * STEP_S, twist_n_mm_per_rad: 500.0, ..Pull::default() };
        last = interface.step(&map, 1.0, pull);
        assert!(last.path_mm >= path);
        path = last.path_mm;
    }
    let sum = |of: fn(usize) -> f64| map.loaded.iter().map(|&c| map.kpa[c] * of(c)).sum::<f64>();
    let lever_mm = sum(|c| hypot(cell_mm(c).0, cell_mm(c).1)) / sum(|_| 1.0);
    near("turning at 1 rad/s: mm/s, mean lever", last.speed_mm_s, lever_mm, 0.03);
    assert_eq!((last.direction, last.travel_mm), ([0.0, 1.0], [0.0; 2]));
}

/// Frames from the crosshead's 0.07 mm to full slip of the interface.
fn delays(speed_mm_s: f64, n_per_mm: (f64, f64)) -> Vec<f64> {
    let objects: Vec<_> = CATALOGUE.iter().filter(|object| !object.held_out()).collect();
    let delay = |seed| {
        let mut rng = stream(seed, Stream::Friction, 0);
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
        let stiffness_n_per_mm = rng.log_uniform(n_per_mm);
        let map = pressed(&contact, force_n);
        let slips = (1..4800).find(|&step| {
            let position_mm = [0.0, speed_mm_s * f64::from(step) * STEP_S];
            let pull = Pull { position_mm, stiffness_n_per_mm, ..Pull::default() };
            let now = interface.step(&map, 1.0, pull);
            now.fraction > 0.95 && now.speed_mm_s > 0.1
        });
        (slips.map_or(f64::INFINITY, |step| f64::from(step) * STEP_S) - 0.07 / speed_mm_s) * 240.0
    };
    (0..48).map(delay).collect()
}

/// The crosshead has moved 0.07 mm long before a slow pull has stretched finger and fixture far enough. One
/// finger's share of a fixture that two fingers hang on is half its stiffness: the last range.
#[test]
fn full_slip_comes_after_the_encoders_onset_and_latest_when_slow() {
    println!("another brush calculation, 5–50 N/mm: median [23, 6.5, 3.3, 2.4, 2.1], 90th at 2 mm/s 103");
    for range in [(10.0, 100.0), (5.0, 50.0), (2.5, 25.0)] {
        let all = SPEEDS_MM_S.map(|speed| delays(speed, range));
        let medians = all.each_ref().map(|d| quantile(d.clone(), 0.5));
        let late = all.map(|d| quantile(d, 0.9));
        println!("{range:?} N/mm, speeds {SPEEDS_MM_S:?} mm/s: frames from 0.07 mm to full slip");
        println!("  median {medians:.1?}, 90th percentile {late:.1?}");
        assert!(medians.windows(2).all(|w| w[0] > w[1] && w[1] > 0.0), "slower is later");
        assert!(late[0] > 20.0, "a long tail at 2 mm/s");
    }
}
