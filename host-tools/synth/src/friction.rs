//! Partial slip: every loaded cell is a brush with a Coulomb cap, and the finger with its fixture is a
//! spring in series. Slip spreads from the lightly pressed rim inwards until the whole patch slides,
//! which is why the interface slips later than the crosshead moves.

use libm::exp;
use slipsense::params::TAXELS;

use crate::contact::{CELL_MM2, PressureMap};
use crate::draw::{Draw, Rng};
use crate::objects::Object;

/// Rate of the quasi-static steps, Hz: ten per frame.
pub(crate) const STEP_HZ: f64 = 2_400.0;

/// Tangential state of one finger.
pub(crate) struct Interface {
    brush_kpa_per_mm: f64,
    stress_kpa: Box<[f64; TAXELS]>,
    mu_static: Box<[f64; TAXELS]>,
    /// 1 where the cell has rested long enough to have its static friction back, 0 where it slides.
    rested: Box<[f64; TAXELS]>,
    kinetic_share: f64,
    weakening_mm: f64,
    healing_s: f64,
    position_mm: f64,
}

/// What pulls: the far end of a spring. A soft spring far away is a force.
#[derive(Clone, Copy)]
pub(crate) struct Pull {
    pub position_mm: f64,
    pub stiffness_n_per_mm: f64,
}

/// Result of one step.
#[derive(Clone, Copy, Default)]
pub(crate) struct Sliding {
    /// Interface speed: mean over the load, sticking cells counted as 0.
    pub speed_mm_s: f64,
    /// Share of the load carried by sliding cells.
    pub fraction: f64,
    /// Tangential force.
    pub shear_n: f64,
    /// Position of the object relative to the finger.
    pub travel_mm: f64,
}

/// A cell slides when it moves faster than this; slower is numerical creep.
const SLIDING_MM_S: f64 = 0.05;

impl Interface {
    pub(crate) fn draw(rng: &mut Rng, object: &Object) -> Self {
        let level = exp(0.08 * rng.normal());
        let mu = object.mu_static * level;
        Self {
            brush_kpa_per_mm: rng.log_between(500.0, 2000.0),
            stress_kpa: Box::new([0.0; TAXELS]),
            mu_static: Box::new(std::array::from_fn(|_| mu * exp(0.1 * rng.normal()))),
            rested: Box::new([1.0; TAXELS]),
            kinetic_share: object.mu_kinetic / object.mu_static,
            weakening_mm: rng.log_between(0.01, 0.04),
            healing_s: rng.log_between(0.1, 1.0),
            position_mm: 0.0,
        }
    }

    /// Advance by `dt` seconds under pressures `map` times `scale`.
    pub(crate) fn step(&mut self, map: &PressureMap, scale: f64, pull: Pull, dt: f64) -> Sliding {
        let start = self.position_mm;
        let cap = |s: &Self, cell: usize| {
            let rest = s.kinetic_share + (1.0 - s.kinetic_share) * s.rested[cell];
            s.mu_static[cell] * rest * map.kpa[cell] * scale
        };
        let caps: Vec<f64> = map.loaded.iter().map(|&cell| cap(self, cell)).collect();
        self.position_mm = self.balance(map, &caps, pull);
        let moved = self.position_mm - start;
        let (mut load, mut sliding, mut flow, mut shear) = (0.0, 0.0, 0.0, 0.0);
        for (&cell, &cap) in map.loaded.iter().zip(&caps) {
            let trial = self.stress_kpa[cell] + self.brush_kpa_per_mm * moved;
            let stress = trial.clamp(-cap, cap);
            let slid_mm = (trial - stress).abs() / self.brush_kpa_per_mm;
            self.stress_kpa[cell] = stress;
            let rested = &mut self.rested[cell];
            let p = map.kpa[cell] * scale;
            load += p;
            flow += p * slid_mm / dt;
            shear += stress;
            if slid_mm > SLIDING_MM_S * dt {
                *rested *= (1.0 - slid_mm / self.weakening_mm).max(0.0);
                sliding += p;
            } else {
                *rested += (1.0 - *rested) * (dt / self.healing_s);
            }
        }
        let load_or_one = if load > 0.0 { load } else { 1.0 };
        Sliding {
            speed_mm_s: flow / load_or_one,
            fraction: sliding / load_or_one,
            shear_n: shear * CELL_MM2 * 1e-3,
            travel_mm: self.position_mm,
        }
    }

    /// Position of the object relative to the finger at this moment, mm.
    pub(crate) fn position_mm(&self) -> f64 {
        self.position_mm
    }

    /// Forget the stress of cells that carry no load any more.
    pub(crate) fn release_unloaded(&mut self, map: &PressureMap) {
        for cell in 0..TAXELS {
            if map.kpa[cell] == 0.0 {
                self.stress_kpa[cell] = 0.0;
                self.rested[cell] = 1.0;
            }
        }
    }

    /// Position at which spring and brushes balance. The residual falls strictly with position, so
    /// Newton steps inside a shrinking bracket always arrive.
    fn balance(&self, map: &PressureMap, caps: &[f64], pull: Pull) -> f64 {
        let k = pull.stiffness_n_per_mm;
        if k <= 0.0 {
            return self.position_mm;
        }
        let unit = CELL_MM2 * 1e-3;
        let reach = caps.iter().sum::<f64>() * unit / k;
        let (mut lo, mut hi) = (pull.position_mm - reach, pull.position_mm + reach);
        let mut position = self.position_mm.clamp(lo, hi);
        for _ in 0..40 {
            let (mut shear, mut slope) = (0.0, 0.0);
            for (&cell, &cap) in map.loaded.iter().zip(caps) {
                let trial = self.stress_kpa[cell] + self.brush_kpa_per_mm * (position - self.position_mm);
                shear += trial.clamp(-cap, cap);
                slope += if trial.abs() < cap { self.brush_kpa_per_mm } else { 0.0 };
            }
            let residual = k * (pull.position_mm - position) - shear * unit;
            if residual > 0.0 {
                lo = position
            } else {
                hi = position
            }
            let newton = position + residual / (k + slope * unit);
            let next = if newton > lo && newton < hi { newton } else { (lo + hi) / 2.0 };
            if (next - position).abs() < 1e-9 {
                return next;
            }
            position = next;
        }
        position
    }
}
