//! The elastic half-space beside the layer of the generator. A small solver of its own, with Boussinesq's
//! influence of a load on a surface, is held to Hertz and to Cattaneo and Mindlin; then the generator's
//! layer is held to the half-space, with the stiffness that makes the patches equal.
//!
//! Contact and friction are the same problem here: tractions `0 ≤ t ≤ most` that come as near as they can
//! to a wanted displacement. In the normal direction `most` is infinite and the wanted displacement is the
//! indentation less the gap; tangentially (at Poisson's ratio 0, where the two directions of Cerruti's
//! influence do not mix) `most` is μp and the wanted displacement is that of the rigid object.

use std::f64::consts::PI;

use libm::{asinh, log, pow};

use super::tests::{CENTRED, hard, peak, pressed};
use super::{CELL_MM2, Contact};
use crate::check::{largest, near};
use crate::objects::Shape;

/// Contact modulus E* of the half-space, MPa. At ν = 0 it is Young's modulus.
const E_STAR: f64 = 3.0;
/// Shear modulus at ν = 0, MPa.
const G: f64 = E_STAR / 2.0;

/// Dense symmetric influence of unit tractions on displacements, mm per MPa.
type Influence = Vec<Vec<f64>>;

fn influence(count: usize, of: impl Fn(usize, usize) -> f64) -> Influence {
    (0..count).map(|i| (0..count).map(|j| of(i, j)).collect()).collect()
}

/// Minimum of `½ t·A·t − wanted·t` over `0 ≤ t ≤ most`: projected Gauss–Seidel with over-relaxation.
fn solve(influence: &Influence, wanted: &[f64], most: &[f64]) -> Vec<f64> {
    let mut t = vec![0.0; wanted.len()];
    for _ in 0..5000 {
        let (mut change, mut size) = (0.0f64, 0.0f64);
        for (i, row) in influence.iter().enumerate() {
            let there: f64 = row.iter().zip(&t).map(|(a, t)| a * t).sum();
            let next = (t[i] + 1.4 * (wanted[i] - there) / row[i]).clamp(0.0, most[i]);
            change = change.max((next - t[i]).abs());
            t[i] = next;
            size = size.max(next);
        }
        if change <= 1e-7 * size {
            break;
        }
    }
    t
}

/// Displacement at `(x, y)`, times π E*, from unit pressure on a square of half side `h` (A. E. H. Love 1929).
fn square(x: f64, y: f64, h: f64) -> f64 {
    let part = |x: f64, y: f64| x * asinh(y / x.abs()) + y * asinh(x / y.abs());
    part(x + h, y + h) - part(x - h, y + h) - part(x + h, y - h) + part(x - h, y - h)
}

/// A quarter of a square grid; the other quarters mirror it.
#[test]
fn ball_on_a_half_space_meets_hertz_and_mindlin() {
    let (radius_mm, depth_mm, side, step_mm) = (10.0, 0.1, 22, 0.06);
    let cells = side * side;
    let centre = |i: usize| [i % side, i / side].map(|n| (n as f64 + 0.5) * step_mm);
    let influence = influence(cells, |i, j| {
        let ([xi, yi], [xj, yj]) = (centre(i), centre(j));
        let mirrored = [(1.0, 1.0), (-1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)];
        let of = |(sx, sy): (f64, f64)| square(xi - sx * xj, yi - sy * yj, step_mm / 2.0);
        mirrored.map(of).iter().sum::<f64>() / (PI * E_STAR)
    });
    let force_n = |t: &[f64]| 4.0 * t.iter().sum::<f64>() * step_mm * step_mm;
    // Radius of the disc as large as the cells that count.
    let radius_of_mm = |counts: &dyn Fn(usize) -> bool| {
        let cells = 4 * (0..cells).filter(|&i| counts(i)).count();
        (cells as f64 * step_mm * step_mm / PI).sqrt()
    };
    let gap_mm = |[x, y]: [f64; 2]| (x * x + y * y) / (2.0 * radius_mm);
    let wanted: Vec<f64> = (0..cells).map(|i| depth_mm - gap_mm(centre(i))).collect();
    let pressure = solve(&influence, &wanted, &vec![f64::INFINITY; cells]);
    let load_n = force_n(&pressure);
    let peak = largest(pressure.iter().copied());
    let a = radius_of_mm(&|i| pressure[i] > 0.0);
    let a_hertz = pow(3.0 * load_n * radius_mm / (4.0 * E_STAR), 1.0 / 3.0);
    near("load, N", load_n, 4.0 / 3.0 * E_STAR * radius_mm.sqrt() * pow(depth_mm, 1.5), 0.05);
    near("patch radius, mm", a, a_hertz, 0.05);
    near("peak pressure, MPa", peak, 3.0 * load_n / (2.0 * PI * a_hertz * a_hertz), 0.05);

    let mu = 0.6;
    let most: Vec<f64> = pressure.iter().map(|p| mu * p).collect();
    // 1/G* = (2 − ν)/G of the one elastic body, at ν = 0.
    let g_star = G / 2.0;
    let full_mm = 3.0 * mu * load_n / (16.0 * a_hertz * g_star);
    for share in [0.15, 0.35, 0.6, 0.85] {
        let shear = solve(&influence, &vec![share * full_mm; cells], &most);
        let q = force_n(&shear) / (mu * load_n);
        let c = radius_of_mm(&|i| pressure[i] > 0.0 && shear[i] < most[i] * (1.0 - 1e-6));
        near(format!("Q/μP {q:.3}: stick radius c/a"), c / a, pow(1.0 - q, 1.0 / 3.0), 0.05);
        let expected_mm = full_mm * (1.0 - pow(1.0 - q, 2.0 / 3.0));
        near(format!("Q/μP {q:.3}: displacement, mm"), share * full_mm, expected_mm, 0.05);
    }
    // More than Mindlin's displacement at full slip: everything slides.
    let all = force_n(&solve(&influence, &vec![1.03 * full_mm; cells], &most));
    near("full slip, Q/μP", all / (mu * load_n), 1.0, 0.01);
}

