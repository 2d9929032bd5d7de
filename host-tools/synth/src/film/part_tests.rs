//! The film's parts against their definitions.

use slipsense::params::COUNT_MAX;
use slipsense_recording::film::{EXPONENT, FULL_SCALE_KPA, counts};

use super::creep::{Creep, TERMS};
use super::hysteresis::{Hysteresis, PLAYS};
use crate::check::{near, within};

#[test]
fn light_grips_read_five_counts_per_kpa_and_5_mpa_is_full_scale() {
    for exponent in [EXPONENT - 0.05, EXPONENT, EXPONENT + 0.05] {
        for kpa in [0.1, 1.0, 5.0, 20.0] {
            within(format!("m {exponent:.2}, {kpa} kPa: counts/kPa"), counts(kpa, exponent) / kpa, 5.0..);
        }
        near("5 MPa, counts", counts(FULL_SCALE_KPA, exponent), f64::from(COUNT_MAX), 0.02);
    }
    assert_eq!(counts(0.0, EXPONENT), 0.0);
}

const DT: f64 = 1.0 / 240.0;

/// What creep adds to 50 kPa, kPa, at every frame of `seconds` of load.
fn loaded(creep: &Creep, terms: &mut [f64; TERMS], seconds: f64) -> Vec<f64> {
    let blend = creep.blend(DT);
    (0..(seconds / DT) as usize).map(|_| creep.step(terms, 50.0, &blend)).collect()
}

#[test]
fn creep_rises_by_its_share_per_decade() {
    for per_decade in [0.01, 0.03, 0.05] {
        let creep = Creep { per_decade, slowdown: 2.0, residual: 0.1 };
        let extra = loaded(&creep, &mut [0.0; TERMS], 101.0);
        let at = |t: f64| extra[(t / DT) as usize] / 50.0;
        for (from, to) in [(0.1, 1.0), (1.0, 10.0), (10.0, 100.0)] {
            near(format!("rise from {from} to {to} s"), at(to) - at(from), per_decade, 0.12);
        }
    }
}

#[test]
fn creep_recovers_more_slowly_than_it_builds_up() {
    for slowdown in [1.5, 4.0] {
        let creep = Creep { per_decade: 0.03, slowdown, residual: 0.1 };
        let mut terms = [0.0; TERMS];
        let rise = loaded(&creep, &mut terms, 10.0);
        let blend = creep.blend(DT);
        let fall: Vec<f64> = (0..24_000).map(|_| creep.step(&mut terms, 0.0, &blend)).collect();
        let last = rise[rise.len() - 1];
        // The slow half: from 70 % on, in both directions.
        let up = rise.iter().position(|&e| e > 0.7 * last).unwrap() as f64 * DT;
        let down = fall.iter().position(|&e| e < 0.3 * 0.1 * last).unwrap() as f64 * DT;
        within(format!("70 % recovered in, s, against {up:.2} s"), down, slowdown * up..);
        // A tenth of a count at least, so that there is something to recover from.
        within("left at once, kPa", fall[0], 0.1 / 5.0..0.11 * last);
        assert!(fall.is_sorted_by(|a, b| a >= b));
    }
}

/// Rising to `peak` and back in steps of 0.1 %: largest difference of the outputs over the excursion.
fn loop_width(film: &Hysteresis, peak_kpa: f64) -> f64 {
    let mut plays = [0.0; PLAYS];
    let ramp: Vec<f64> = (0..=1000).map(|i| peak_kpa * i as f64 / 1000.0).collect();
    let mut run = |kpa: f64| counts(film.step(&mut plays, kpa), EXPONENT);
    let up: Vec<f64> = ramp.iter().map(|&p| run(p)).collect();
    let down: Vec<f64> = ramp.iter().rev().map(|&p| run(p)).collect();
    assert_eq!(down[1000], 0.0, "a released film stands at zero");
    assert!(down.is_sorted_by(|a, b| a >= b), "falling load, falling output");
    let widest = up.iter().zip(down.iter().rev()).fold(0.0f64, |w, (u, d)| w.max(d - u));
    widest / up[1000]
}

#[test]
fn hysteresis_loop_is_as_drawn_for_light_grips_and_at_full_scale() {
    for share in [0.02, 0.05, 0.08] {
        let film = Hysteresis::new(share);
        for peak_kpa in [10.0, 50.0, 250.0, 1000.0, FULL_SCALE_KPA] {
            near(format!("loop from 0 to {peak_kpa} kPa"), loop_width(&film, peak_kpa), share, 0.15);
        }
    }
}

#[test]
fn a_minor_loop_lies_inside_the_major_one() {
    let film = Hysteresis::new(0.08);
    let mut plays = [0.0; PLAYS];
    let mut to = |from: f64, to: f64| {
        (0..=200).map(|i| film.step(&mut plays, from + (to - from) * i as f64 / 200.0)).last().unwrap()
    };
    let (up, peak) = (to(0.0, 60.0), to(60.0, 100.0));
    let down = to(100.0, 60.0);
    let (back, again) = (to(60.0, 100.0), to(100.0, 60.0));
    assert!(
        down > up && (back - peak).abs() < 1e-9 && (again - down).abs() < 1e-9,
        "{up} {down} {peak} {back}"
    );
}
