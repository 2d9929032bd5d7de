//! From pressure to counts: piezoresistive film, front end, scan.
//!
//! A taxel's pressure passes a low-pass; the film's material makes a conductance of it; the front end reads all of
//! them, with crosstalk, noise and mains; the firmware's trim and integer law make counts of its codes.

mod curve;
mod noise;
mod session;
mod unit;
mod creep;
mod front_end;
mod hysteresis;
mod branches;
mod circuit;
mod percolating;
mod relaxing;
#[cfg(test)]
mod array_tests;
#[cfg(test)]
mod part_tests;

pub(crate) use session::FilmSession;
pub(crate) use unit::FilmUnit;

use libm::{exp, sincos};
use serde::Serialize;
use slipsense::params::{FRAME_RATE_HZ, TAXEL_COLS, TAXEL_ROWS, TAXELS};
use slipsense::sensor::{PiezoFrame, active_cols};
use slipsense_recording::film;

use crate::contact::PressureMap;
use crate::draw::{Draw, Rng};
use crate::families::{Families, FilmFamily};
use branches::Branches;
use circuit::Circuit;
use creep::Blend;
use curve::Curve;
use hysteresis::Hysteresis;
use percolating::Percolating;
use relaxing::Relaxing;

/// Pressure below which a taxel shows nothing: less than a milli-count.
const NOTHING_KPA: f64 = 1e-4;
/// Share of the variance of pick-up that all taxels of a row have in common: they are read together.
const ROW_SHARE: f64 = 0.8;
/// Share of the boards in families of physics that the firmware has calibrated.
const CALIBRATED: f64 = 0.5;

#[derive(Clone, Default)]
struct Taxel {
    follow: f64,
    plays: [f64; hysteresis::PLAYS],
    creep: [f64; creep::TERMS],
    /// What another family's film remembers.
    state: [f64; 2],
    /// Still shows something of an earlier load.
    awake: bool,
}

/// What makes a conductance of pressure in place of the laboratory's hysteresis, creep and power law.
#[derive(Serialize)]
#[serde(untagged)]
enum Other {
    Branches(Branches),
    Relaxing(Relaxing),
    Percolating(Percolating),
}

pub(crate) struct Film<'a> {
    unit: &'a FilmUnit,
    session: FilmSession,
    rng: Rng,
    taxels: Vec<Taxel>,
    hysteresis: Hysteresis,
    /// Conductance over pressure, share of a nominal taxel's at full scale, for a taxel of gain 1.
    conductance: Curve,
    blend: f64,
    creep_blend: Blend,
    /// Phase of the mains at each row against the tick, as cosine and sine.
    row_phase: [(f64, f64); TAXEL_ROWS],
    before: [u16; TAXELS],
    circuit: Circuit,
    other: Option<Other>,
}

impl<'a> Film<'a> {
    pub(crate) fn new(unit: &'a FilmUnit, session: FilmSession, rng: Rng) -> Self {
        let dt = 1.0 / FRAME_RATE_HZ as f64;
        let gain = session.gain(unit);
        let omega = std::f64::consts::TAU * session.mains_hz;
        Self {
            taxels: vec![Taxel::default(); TAXELS],
            hysteresis: Hysteresis::new(unit.hysteresis),
            conductance: Curve::tabulate(|kpa| gain * film::share(kpa, unit.exponent)),
            blend: 1.0 - exp(-dt / unit.lag_s),
            creep_blend: unit.creep.blend(dt),
            row_phase: std::array::from_fn(|row| {
                let (sin, cos) = sincos(-omega * row_age_s(unit.scan_s, row));
                (cos, sin)
            }),
            before: [0; TAXELS],
            circuit: unit.circuit.clone(),
            other: None,
            unit,
            session,
            rng,
        }
    }

    /// Let a film of these families answer, behind a board that may be calibrated, and log what is drawn of them.
    pub(crate) fn with_families(mut self, families: Families, rng: &mut Rng) -> (Self, serde_json::Value) {
        self.other = match families.film {
            FilmFamily::Plays => None,
            FilmFamily::Branches => Some(Other::Branches(Branches::draw(rng))),
            FilmFamily::Relaxing => Some(Other::Relaxing(Relaxing::draw(rng))),
            FilmFamily::Percolating => Some(Other::Percolating(Percolating::draw(rng))),
        };
        if !families.is_laboratory() && rng.chance(CALIBRATED) {
            self.circuit = self.circuit.calibrated(rng);
        }
        let drawn = serde_json::json!({ "material": self.other, "circuit": self.circuit });
        (self, drawn)
    }

