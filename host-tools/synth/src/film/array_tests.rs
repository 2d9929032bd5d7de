//! The array as a whole: idle level, range, memory, faults.

use slipsense::params::{ACTIVE_TAXELS, CONTACT_SUM_MIN, COUNT_MAX, TAXEL_COLS, TAXELS};
use slipsense::transfer as law;

use super::session::{Fault, FaultKind};
use super::*;
use crate::check::{mean, median, near, variance, within};
use crate::contact::{CELL_MM2, active_cells, cell_mm};
use crate::draw::{Stream, stream};
use crate::scenario::levels::{JAW_PICKUP_COUNTS, MOTOR_PICKUP_COUNTS, TOOL_PICKUP_COUNTS};
use libm::sin;

fn unit(seed: u64) -> FilmUnit {
    let rng = &mut stream(seed, Stream::Unit, 0);
    let mut unit = FilmUnit::draw(rng);
    unit.circuit.draw_amplifiers(rng);
    unit
}

fn session(seed: u64, noise_factor: f64) -> FilmSession {
    FilmSession::draw(&mut stream(seed, Stream::Film, 0), noise_factor)
}

fn faultless(seed: u64, noise_factor: f64) -> FilmSession {
    FilmSession { faults: Vec::new(), ..session(seed, noise_factor) }
}

fn film(unit: &FilmUnit, session: FilmSession, seed: u64) -> Film<'_> {
    Film::new(unit, session, stream(seed, Stream::Film, 1))
}

/// `force_n` spread evenly over the taxels within `radius_mm` of the middle.
fn pressed(force_n: f64, radius_mm: f64) -> PressureMap {
    let mut map = PressureMap::empty();
    let within = |&cell: &usize| {
        let (x, y) = cell_mm(cell);
        x * x + y * y < radius_mm * radius_mm
    };
    map.loaded = active_cells().filter(within).collect();
    for &cell in &map.loaded {
        map.kpa[cell] = force_n * 1e3 / CELL_MM2 / map.loaded.len() as f64;
    }
    map
}

fn scans(film: &mut Film<'_>, map: &PressureMap, frames: std::ops::Range<usize>) -> Vec<PiezoFrame> {
    frames.map(|frame| film.scan(frame, map, 0.0, |_| 1.0)).collect()
}

fn sums(scans: &[PiezoFrame]) -> Vec<f64> {
    scans.iter().map(|scan| f64::from(scan.sum())).collect()
}

fn touched(scans: &[PiezoFrame]) -> f64 {
    scans.iter().filter(|scan| scan.sum() >= CONTACT_SUM_MIN).count() as f64 / scans.len() as f64
}

fn taxel(scans: &[PiezoFrame], cell: usize) -> Vec<f64> {
    scans.iter().map(|scan| f64::from(scan.counts()[cell])).collect()
}

/// Noise of an untouched taxel, codes rms.
fn noise_codes(unit: &FilmUnit) -> f64 {
    unit.circuit.noise * front_end::table::NOISE
}

/// Mean idle count of unit and session: a Gaussian about the idle level clipped at 0, mean of the mains' phases.
fn idle_mean(unit: &FilmUnit, session: &FilmSession) -> f64 {
    const PHASES: usize = 32;
    let noise = noise_codes(unit);
    // Offsets have parts of a code: rounding adds 1/12.
    let sigma = libm::hypot(noise * session.noise_factor, 1.0 / 12f64.sqrt());
    let clipped = |level: f64| -> f64 {
        let reaches = |n| noise::above((f64::from(law::code(n)) - 0.5 - level) / sigma);
        (1..16).map(reaches).sum()
    };
    let codes = circuit::CODES_PER_COUNT;
    let hum = codes * unit.mains_counts * session.mains_share * session.noise_factor;
    let level = codes * (session.zero_counts + unit.circuit.idle_counts);
    let at = |phase: usize| clipped(level + hum * sin(std::f64::consts::TAU * phase as f64 / PHASES as f64));
    let working = (0..PHASES).map(at).sum::<f64>() / PHASES as f64;
    let stuck = |cell: usize| unit.stuck.iter().find(|s| s[0] * TAXEL_COLS + s[1] == cell);
    let levels = active_cells().map(|cell| match stuck(cell) {
        Some(&[_, _, level]) => level as f64,
        None => working,
    });
    levels.sum::<f64>() / ACTIVE_TAXELS as f64
}

