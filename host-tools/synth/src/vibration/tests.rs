//! The vibration against closed forms; each test prints what it measured beside what it expects.

mod slip;
mod surroundings;

use super::signal::cos_turns;
use super::*;
use crate::check::{above_10_hz, largest, median, near, power_at, quantile, within};
use crate::draw::{Stream, stream};
use crate::families::Families;
use crate::friction::STEP_HZ;
use crate::objects::{Kind, Object, named};
use crate::recipe::Platform;
use crate::timeline::{Pulse, Timeline};
use libm::{cos, log, sin};
use std::f64::consts::TAU;

const RATE_HZ: f64 = 8_000.0;

fn rng(seed: u64) -> Rng {
    stream(seed, Stream::Vibration, 0)
}

fn rng_of_families() -> Rng {
    stream(0, Stream::Families, 1)
}

fn clock(seconds: f64) -> Clock {
    Clock { rate_hz: RATE_HZ, drift_per_s: 0.0, start: 0.0, samples: (seconds * RATE_HZ) as usize }
}

fn still(seconds: f64) -> Motion {
    Motion::still(0, clock(seconds))
}

/// Gross slip along the finger at constant speed and grip.
fn sliding(speed_mm_s: f64, grip_n: f64, seconds: f64) -> SlipSeries {
    let steps = (seconds * STEP_HZ) as usize + 2;
    SlipSeries {
        speed_mm_s: vec![speed_mm_s; steps],
        fraction: vec![1.0; steps],
        path_mm: (0..steps).map(|i| i as f64 * speed_mm_s / STEP_HZ).collect(),
        direction: vec![[0.0, 1.0]; steps],
        grip_n: vec![grip_n; steps],
    }
}

/// An object of Ra 1 µm without texture.
fn plain() -> &'static Object {
    let object = named("shore-88-block").unwrap();
    Box::leak(Box::new(Object {
        roughness_um: 1.0,
        stick_slip: 0.2,
        kind: Kind::Material,
        ring_hz: 0.0,
        texture_mm: Vec::new(),
        ..object.clone()
    }))
}

/// A grip is held, the crosshead moves, and nothing else happens.
fn held(grip_n: f64, crosshead_mm_s: f64, seconds: f64) -> Timeline {
    let mut timeline = Timeline::new(seconds);
    timeline.grip_n.fill(grip_n);
    timeline.motion.fill(1.0);
    for (i, mm) in timeline.crosshead_mm.iter_mut().enumerate() {
        *mm = i as f64 * crosshead_mm_s / STEP_HZ;
    }
    timeline
}

fn scene(timeline: &Timeline) -> Scene<'_> {
    Scene {
        platform: Platform::Umi,
        source: SourceFamily::Asperities,
        families: Families::default(),
        content: VibrationContent::All,
        rig_leak: true,
        hand_held: false,
        linked: true,
        shared_table: false,
        object: plain(),
        timeline,
    }
}

fn rms(g: &[[f64; 3]]) -> f64 {
    (g.iter().flatten().map(|x| x * x).sum::<f64>() / g.len() as f64).sqrt()
}

/// Vector rms above 10 Hz, without the first tenth of a second.
fn rms_above_10_hz(g: &[[f64; 3]]) -> f64 {
    rms(&above_10_hz(g.iter().copied())[800..])
}

/// Slope of a least-squares line.
fn slope(points: &[(f64, f64)]) -> f64 {
    let n = points.len() as f64;
    let (mx, my) = (points.iter().map(|p| p.0).sum::<f64>() / n, points.iter().map(|p| p.1).sum::<f64>() / n);
    points.iter().map(|(x, y)| (x - mx) * (y - my)).sum::<f64>()
        / points.iter().map(|(x, _)| (x - mx) * (x - mx)).sum::<f64>()
}

#[test]
fn the_polynomial_sine_is_a_sine() {
    let worst = largest((-4000..4000).map(|i| {
        let turns = f64::from(i) * 0.000_731;
        (sin_turns(turns) - sin(TAU * turns)).abs().max((cos_turns(turns) - cos(TAU * turns)).abs())
    }));
    within("largest error of the sine", worst, ..4e-6);
}

#[test]
fn a_drifting_clock_and_its_inverse_agree() {
    let clock = Clock { rate_hz: 8_180.0, drift_per_s: 5e-6, start: 0.4, samples: 1_000_000 };
    let off = |n: usize| (clock.periods(clock.time(n)) - n as f64).abs();
    let most = largest((0..1_000_000).step_by(997).map(off));
    within("clock against its inverse over two minutes", most, ..1e-6);
    let ends = clock.ends(28_800);
    assert!(ends.windows(2).all(|w| (33..=35).contains(&(w[1] - w[0]))));
}