    /// Scan number `frame` of the pressures in `map`. `pickup_counts` is the noise that motors running
    /// now induce, counts rms: half a count leaves an idle pad idle, of two every second idle frame reads
    /// as contact. `force_back(s)` is the grip force that long before the tick relative to
    /// the force of `map`: the rows are read one after another, the last at the tick.
    pub(crate) fn scan(
        &mut self,
        frame: usize,
        map: &PressureMap,
        pickup_counts: f64,
        force_back: impl Fn(f64) -> f64,
    ) -> PiezoFrame {
        if let Some(Other::Relaxing(film)) = &mut self.other {
            film.advance(&mut self.rng);
        }
        let mut taxels = [0.0; TAXELS];
        self.conduct(map, force_back, &mut taxels);
        self.circuit.read(&mut taxels);
        let mut scan = self.convert(frame, &taxels, pickup_counts);
        for &[row, col, level] in &self.unit.stuck {
            scan[row * TAXEL_COLS + col] = level as u16;
        }
        for fault in self.session.faults(frame + 1).filter(|fault| frame < fault.end_frame) {
            fault.apply(frame, &mut scan, &self.before);
        }
        self.before = scan;
        PiezoFrame::from_scan(scan)
    }

    /// Conductance of every taxel by itself, share of a nominal one's at full scale.
    fn conduct(&mut self, map: &PressureMap, force_back: impl Fn(f64) -> f64, out: &mut [f64; TAXELS]) {
        let unit = self.unit;
        for row in 0..TAXEL_ROWS {
            let scale = force_back(row_age_s(unit.scan_s, row));
            for col in active_cols(row) {
                let cell = row * TAXEL_COLS + col;
                let taxel = &mut self.taxels[cell];
                let kpa = map.kpa[cell] * scale;
                if kpa <= 0.0 && !taxel.awake {
                    continue;
                }
                taxel.follow += self.blend * (kpa - taxel.follow);
                if taxel.follow < NOTHING_KPA {
                    taxel.follow = 0.0;
                }
                let shown = self.hysteresis.step(&mut taxel.plays, taxel.follow);
                let shown = shown + unit.creep.step(&mut taxel.creep, shown, &self.creep_blend);
                taxel.awake = shown > NOTHING_KPA;
                let own = match &self.other {
                    None => self.conductance.at(shown),
                    Some(Other::Branches(film)) => film.conductance(&mut taxel.state[0], taxel.follow),
                    Some(Other::Relaxing(film)) => film.conductance(&mut taxel.state, taxel.follow),
                    Some(Other::Percolating(film)) => film.conductance(&mut taxel.state[0], taxel.follow),
                };
                out[cell] = unit.gain[cell] * own;
            }
        }
    }

    /// Counts of the front end's codes, with noise, mains and what else is induced.
    fn convert(&mut self, frame: usize, codes: &[f64; TAXELS], pickup_counts: f64) -> [u16; TAXELS] {
        let (unit, session) = (self.unit, &self.session);
        let own = (1.0 - ROW_SHARE).sqrt() * pickup_counts;
        let shared = ROW_SHARE.sqrt() * pickup_counts;
        let hum = unit.mains_counts * session.mains_share * session.noise_factor;
        let t = (frame + 1) as f64 / FRAME_RATE_HZ as f64;
        let (sin, cos) = sincos(std::f64::consts::TAU * session.mains_hz * t + session.mains_phase);
        let mut noise = [0.0; TAXELS];
        noise::draws(&mut self.rng, &mut noise);
        let sigmas = self.circuit.sigmas(session.noise_factor, own);
        let mut scan = [0; TAXELS];
        for row in 0..TAXEL_ROWS {
            let (row_cos, row_sin) = self.row_phase[row];
            let mut common = session.zero_counts + hum * (sin * row_cos + cos * row_sin);
            if shared > 0.0 {
                common += shared * self.rng.normal();
            }
            for cell in row * TAXEL_COLS..(row + 1) * TAXEL_COLS {
                let noise = sigmas[cell % TAXEL_COLS] * f64::from(noise[cell]);
                scan[cell] = self.circuit.count(cell, codes[cell] + noise, common);
            }
        }
        scan
    }
}

/// How long before the tick a row is read.
fn row_age_s(scan_s: f64, row: usize) -> f64 {
    scan_s * (TAXEL_ROWS - 1 - row) as f64 / TAXEL_ROWS as f64
}
