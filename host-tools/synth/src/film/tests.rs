//! The array as a whole: idle level, range, memory, faults.

use slipsense::params::{ACTIVE_TAXELS, CONTACT_SUM_MIN, COUNT_MAX, TAXEL_COLS, TAXELS};
use slipsense::sensor::is_active;

use super::session::{Fault, FaultKind};
use super::*;
use crate::contact::CELL_MM2;
use crate::draw::{Stream, stream};
use crate::scenario::levels::{JAW_PICKUP_COUNTS, MOTOR_PICKUP_COUNTS, TOOL_PICKUP_COUNTS};
use libm::sin;

fn unit(seed: u64) -> FilmUnit {
    FilmUnit::draw(&mut stream(seed, Stream::Unit, 0))
}

fn session(seed: u64, noise_factor: f64) -> FilmSession {
    FilmSession::draw(&mut stream(seed, Stream::Film, 0), noise_factor)
}

/// A session without faults.
fn sound(seed: u64, noise_factor: f64) -> FilmSession {
    FilmSession { faults: Vec::new(), ..session(seed, noise_factor) }
}

fn film(unit: &FilmUnit, session: FilmSession, seed: u64) -> Film<'_> {
    Film::new(unit, session, stream(seed, Stream::Film, 1))
}

/// `force_n` spread evenly over the taxels within `radius_mm` of the middle.
fn pressed(force_n: f64, radius_mm: f64) -> PressureMap {
    let mut map = PressureMap::empty();
    let within = |&cell: &usize| {
        let (x, y) = crate::contact::cell_mm(cell);
        is_active(cell / TAXEL_COLS, cell % TAXEL_COLS) && x * x + y * y < radius_mm * radius_mm
    };
    map.loaded = (0..TAXELS).filter(within).collect();
    for &cell in &map.loaded {
        map.kpa[cell] = force_n * 1e3 / CELL_MM2 / map.loaded.len() as f64;
    }
    map
}

fn scans(film: &mut Film<'_>, map: &PressureMap, frames: std::ops::Range<usize>) -> Vec<PiezoFrame> {
    frames.map(|frame| film.scan(frame, map, 0.0, |_| 1.0)).collect()
}

/// Mean idle count that unit and session must have: a Gaussian about the idle level, below 0 cut off by the
/// converter, averaged over the mains' phases.
fn idle_mean(unit: &FilmUnit, session: &FilmSession) -> f64 {
    const PHASES: usize = 32;
    let sigma = unit.noise_counts * session.noise_factor;
    let clipped =
        |level: f64| -> f64 { (1..16).map(|n| noise::above((n as f64 - 0.5 - level) / sigma)).sum() };
    let hum = unit.mains_counts * session.mains_share * session.noise_factor;
    let of_level = |level: f64| {
        let at =
            |phase: usize| clipped(level + hum * sin(std::f64::consts::TAU * phase as f64 / PHASES as f64));
        (0..PHASES).map(at).sum::<f64>() / PHASES as f64
    };
    let stuck = |cell: usize| unit.stuck.iter().find(|s| s[0] * TAXEL_COLS + s[1] == cell);
    let active = (0..TAXELS).filter(|&cell| is_active(cell / TAXEL_COLS, cell % TAXEL_COLS));
    let levels = active.map(|cell| match stuck(cell) {
        Some(&[_, _, level]) => level as f64,
        None => of_level(f64::from(unit.offset[cell]) + session.zero_counts),
    });
    levels.sum::<f64>() / ACTIVE_TAXELS as f64
}

#[test]
fn an_untouched_pad_of_any_unit_is_no_contact() {
    let (mut worst_mean, mut worst_error, mut worst_share) = (0.0f64, 0.0f64, 0.0f64);
    let (mut over, mut frames) = (0, 0);
    for seed in 0..60 {
        let unit = unit(seed);
        let session = sound(seed, 1.0);
        let sums: Vec<u32> = scans(&mut film(&unit, session.clone(), seed), &PressureMap::empty(), 0..240)
            .iter()
            .map(PiezoFrame::sum)
            .collect();
        let mean = sums.iter().sum::<u32>() as f64 / sums.len() as f64 / ACTIVE_TAXELS as f64;
        let touched = sums.iter().filter(|&&sum| sum >= CONTACT_SUM_MIN).count();
        worst_mean = worst_mean.max(mean);
        let expected = idle_mean(&unit, &session);
        worst_error = worst_error.max((mean - expected).abs() / (0.01 + 0.1 * expected));
        worst_share = worst_share.max(touched as f64 / sums.len() as f64);
        (over, frames) = (over + touched, frames + sums.len());
    }
    println!(
        "60 units: largest mean idle count {worst_mean:.3} (below 1 asked for), off by {worst_error:.2} of \
         10 % and 0.01 from a clipped Gaussian; {over} of {frames} idle frames read as contact, worst unit \
         {worst_share:.4}"
    );
    assert!(worst_mean < 0.5 && worst_share < 0.01 && worst_error < 1.0);
}

