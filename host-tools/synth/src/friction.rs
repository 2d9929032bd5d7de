//! Partial slip: every loaded cell is a brush with a Coulomb cap, and the finger with its fixture is a
//! spring in series. Slip spreads from the lightly pressed rim inwards until the whole patch slides,
//! which is why the interface slips later than the crosshead moves.
//!
//! What the brush shares with an elastic half-space (Cattaneo, Mindlin) and what not; the unit tests print
//! the numbers:
//! - exactly: full slip at Q = μP; slip starting at the rim; a stick zone that is the contact patch of the
//!   smaller load P − Q/μ (Ciavarella, Jäger), because normal and tangential foundation have the same form;
//! - by calibration: the displacement at full slip, for a bristle stiffness of 8 G*/(π a). Between rest
//!   and full slip it then stays within 12 % of Mindlin's;
//! - not: the stick radius. It falls as (1 − Q/μP)^¼ under a sphere and ^⅓ under a cylinder pressed into
//!   the same layer, against Mindlin's ⅓ and ½. The half-space is the limit of a patch much narrower
//!   than the layer is thick; a fingertip's skin on a stiff array is the other one.

mod balance;
mod bristle;
mod mass;
mod patch;
mod rate_state;
#[cfg(test)]
mod tests;

use libm::exp;
use serde::Serialize;
use slipsense::params::TAXELS;

use crate::contact::{CELL_MM2, PressureMap, cell_mm};
use crate::draw::{Draw, Rng};
use crate::families::FrictionFamily;
use crate::field::Field;
use crate::objects::Object;
use balance::Brush;
use bristle::Bristle;
use mass::Mass;
use patch::Patch;
use rate_state::RateState;

/// Rate of the quasi-static steps, Hz: ten per frame.
pub(crate) const STEP_HZ: f64 = 2_400.0;
const STEP_S: f64 = 1.0 / STEP_HZ;

/// What moves faster than this slides; slower is numerical creep.
const SLIDING_MM_S: f64 = 0.05;
/// Newtons per kPa on one cell.
const CELL_N: f64 = CELL_MM2 * 1e-3;

/// What the contact of one finger does tangentially.
pub(crate) trait Friction {
    /// Advance by one step under pressures `map` times `scale`.
    fn step(&mut self, map: &PressureMap, scale: f64, pull: Pull) -> SlipState;
    /// Forget the stress of cells that carry no load any more.
    fn release_unloaded(&mut self, _map: &PressureMap) {}
}

type Drawn = (Box<dyn Friction>, serde_json::Value);

fn logged(friction: impl Friction + Serialize + 'static) -> Drawn {
    let drawn = serde_json::to_value(&friction).unwrap_or_default();
    (Box::new(friction), drawn)
}

/// Friction of this family with the log of its draws: the laboratory's drawn from `rng`, the others from `own`.
pub(crate) fn draw(family: FrictionFamily, object: &Object, rng: &mut Rng, own: &mut Rng) -> Drawn {
    let brush = Interface::draw(rng, object);
    match family {
        FrictionFamily::Brush => logged(brush),
        FrictionFamily::Bristle => logged(Patch::new(Bristle::draw(own, object))),
        FrictionFamily::Mass => logged(Patch::new(Mass::draw(own, object))),
        FrictionFamily::RateState => logged(Patch::new(RateState::draw(own, object))),
    }
}

#[derive(Serialize)]
pub(crate) struct Interface {
    /// Bristles of the finger and the object's own surface in series.
    brush_kpa_per_mm: f64,
    mu_static: f64,
    /// Deviation of its logarithm over the pad.
    mu_spread: f64,
    /// Correlation length of friction on the pad.
    mu_correlation_mm: f64,
    kinetic_share: f64,
    /// Slip over which static friction falls to kinetic.
    weakening_mm: f64,
    /// Time constant of regaining static friction at rest.
    healing_s: f64,
    #[serde(skip)]
    stress_kpa: Box<[[f64; 2]; TAXELS]>,
    #[serde(skip)]
    mu: Box<[f64; TAXELS]>,
    /// 1 where the cell has rested long enough to have its static friction back, 0 where it slides.
    #[serde(skip)]
    rested: Box<[f64; TAXELS]>,
    #[serde(skip)]
    now: SlipState,
    /// Last step's move: where the next search starts.
    #[serde(skip)]
    moved: [f64; 3],
    #[serde(skip)]
    brushes: Vec<Brush>,
}