#[test]
fn an_untouched_pad_of_any_unit_is_no_contact() {
    for seed in 0..60 {
        let unit = unit(seed);
        let session = faultless(seed, 1.0);
        let scans = scans(&mut film(&unit, session.clone(), seed), &PressureMap::empty(), 0..240);
        let counts = mean(&sums(&scans)) / ACTIVE_TAXELS as f64;
        let expected = idle_mean(&unit, &session);
        within("mean idle count", counts, ..0.5);
        // Within 15 % and 0.01 counts of a Gaussian that the converter clips; the law rounds the codes once more.
        let off = (counts - expected).abs() / (0.01 + 0.15 * expected);
        within("off from a clipped Gaussian", off, ..1.0);
        within("share of idle frames that read as contact", touched(&scans), ..0.01);
    }
}

#[test]
fn fifty_newtons_stay_in_twelve_bits_and_saturate_softly() {
    let unit = FilmUnit { gain: Box::new([1.0; TAXELS]), ..unit(1) };
    for (force_n, radius_mm) in [(50.0, 6.0), (50.0, 2.0), (500.0, 5.64)] {
        let map = pressed(force_n, radius_mm);
        let scans = scans(&mut film(&unit, faultless(1, 1.0), 1), &map, 0..24);
        assert!(scans.iter().flat_map(|s| s.counts()).all(|&c| c <= COUNT_MAX));
        let peak = scans[23].counts().iter().copied().max().unwrap();
        let kpa = map.kpa[map.loaded[0]];
        // Line resistance costs up to a tenth.
        let least = 0.75 * film::counts(kpa, unit.exponent).min(f64::from(COUNT_MAX));
        within(format!("{force_n} N over {radius_mm} mm, {kpa:.0} kPa: peak"), f64::from(peak), least..);
    }
}

#[test]
fn noise_of_a_loaded_taxel_is_as_drawn() {
    for seed in 0..4 {
        let unit = unit(seed);
        let session = FilmSession { mains_share: 0.0, ..faultless(seed, 1.0) };
        let own = noise_codes(&unit) / circuit::CODES_PER_COUNT * session.noise_factor;
        let mut film = film(&unit, session, seed);
        let map = pressed(1.0, 5.0);
        scans(&mut film, &map, 0..2400);
        let frames = scans(&mut film, &map, 2400..2880);
        // A count stands for more codes the higher it is; rounding to counts adds 1/12.
        let of_code = |cell: usize| {
            let counts = taxel(&frames, cell);
            let slope = 1.0 - mean(&counts) / film::asymptote_counts();
            (variance(&counts) - 1.0 / 12.0) / libm::pow(slope, 4.0)
        };
        let alive = map.loaded.iter().filter(|&&c| unit.gain[c] > 0.0);
        let variances: Vec<f64> = alive.map(|&c| of_code(c)).collect();
        near(format!("unit {seed}: noise, counts rms"), mean(&variances).sqrt(), own, 0.1);
    }
}

#[test]
fn motors_and_tools_at_their_loudest_leave_an_idle_pad_untouched() {
    let share = |pickup_counts: f64| {
        let units = (0..30).map(|seed| {
            let unit = unit(seed);
            let mut film = film(&unit, faultless(seed, 1.0), seed);
            let scan = |f| film.scan(f, &PressureMap::empty(), pickup_counts, |_| 1.0);
            touched(&(0..240).map(scan).collect::<Vec<_>>())
        });
        units.sum::<f64>() / 30.0
    };
    let loudest = MOTOR_PICKUP_COUNTS.1 + JAW_PICKUP_COUNTS + TOOL_PICKUP_COUNTS;
    within(format!("idle frames that read as contact, {loudest:.2} counts"), share(loudest), ..0.002);
    within("4 counts", share(4.0), 0.1..);
}

#[test]
fn pickup_is_common_to_a_row() {
    let unit = unit(2);
    let mut film = film(&unit, faultless(2, 0.0), 2);
    let map = pressed(4.0, 9.0);
    scans(&mut film, &map, 0..2400);
    let frames: Vec<_> = (0..480).map(|f| film.scan(2400 + f, &map, 3.0, |_| 1.0)).collect();
    let at = |row: usize, col: usize| {
        let values = taxel(&frames, row * TAXEL_COLS + col);
        values.iter().map(|v| v - mean(&values)).collect::<Vec<f64>>()
    };
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let correlation = |a: &[f64], b: &[f64]| product(a, b) / (product(a, a) * product(b, b)).sqrt();
    let here = at(16, 14);
    within("pick-up of 3 counts", (product(&here, &here) / 480.0).sqrt(), 2.6..3.4);
    let (same, other) = (correlation(&here, &at(16, 18)), correlation(&here, &at(18, 14)));
    within("correlation in a row", same, ROW_SHARE - 0.1..ROW_SHARE + 0.1);
    within("across", other, -0.15..0.15);
}