#[test]
fn fifty_newtons_stay_in_twelve_bits_and_saturate_softly() {
    let unit = FilmUnit { gain: Box::new([1.0; TAXELS]), ..unit(1) };
    for (force_n, radius_mm) in [(50.0, 6.0), (50.0, 2.0), (500.0, 5.64)] {
        let map = pressed(force_n, radius_mm);
        let scans = scans(&mut film(&unit, sound(1, 1.0), 1), &map, 0..24);
        let peak = scans[23].counts().iter().copied().max().unwrap();
        let kpa = map.kpa[map.loaded[0]];
        println!("{force_n} N over {radius_mm} mm, {kpa:.0} kPa: peak {peak} of {COUNT_MAX}");
        assert!(scans.iter().flat_map(|s| s.counts()).all(|&c| c <= COUNT_MAX));
        // Line resistance costs up to a tenth.
        assert!(f64::from(peak) > 0.75 * transfer::counts(kpa, unit.exponent).min(f64::from(COUNT_MAX)));
    }
}

#[test]
fn noise_of_a_loaded_taxel_is_as_drawn() {
    for seed in 0..4 {
        let unit = unit(seed);
        let session = FilmSession { mains_share: 0.0, ..sound(seed, 1.0) };
        let own = unit.noise_counts * session.noise_factor;
        let mut film = film(&unit, session, seed);
        let map = pressed(3.0, 5.0);
        scans(&mut film, &map, 0..2400);
        let frames = scans(&mut film, &map, 2400..2880);
        let cells: Vec<usize> = map.loaded.iter().copied().filter(|&c| unit.gain[c] > 0.0).collect();
        let variance = |cell: usize| {
            let values: Vec<f64> = frames.iter().map(|f| f64::from(f.counts()[cell])).collect();
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / values.len() as f64
        };
        let rms = (cells.iter().map(|&c| variance(c)).sum::<f64>() / cells.len() as f64).sqrt();
        // Rounding to counts adds 1/12.
        let expected = (own * own + 1.0 / 12.0).sqrt();
        println!("unit {seed}: noise {rms:.3} counts rms, expected {expected:.3}");
        assert!((rms / expected - 1.0).abs() < 0.05);
    }
}

#[test]
fn motors_and_tools_at_their_loudest_leave_an_idle_pad_untouched() {
    let share = |pickup_counts: f64| {
        let touched = (0..30).map(|seed| {
            let unit = unit(seed);
            let mut film = film(&unit, sound(seed, 1.0), seed);
            let sums = (0..240).map(|f| film.scan(f, &PressureMap::empty(), pickup_counts, |_| 1.0).sum());
            sums.filter(|&sum| sum >= CONTACT_SUM_MIN).count()
        });
        touched.sum::<usize>() as f64 / (30.0 * 240.0)
    };
    let loudest = MOTOR_PICKUP_COUNTS.1 + JAW_PICKUP_COUNTS + TOOL_PICKUP_COUNTS;
    let shares = [loudest, 4.0].map(share);
    println!("idle frames that read as contact under {loudest:.2} and 4 counts of pick-up: {shares:.4?}");
    assert!(shares[0] < 0.002 && shares[1] > 0.1);
}

#[test]
fn pickup_is_common_to_a_row() {
    let unit = unit(2);
    let mut film = film(&unit, sound(2, 0.0), 2);
    let map = pressed(20.0, 9.0);
    scans(&mut film, &map, 0..2400);
    let frames: Vec<_> = (0..480).map(|f| film.scan(2400 + f, &map, 3.0, |_| 1.0)).collect();
    let at = |row: usize, col: usize| {
        let values: Vec<f64> = frames.iter().map(|f| f64::from(f.counts()[row * TAXEL_COLS + col])).collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        values.into_iter().map(|v| v - mean).collect::<Vec<f64>>()
    };
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let correlation = |a: &[f64], b: &[f64]| product(a, b) / (product(a, a) * product(b, b)).sqrt();
    let here = at(16, 14);
    let (same, other) = (correlation(&here, &at(16, 18)), correlation(&here, &at(18, 14)));
    let rms = (product(&here, &here) / 480.0).sqrt();
    println!(
        "pick-up of 3 counts: {rms:.2} rms; correlation in a row {same:.2} (0.8), across {other:.2} (0)"
    );
    assert!((rms - 3.0).abs() < 0.4 && (same - ROW_SHARE).abs() < 0.1 && other.abs() < 0.15);
}