/// What pulls: the far ends of springs on the object's position and turn. A soft spring far away is a
/// force. Where a stiffness is 0 nothing pulls that way, and the object keeps its place (or turn): the
/// clamp, the other finger or its own inertia holds it.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Pull {
    pub position_mm: [f64; 2],
    pub turn_rad: f64,
    pub stiffness_n_per_mm: f64,
    pub twist_n_mm_per_rad: f64,
}

/// What pulls in a step, in x, in y and along the turn.
struct Springs {
    /// 0 where nothing pulls.
    stiffness: [f64; 3],
    /// Far ends, from where the object is.
    stretch: [f64; 3],
}

impl Pull {
    /// Springs in N/mm and mm, those of the turn as lengths at `arm_mm` from where the object turns.
    fn springs(&self, now: &SlipState, arm_mm: f64) -> Springs {
        let n_per_mm = self.stiffness_n_per_mm;
        Springs {
            stiffness: [n_per_mm, n_per_mm, self.twist_n_mm_per_rad / (arm_mm * arm_mm)],
            stretch: [
                self.position_mm[0] - now.travel_mm[0],
                self.position_mm[1] - now.travel_mm[1],
                arm_mm * (self.turn_rad - now.turn_rad),
            ],
        }
    }
}

/// Result of one step. Forces are those on the finger: along the pull.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(crate) struct SlipState {
    /// Interface speed: mean of its size over the load, sticking cells counted as 0.
    pub speed_mm_s: f64,
    /// Share of the load carried by sliding cells.
    pub fraction: f64,
    pub shear_n: [f64; 2],
    /// Moment of the tangential stresses about the map's pivot.
    pub torque_n_mm: f64,
    /// Position of the object relative to the finger.
    pub travel_mm: [f64; 2],
    /// Turn of the object relative to the finger.
    pub turn_rad: f64,
    /// Length slid so far, mean over the load; never falls.
    pub path_mm: f64,
    /// Unit vector of the load's mean slip, last known while nothing slides or it only turns.
    pub direction: [f64; 2],
}

impl Interface {
    /// A finger's skin against this object.
    pub(crate) fn draw(rng: &mut Rng, object: &Object) -> Self {
        // Friction differs between grasps; the skin's bristles have G/h of 0.5–3 · 10⁹ N/m³.
        let level = exp(0.08 * rng.normal());
        let skin = rng.log_between(500.0, 3000.0);
        let mut interface = Self::even(
            1.0 / (1.0 / skin + 1.0 / object.surface.tangential_kpa_per_mm()),
            object.mu_static * level,
            object.mu_kinetic / object.mu_static,
        );
        interface.mu_spread = rng.between(0.10, 0.15);
        interface.mu_correlation_mm = rng.log_between(1.0, 3.0);
        interface.weakening_mm = rng.log_between(0.01, 0.04);
        interface.healing_s = rng.log_between(0.1, 1.0);
        let field = Field::draw(rng, [interface.mu_correlation_mm; 2]);
        for (cell, mu) in interface.mu.iter_mut().enumerate() {
            let (x, y) = cell_mm(cell);
            *mu *= exp(interface.mu_spread * field.at(x, y));
        }
        interface
    }

    /// The same friction everywhere, weakening over 0.02 mm and healing in 0.3 s.
    fn even(brush_kpa_per_mm: f64, mu: f64, kinetic_share: f64) -> Self {
        Self {
            brush_kpa_per_mm,
            mu_static: mu,
            mu_spread: 0.0,
            mu_correlation_mm: 1.0,
            kinetic_share,
            weakening_mm: 0.02,
            healing_s: 0.3,
            stress_kpa: Box::new([[0.0; 2]; TAXELS]),
            mu: Box::new([mu; TAXELS]),
            rested: Box::new([1.0; TAXELS]),
            now: SlipState { direction: [0.0, 1.0], ..SlipState::default() },
            moved: [0.0; 3],
            brushes: Vec::new(),
        }
    }