/// Half of a rod's patch in strips; the other half mirrors it.
#[test]
fn rod_on_a_half_space_meets_hertz_and_cattaneo() {
    let (radius_mm, step_mm, strips) = (10.0, 0.015, 100);
    // Displacements of a plane problem are relative: to a place this far away.
    let far_mm = 50.0;
    let strip = |x: f64| {
        let part = |x: f64| x * (log(x.abs() / far_mm) - 1.0);
        -2.0 / (PI * E_STAR) * (part(x + step_mm / 2.0) - part(x - step_mm / 2.0))
    };
    let at = |i: usize| (i as f64 + 0.5) * step_mm;
    let influence = influence(strips, |i, j| strip(at(i) - at(j)) + strip(at(i) + at(j)));
    let wanted: Vec<f64> = (0..strips).map(|i| 0.25 - at(i) * at(i) / (2.0 * radius_mm)).collect();
    let pressure = solve(&influence, &wanted, &vec![f64::INFINITY; strips]);
    let load = 2.0 * step_mm * pressure.iter().sum::<f64>();
    let peak = largest(pressure.iter().copied());
    let b = pressure.iter().filter(|p| **p > 0.0).count() as f64 * step_mm;
    let b_hertz = (4.0 * load * radius_mm / (PI * E_STAR)).sqrt();
    assert!(b < 0.9 * strips as f64 * step_mm);
    near("half width, mm", b, b_hertz, 0.05);
    near("peak pressure, MPa", peak, 2.0 * load / (PI * b_hertz), 0.05);

    let mu = 0.6;
    let most: Vec<f64> = pressure.iter().map(|p| mu * p).collect();
    for wanted_mm in [0.02, 0.05, 0.09, 0.12] {
        let shear = solve(&influence, &vec![wanted_mm; strips], &most);
        let q = 2.0 * step_mm * shear.iter().sum::<f64>() / (mu * load);
        assert!((0.05..0.98).contains(&q), "{q}");
        let sticks = |i: &usize| pressure[*i] > 0.0 && shear[*i] < most[*i] * (1.0 - 1e-6);
        let c = (0..strips).filter(sticks).count() as f64 * step_mm;
        near(format!("Q/μP {q:.3}: stick half width c/b"), c / b, (1.0 - q).sqrt(), 0.05);
    }
}

/// A layer of stiffness K has the half-space's patch at the same load when K = 16 E*/3πa under a ball and
/// 3π E*/8b under a rod (K. L. Johnson, Contact Mechanics, section 4.3: 1.70 and 1.18 E*/a). Its pressure
/// is then a parabola and not half an ellipse, with a peak 4/3 and 1.18 times as high.
#[test]
fn the_layer_calibrated_to_the_half_space_has_its_patch_but_not_its_peak() {
    let (radius_mm, force_n) = (60.0, 8.0);

    let a = pow(3.0 * force_n * radius_mm / (4.0 * E_STAR), 1.0 / 3.0);
    let k = 16.0 * E_STAR / (3.0 * PI * a);
    let ball = Contact::new(hard(Shape::Sphere { radius_mm }), CENTRED, 1e3 * k, 0.0);
    let map = pressed(&ball, force_n);
    near("patch radius, mm", (map.loaded.len() as f64 * CELL_MM2 / PI).sqrt(), a, 0.05);
    let p0 = 3.0 * force_n / (2.0 * PI * a * a);
    near("peak over Hertz's", 1e-3 * peak(&map) / p0, 4.0 / 3.0, 0.05);

    let length_mm = 32.0 * 0.92;
    let b = (4.0 * force_n / length_mm * radius_mm / (PI * E_STAR)).sqrt();
    let k = 3.0 * PI * E_STAR / (8.0 * b);
    let rod = Contact::new(hard(Shape::Cylinder { radius_mm, length_mm: 200.0 }), CENTRED, 1e3 * k, 0.0);
    let map = pressed(&rod, force_n);
    let p0 = 2.0 * force_n / length_mm / (PI * b);
    // Columns are 0.7 mm apart: the patch's edge is known from its pressure, p0 (1 − x²/b²).
    let of = |col: usize| map.kpa[16 * 32 + col] * 1e-3;
    let (inner, outer) = (of(16), of(18));
    let measured_b = ((1.75 * 1.75 * inner - 0.35 * 0.35 * outer) / (inner - outer)).sqrt();
    near("half width, mm", measured_b, b, 0.05);
    near("peak over Hertz's", 1e-3 * peak(&map) / p0, 3.0 * PI / 8.0, 0.05);
}