/// Creep that outlasts the grip can keep a pad above the contact threshold for a while; nothing tares it.
#[test]
fn an_empty_pad_returns_to_no_contact_after_a_grip() {
    for (force_n, within_s) in [(2.5, 0.1), (8.0, 1.0)] {
        let wait_s = |seed| {
            let unit = unit(seed);
            let mut film = film(&unit, faultless(seed, 1.0), seed);
            let idle = scans(&mut film, &PressureMap::empty(), 0..48);
            let held = scans(&mut film, &pressed(force_n, 5.0), 48..768);
            assert!(held.iter().all(|s| s.sum() > 10 * CONTACT_SUM_MIN));
            let free = scans(&mut film, &PressureMap::empty(), 768..2400);
            assert!(mean(&sums(&free[..48])) > mean(&sums(&idle)), "something of the grip is left");
            free.iter().rposition(|s| s.sum() >= CONTACT_SUM_MIN).map_or(0.0, |f| (f + 1) as f64 / 240.0)
        };
        let median_s = median((0..20).map(wait_s).collect());
        within(format!("3 s at {force_n} N: contact reads on for, s"), median_s, ..within_s);
    }
}

#[test]
fn rows_are_read_one_after_another() {
    let unit = FilmUnit { lag_s: 0.5e-3, ..unit(3) };
    let map = pressed(4.0, 9.0);
    let read = |ramp_per_s: f64| {
        let mut film = film(&unit, faultless(3, 0.0), 3);
        let scan = film.scan(0, &map, 0.0, |age_s| 1.0 - ramp_per_s * age_s);
        let row = |row: usize| scan.counts()[row * TAXEL_COLS..][..TAXEL_COLS].iter();
        [8, 16, 24].map(|n| row(n).map(|&c| f64::from(c)).sum::<f64>())
    };
    for ((row, still), rising) in [8, 16, 24].into_iter().zip(read(0.0)).zip(read(100.0)) {
        let force = 1.0 - 100.0 * row_age_s(unit.scan_s, row);
        within(format!("row {row}: off that at the tick"), rising / still - force, -0.05..0.05);
    }
}

#[test]
fn most_recordings_have_no_fault_and_the_others_show_theirs() {
    let frames = 8 * 240;
    let with = (0..400).filter(|&seed| session(seed, 1.0).faults(frames).next().is_some()).count();
    within("of 400 recordings of 8 s with an electrical fault", with as f64, 40.0..160.0);
    assert!(session(1, 0.0).faults.is_empty());

    let unit = unit(5);
    let map = pressed(3.0, 6.0);
    let clean = scans(&mut film(&unit, faultless(5, 1.0), 5), &map, 0..20);
    let fault = |kind| {
        let faults = vec![Fault { kind, start_frame: 10, end_frame: 12 }];
        let session = FilmSession { faults, ..faultless(5, 1.0) };
        assert_eq!(session.events(11)[0].end_s, 11.0 / 240.0);
        let scans = scans(&mut film(&unit, session, 5), &map, 0..20);
        assert!(scans[..10] == clean[..10] && scans[12..] == clean[12..]);
        scans
    };
    let row = fault(FaultKind::RowDropout { row: 16 });
    assert!(row[11].counts()[16 * TAXEL_COLS..][..TAXEL_COLS].iter().all(|&c| c == 0));
    let missing = fault(FaultKind::MissingFrame);
    assert_eq!((&missing[10], &missing[11]), (&clean[9], &clean[9]));
    let flicker =
        fault(FaultKind::Flicker { row: 3, col: 8, taxels: 2, jump_counts: Some(500), pattern: 0b01 });
    let [flicker, clean] = [flicker, clean].map(|scans| taxel(&scans, 3 * TAXEL_COLS + 8));
    assert_eq!((flicker[10] - clean[10], flicker[11] - clean[11]), (500.0, 0.0));
}

#[test]
fn units_are_within_their_ranges() {
    let units: Vec<FilmUnit> = (0..40).map(unit).collect();
    let gains: Vec<f64> = units.iter().flat_map(|u| u.gain.iter().copied()).filter(|&g| g > 0.0).collect();
    within("gain", mean(&gains), 0.97..1.03);
    // Two standard deviations of the smooth part are 15 %, and 5 % come on top.
    near("its spread", variance(&gains).sqrt(), (0.075f64 * 0.075 + 0.05 * 0.05).sqrt(), 0.15);
    let faulty = units.iter().map(|u| u.dead.len() + u.stuck.len()).sum::<usize>() as f64;
    within("dead or stuck taxels", faulty / (units.len() * ACTIVE_TAXELS) as f64, 0.002..0.008);
}
