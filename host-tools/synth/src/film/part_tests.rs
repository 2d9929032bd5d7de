//! The film's parts against their definitions, and the crosstalk formula against the whole network.

use libm::pow;
use nalgebra::{DMatrix, DVector};
use slipsense::params::{COUNT_MAX, TAXEL_COLS, TAXEL_ROWS, TAXELS};
use slipsense::sensor::is_active;

use super::creep::{Creep, TERMS};
use super::crosstalk::Crosstalk;
use super::hysteresis::{Hysteresis, PLAYS};
use super::transfer::{EXPONENT, FULL_SCALE_KPA, asymptote_counts, conductance, counts};
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

/// Pressures of a grip: a soft-edged patch with its middle at `row`, `col`, kPa.
fn patch(row: f64, col: f64, half: (f64, f64), peak_kpa: f64) -> Vec<f64> {
    (0..TAXELS)
        .map(|cell| {
            let (r, c) = (cell / TAXEL_COLS, cell % TAXEL_COLS);
            let (u, v) = ((r as f64 - row) / half.0, (c as f64 - col) / half.1);
            if is_active(r, c) { peak_kpa * (1.0 - u * u - v * v).max(0.0) } else { 0.0 }
        })
        .collect()
}

/// What each taxel conducts with its resistor in series, relative to the resistor's conductance.
fn conduct(kpa: &[f64]) -> Box<[f64; TAXELS]> {
    let of = |p: f64| conductance(p, EXPONENT) / (1.0 + conductance(p, EXPONENT));
    Box::new(std::array::from_fn(|cell| of(kpa[cell])))
}

/// Kirchhoff's equations of the 32 rows and 32 columns. Every line hangs on one closed switch (`on`) and
/// one open one (`off`), conductances: a row between drive (1) and ground, a column between amplifier and
/// ground, both at 0. Which of the two is closed does not change the matrix, so that one factorisation
/// serves all readings.
fn network(g: &[f64; TAXELS], on: f64, off: f64) -> DMatrix<f64> {
    let mut matrix =
        DMatrix::from_diagonal_element(TAXEL_ROWS + TAXEL_COLS, TAXEL_ROWS + TAXEL_COLS, on + off);
    for (cell, &g) in g.iter().enumerate() {
        let (row, col) = (cell / TAXEL_COLS, TAXEL_ROWS + cell % TAXEL_COLS);
        matrix[(row, row)] += g;
        matrix[(col, col)] += g;
        matrix[(row, col)] -= g;
        matrix[(col, row)] -= g;
    }
    matrix
}

/// Zero-potential readings of the whole network, as conductances. Open against closed switch makes a
/// divider at either end that costs all readings the same; that gain is taken out.
fn nodal(g: &[f64; TAXELS], on: f64, off: f64) -> Box<[f64; TAXELS]> {
    let solver = network(g, on, off).lu();
    let gain = (1.0 + off / on) * (1.0 + off / on);
    let mut readings = Box::new([0.0; TAXELS]);
    for row in 0..TAXEL_ROWS {
        let drive = |node: usize| match node {
            n if n == row => on,
            n if n < TAXEL_ROWS => off,
            _ => 0.0,
        };
        let volts = solver.solve(&DVector::from_fn(TAXEL_ROWS + TAXEL_COLS, |n, _| drive(n))).unwrap();
        let cols = volts.rows(TAXEL_ROWS, TAXEL_COLS);
        let leaked = off * cols.sum();
        for col in 0..TAXEL_COLS {
            readings[row * TAXEL_COLS + col] = gain * ((on - off) * cols[col] + leaked);
        }
    }
    readings
}

/// Reading of one taxel with all other lines left open.
fn floating(g: &[f64; TAXELS], on: f64, row: usize, col: usize) -> f64 {
    let mut matrix = network(g, 0.0, 1e-9);
    matrix[(row, row)] += on;
    matrix[(TAXEL_ROWS + col, TAXEL_ROWS + col)] += on;
    let mut drive = DVector::zeros(TAXEL_ROWS + TAXEL_COLS);
    drive[row] = on;
    on * matrix.lu().solve(&drive).unwrap()[TAXEL_ROWS + col]
}

/// Largest and rms difference from the nodal solution, in counts, and the rms of the own conductances'.
fn errors(kpa: &[f64], line: f64, leak: f64) -> (f64, f64, f64) {
    let g = conduct(kpa);
    let on = 1.0 / line;
    let truth = nodal(&g, on, on * leak / TAXEL_ROWS as f64);
    let mut first_order = g.clone();
    Crosstalk { line, row_leak: leak, col_leak: leak }.apply(&mut first_order, 1.0);
    let (mut worst, mut sum, mut bare) = (0.0f64, 0.0, 0.0);
    for cell in 0..TAXELS {
        let error = asymptote_counts() * (first_order[cell] - truth[cell]).abs();
        worst = worst.max(error);
        sum += error * error;
        bare += pow(asymptote_counts() * (g[cell] - truth[cell]), 2.0);
    }
    let rms = |sum: f64| (sum / TAXELS as f64).sqrt();
    (worst, rms(sum), rms(bare))
}

#[test]
fn first_order_crosstalk_is_close_to_the_whole_network() {
    let grips = [
        ("cable, 2 N", patch(15.0, 12.0, (7.0, 2.2), 110.0)),
        ("flat, 2 N", patch(16.0, 16.0, (9.0, 9.0), 25.0)),
        ("flat, 10 N", patch(14.0, 18.0, (9.0, 9.0), 125.0)),
    ];
    for (name, kpa) in &grips {
        for (line, leak) in [(0.001, 0.002), (0.003, 0.006), (0.01, 0.02)] {
            let (worst, rms, bare) = errors(kpa, line, leak);
            // No more than second-order terms are missing, no taxel is off by more than rounding.
            within(format!("{name}, R_on {line}, leak {leak}: rms error, counts"), rms, ..0.03 * bare);
            within("largest error, counts", worst, ..0.5);
        }
    }
    let (worst, ..) = errors(&patch(16.0, 16.0, (9.0, 9.0), 600.0), 0.01, 0.02);
    within("flat, 50 N, worst readout: error over the peak", worst / counts(600.0, EXPONENT), ..0.01);
}

#[test]
fn three_corners_show_a_fourth_only_in_a_floating_read() {
    let mut kpa = vec![0.0; TAXELS];
    for (row, col) in [(10, 10), (10, 20), (20, 10)] {
        kpa[row * TAXEL_COLS + col] = 100.0;
    }
    let g = conduct(&kpa);
    let corner = asymptote_counts() * g[10 * TAXEL_COLS + 10];
    for line in [0.001, 0.01] {
        let ghost = asymptote_counts() * floating(&g, 1.0 / line, 20, 20);
        let held = asymptote_counts() * nodal(&g, 1.0 / line, 0.0)[20 * TAXEL_COLS + 20];
        near(format!("R_on {line}: fourth corner floating, a third"), ghost, corner / 3.0, 0.05);
        within("at zero potential", held, ..0.01 * ghost);
    }
}
