//! From pressure to ADC counts: piezoresistive film, divider, scan.
//!
//! A taxel's pressure passes a low-pass, hysteresis and creep; the film's conductance and the divider
//! make counts of it; the passive matrix mixes them; noise, mains and the converter come last.

mod curve;
mod noise;
mod session;
mod unit;
mod creep;
mod crosstalk;
mod front_end;
mod hysteresis;
mod transfer;
mod circuit;
mod percolating;
mod relaxing;
pub use transfer::{EXPONENT, pressure_kpa};
#[cfg(test)]
mod array_tests;
#[cfg(test)]
mod part_tests;

pub(crate) use session::FilmSession;
pub(crate) use unit::FilmUnit;

use libm::{exp, sincos};
use serde::Serialize;
use slipsense::params::{COUNT_MAX, FRAME_RATE_HZ, TAXEL_COLS, TAXEL_ROWS, TAXELS};
use slipsense::sensor::{PiezoFrame, active_cols};

use crate::contact::PressureMap;
use crate::draw::{Draw, Rng};
use crate::families::FilmFamily;
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

/// What stands between pressure and counts in place of the laboratory's film or divider.
#[derive(Serialize)]
#[serde(untagged)]
enum Other {
    Circuit(Box<Circuit>),
    Relaxing(Relaxing),
    Percolating(Percolating),
}

pub(crate) struct Film<'a> {
    unit: &'a FilmUnit,
    session: FilmSession,
    rng: Rng,
    taxels: Vec<Taxel>,
    hysteresis: Hysteresis,
    /// Conductance over pressure, relative to the divider's reference, for a taxel of gain 1.
    conductance: Curve,
    blend: f64,
    creep_blend: Blend,
    /// Phase of the mains at each row against the tick, as cosine and sine.
    row_phase: [(f64, f64); TAXEL_ROWS],
    before: [u16; TAXELS],
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
            conductance: Curve::tabulate(|kpa| gain * transfer::conductance(kpa, unit.exponent)),
            blend: 1.0 - exp(-dt / unit.lag_s),
            creep_blend: unit.creep.blend(dt),
            row_phase: std::array::from_fn(|row| {
                let (sin, cos) = sincos(-omega * row_age_s(unit.scan_s, row));
                (cos, sin)
            }),
            before: [0; TAXELS],
            other: None,
            unit,
            session,
            rng,
        }
    }

    /// Let a film of this family answer, and log what is drawn of it.
    pub(crate) fn with_family(mut self, family: FilmFamily, rng: &mut Rng) -> (Self, serde_json::Value) {
        self.other = match family {
            FilmFamily::Divider => None,
            FilmFamily::Circuit => Some(Other::Circuit(Box::new(Circuit::draw(rng)))),
            FilmFamily::Relaxing => Some(Other::Relaxing(Relaxing::draw(rng))),
            FilmFamily::Percolating => Some(Other::Percolating(Percolating::draw(rng))),
        };
        let drawn = serde_json::to_value(&self.other).unwrap_or_default();
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
        let asymptote = transfer::asymptote_counts();
        let mut counts = [0.0; TAXELS];
        if let Some(Other::Relaxing(film)) = &mut self.other {
            film.advance(&mut self.rng);
        }
        let any = self.conduct(map, asymptote, force_back, &mut counts);
        match &mut self.other {
            None if any => self.unit.crosstalk.apply(&mut counts, asymptote),
            Some(Other::Circuit(circuit)) => circuit.read(&mut counts),
            _ => {}
        }
        let mut scan = self.convert(frame, &counts, pickup_counts);
        for &[row, col, level] in &self.unit.stuck {
            scan[row * TAXEL_COLS + col] = level as u16;
        }
        for fault in self.session.faults(frame + 1).filter(|fault| frame < fault.end_frame) {
            fault.apply(frame, &mut scan, &self.before);
        }
        self.before = scan;
        PiezoFrame::from_scan(scan)
    }

    /// What every taxel shows by itself: counts, or conductance where the circuit follows; false where none shows any.
    fn conduct(
        &mut self,
        map: &PressureMap,
        asymptote: f64,
        force_back: impl Fn(f64) -> f64,
        out: &mut [f64; TAXELS],
    ) -> bool {
        let unit = self.unit;
        let mut any = false;
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
                let x = unit.gain[cell] * self.conductance.at(shown);
                out[cell] = match &self.other {
                    None => asymptote * x / (1.0 + x),
                    Some(Other::Circuit(_)) => x,
                    Some(Other::Relaxing(film)) => {
                        film.counts(&mut taxel.state, taxel.follow, unit.gain[cell])
                    }
                    Some(Other::Percolating(film)) => {
                        film.counts(&mut taxel.state[0], taxel.follow, unit.gain[cell])
                    }
                };
                any |= taxel.awake;
            }
        }
        any
    }

    fn convert(&mut self, frame: usize, counts: &[f64; TAXELS], pickup_counts: f64) -> [u16; TAXELS] {
        let (unit, session) = (self.unit, &self.session);
        let own = unit.noise_counts * session.noise_factor;
        let own = (own * own + (1.0 - ROW_SHARE) * pickup_counts * pickup_counts).sqrt() as f32;
        let shared = ROW_SHARE.sqrt() * pickup_counts;
        let hum = unit.mains_counts * session.mains_share * session.noise_factor;
        let t = (frame + 1) as f64 / FRAME_RATE_HZ as f64;
        let (sin, cos) = sincos(std::f64::consts::TAU * session.mains_hz * t + session.mains_phase);
        let mut noise = [0.0; TAXELS];
        noise::draws(&mut self.rng, &mut noise);
        let mut scan = [0; TAXELS];
        for row in 0..TAXEL_ROWS {
            let (row_cos, row_sin) = self.row_phase[row];
            let mut common = session.zero_counts + hum * (sin * row_cos + cos * row_sin);
            if shared > 0.0 {
                common += shared * self.rng.normal();
            }
            let common = common as f32;
            let cells = row * TAXEL_COLS..(row + 1) * TAXEL_COLS;
            if let Some(Other::Circuit(circuit)) = &self.other {
                for cell in cells {
                    let noise = f64::from(noise[cell]) * session.noise_factor;
                    scan[cell] = circuit.count(cell, counts[cell], noise, common.into());
                }
            } else {
                for cell in cells {
                    let level = counts[cell] as f32 + unit.offset[cell] + common + own * noise[cell];
                    scan[cell] = converted(level);
                }
            }
        }
        scan
    }
}

/// How long before the tick a row is read.
fn row_age_s(scan_s: f64, row: usize) -> f64 {
    scan_s * (TAXEL_ROWS - 1 - row) as f64 / TAXEL_ROWS as f64
}

/// What the converter reads: rounded to a count, ending at 0 and at 4095.
#[inline]
fn converted(level: f32) -> u16 {
    // From 2^23 on a float holds integers: the sum's mantissa is the rounded count, unlike a cast for several at once.
    const INTEGERS: f32 = 8_388_608.0;
    ((level.clamp(0.0, COUNT_MAX as f32) + INTEGERS).to_bits() & 0xffff) as u16
}