/// Creep that outlasts the grip can keep a pad above the contact threshold for a while; nothing tares it.
#[test]
fn an_empty_pad_returns_to_no_contact_after_a_grip() {
    for (force_n, within_s) in [(2.5, 0.1), (8.0, 1.0)] {
        let mut waits: Vec<f64> = (0..20)
            .map(|seed| {
                let unit = unit(seed);
                let mut film = film(&unit, sound(seed, 1.0), seed);
                let idle = scans(&mut film, &PressureMap::empty(), 0..48);
                let held = scans(&mut film, &pressed(force_n, 5.0), 48..768);
                assert!(held.iter().all(|s| s.sum() > 10 * CONTACT_SUM_MIN));
                let free = scans(&mut film, &PressureMap::empty(), 768..2400);
                let level = |s: &[PiezoFrame]| s.iter().map(|s| s.sum() as f64).sum::<f64>() / s.len() as f64;
                assert!(level(&free[..48]) > level(&idle), "something of the grip is left");
                free.iter().rposition(|s| s.sum() >= CONTACT_SUM_MIN).map_or(0.0, |f| (f + 1) as f64 / 240.0)
            })
            .collect();
        waits.sort_by(f64::total_cmp);
        println!(
            "3 s at {force_n} N: contact reads on for {:.3} s (median of 20 units), {:.3} s (worst)",
            waits[10], waits[19]
        );
        assert!(waits[10] < within_s);
    }
}

#[test]
fn rows_are_read_one_after_another() {
    let unit = FilmUnit { lag_s: 0.5e-3, ..unit(3) };
    let map = pressed(4.0, 9.0);
    let row_sum = |s: &PiezoFrame, row: usize| -> f64 {
        s.counts()[row * TAXEL_COLS..][..TAXEL_COLS].iter().map(|&c| f64::from(c)).sum()
    };
    let read = |ramp_per_s: f64| {
        let mut film = film(&unit, sound(3, 0.0), 3);
        film.scan(0, &map, 0.0, |age_s| 1.0 - ramp_per_s * age_s)
    };
    let (still, rising) = (read(0.0), read(100.0));
    for row in [8, 16, 24] {
        let got = row_sum(&rising, row) / row_sum(&still, row);
        let force = 1.0 - 100.0 * row_age_s(unit.scan_s, row);
        println!("row {row}: force {force:.3} of that at the tick, reading {got:.3}");
        assert!((got - force).abs() < 0.05);
    }
}

#[test]
fn most_recordings_have_no_fault_and_the_others_show_theirs() {
    let frames = 8 * 240;
    let with = (0..400).filter(|&seed| session(seed, 1.0).faults(frames).next().is_some()).count();
    println!("{with} of 400 recordings of 8 s have an electrical fault");
    assert!((40..160).contains(&with));
    assert!(session(1, 0.0).faults.is_empty());

    let unit = unit(5);
    let map = pressed(3.0, 6.0);
    let clean = scans(&mut film(&unit, sound(5, 1.0), 5), &map, 0..20);
    let fault = |kind| {
        let faults = vec![Fault { kind, start_frame: 10, end_frame: 12 }];
        let session = FilmSession { faults, ..sound(5, 1.0) };
        assert_eq!(session.events(11)[0].end_s, 11.0 / 240.0);
        scans(&mut film(&unit, session, 5), &map, 0..20)
    };
    let row = fault(FaultKind::RowDropout { row: 16 });
    let flicker = FaultKind::Flicker { row: 3, col: 8, taxels: 2, jump_counts: Some(500), pattern: 0b01 };
    let flicker = fault(flicker);
    let missing = fault(FaultKind::MissingFrame);
    for scans in [&row, &flicker, &missing] {
        assert_eq!(scans[..10], clean[..10]);
        assert_eq!(scans[12..], clean[12..]);
    }
    assert!(row[11].counts()[16 * TAXEL_COLS..][..TAXEL_COLS].iter().all(|&c| c == 0));
    assert_eq!((&missing[10], &missing[11]), (&clean[9], &clean[9]));
    let jump = |f: usize| {
        i32::from(flicker[f].counts()[3 * TAXEL_COLS + 8]) - i32::from(clean[f].counts()[3 * TAXEL_COLS + 8])
    };
    assert_eq!((jump(10), jump(11)), (500, 0));
}

#[test]
fn units_are_within_their_ranges_and_drawn_by_seed_alone() {
    let run = || scans(&mut film(&unit(9), session(9, 1.0), 9), &pressed(2.0, 4.0), 0..60);
    assert_eq!(run(), run());
    let units: Vec<FilmUnit> = (0..40).map(unit).collect();
    let sound: Vec<f64> = units.iter().flat_map(|u| u.gain.iter().copied()).filter(|&g| g > 0.0).collect();
    let mean = sound.iter().sum::<f64>() / sound.len() as f64;
    let spread = (sound.iter().map(|g| (g - mean) * (g - mean)).sum::<f64>() / sound.len() as f64).sqrt();
    let faulty = units.iter().map(|u| u.dead.len() + u.stuck.len()).sum::<usize>() as f64
        / (units.len() * ACTIVE_TAXELS) as f64;
    // Two standard deviations of the smooth part are 15 %, and 5 % come on top.
    let expected = (0.075f64 * 0.075 + 0.05 * 0.05).sqrt();
    println!(
        "gain {mean:.3} ± {spread:.3} (expected ± {expected:.3}); {:.2} % dead or stuck",
        faulty * 100.0
    );
    assert!((mean - 1.0).abs() < 0.03 && (spread / expected - 1.0).abs() < 0.15);
    assert!((0.002..0.008).contains(&faulty));
}