    /// The loaded cells' stresses, caps and places, in newtons and millimetres.
    fn gather(&mut self, map: &PressureMap, scale: f64) {
        let Self { brushes, stress_kpa, mu, rested, kinetic_share, .. } = self;
        brushes.clear();
        brushes.extend(map.loaded.iter().map(|&cell| {
            let rest = *kinetic_share + (1.0 - *kinetic_share) * rested[cell];
            let (x, y) = cell_mm(cell);
            let held_n = stress_kpa[cell].map(|kpa| kpa * CELL_N);
            let cap_n = mu[cell] * rest * map.kpa[cell] * scale * CELL_N;
            Brush::new(held_n, cap_n, [x - map.pivot_mm[0], y - map.pivot_mm[1]])
        }));
    }

    /// Carry the stresses and the friction of every cell through this step's move.
    fn slide(&mut self, map: &PressureMap, scale: f64) -> SlipState {
        let mm_per_n = 1.0 / (self.brush_kpa_per_mm * CELL_N);
        let (creep_mm, heal) = (SLIDING_MM_S * STEP_S, STEP_S / self.healing_s);
        let (mut load, mut sliding, mut path) = (0.0, 0.0, 0.0);
        let (mut drift, mut shear, mut torque) = ([0.0; 2], [0.0; 2], 0.0);
        for (&cell, brush) in map.loaded.iter().zip(&self.brushes) {
            let (held, lost, lost_n) = brush.after();
            let p = map.kpa[cell] * scale;
            let slid_mm = lost_n * mm_per_n;
            load += p;
            path += p * slid_mm;
            self.stress_kpa[cell] = held.map(|n| n * (1.0 / CELL_N));
            let arm = brush.arm_mm;
            torque += arm[0] * held[1] - arm[1] * held[0];
            for axis in 0..2 {
                shear[axis] += held[axis];
                drift[axis] += p * lost[axis] * mm_per_n;
            }
            let rested = &mut self.rested[cell];
            if slid_mm > creep_mm {
                *rested *= (1.0 - slid_mm / self.weakening_mm).max(0.0);
                // No sum keeps less; it would become subnormal, which is slow.
                if *rested < 1e-30 {
                    *rested = 0.0;
                }
                sliding += p;
            } else {
                *rested += (1.0 - *rested) * heal;
            }
        }
        let load = if load > 0.0 { load } else { 1.0 };
        let drifted = (drift[0] * drift[0] + drift[1] * drift[1]).sqrt();
        // What only turns slides all ways at once.
        if drifted > 0.02 * path && path > load * creep_mm * 1e-3 {
            self.now.direction = drift.map(|d| d / drifted);
        }
        self.now.path_mm += path / load;
        self.now = SlipState {
            speed_mm_s: path / load / STEP_S,
            fraction: sliding / load,
            shear_n: shear,
            torque_n_mm: torque,
            ..self.now
        };
        self.now
    }
}

impl Friction for Interface {
    fn step(&mut self, map: &PressureMap, scale: f64, pull: Pull) -> SlipState {
        if self.brushes.is_empty() {
            // A free object jumped to where its springs are slack: that says nothing about this step.
            self.moved = [0.0; 3];
        }
        self.gather(map, scale);
        let springs = pull.springs(&self.now, 1.0);
        self.moved = balance::solve(&mut self.brushes, self.brush_kpa_per_mm * CELL_N, &springs, self.moved);
        self.now.travel_mm[0] += self.moved[0];
        self.now.travel_mm[1] += self.moved[1];
        self.now.turn_rad += self.moved[2];
        self.slide(map, scale)
    }

    fn release_unloaded(&mut self, map: &PressureMap) {
        for cell in 0..TAXELS {
            if map.kpa[cell] == 0.0 {
                self.stress_kpa[cell] = [0.0; 2];
                self.rested[cell] = 1.0;
            }
        }
    }
}
