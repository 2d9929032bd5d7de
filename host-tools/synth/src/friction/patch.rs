//! Friction of a whole patch in one: shift and turn are three lengths, the turn's at the load's mean distance from where
//! the object turns, and one law holds in all directions of that space.

use serde::Serialize;

use super::{CELL_N, Friction, Pull, STEP_S, SlipState, Springs};
use crate::contact::{PressureMap, cell_mm};
use crate::draw::{Draw, Rng};
use crate::objects::Object;

#[derive(Default)]
pub(super) struct Moved {
    pub by_mm: [f64; 3],
    /// On the finger.
    pub force_n: [f64; 3],
    /// Share of the load that slides.
    pub sliding: f64,
}

pub(super) trait Law: Serialize {
    /// One step under a load above 0.
    fn step(&mut self, springs: &Springs, load_n: f64) -> Moved;
    fn rest(&mut self);
}

#[derive(Serialize)]
pub(super) struct Patch<L> {
    law: L,
    #[serde(skip)]
    now: SlipState,
}

pub(super) fn size(v: [f64; 3]) -> f64 {
    (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt()
}

/// Static and kinetic friction of a grasp of an object.
pub(super) fn frictions(rng: &mut Rng, object: &Object) -> (f64, f64) {
    let level = libm::exp(0.15 * rng.normal());
    (level * object.mu_static, level * object.mu_kinetic)
}

impl<L: Law> Patch<L> {
    pub fn new(law: L) -> Self {
        Self { law, now: SlipState { direction: [0.0, 1.0], ..SlipState::default() } }
    }
}

impl<L: Law> Friction for Patch<L> {
    fn step(&mut self, map: &PressureMap, scale: f64, pull: Pull) -> SlipState {
        let (mut load_n, mut moment) = (0.0, 0.0);
        for &cell in &map.loaded {
            let (x, y) = cell_mm(cell);
            let (x, y) = (x - map.pivot_mm[0], y - map.pivot_mm[1]);
            load_n += map.kpa[cell];
            moment += map.kpa[cell] * (x * x + y * y).sqrt();
        }
        let arm_mm = if load_n > 0.0 { (moment / load_n).max(0.5) } else { 1.0 };
        load_n *= CELL_N * scale;
        let springs = pull.springs(&self.now, arm_mm);
        let moved = if load_n > 0.0 {
            self.law.step(&springs, load_n)
        } else {
            // A free object goes where its springs are slack.
            self.law.rest();
            let Springs { stiffness, stretch } = springs;
            let by_mm = std::array::from_fn(|axis| if stiffness[axis] > 0.0 { stretch[axis] } else { 0.0 });
            Moved { by_mm, ..Moved::default() }
        };
        let [x, y, turn] = moved.by_mm;
        let way_mm = if load_n > 0.0 { size(moved.by_mm) } else { 0.0 };
        let drift = (x * x + y * y).sqrt();
        if load_n > 0.0 && drift > 0.02 * way_mm && drift > 1e-7 {
            self.now.direction = [x / drift, y / drift];
        }
        self.now = SlipState {
            speed_mm_s: way_mm / STEP_S,
            fraction: moved.sliding,
            shear_n: [moved.force_n[0], moved.force_n[1]],
            torque_n_mm: moved.force_n[2] * arm_mm,
            travel_mm: [self.now.travel_mm[0] + x, self.now.travel_mm[1] + y],
            turn_rad: self.now.turn_rad + turn / arm_mm,
            path_mm: self.now.path_mm + way_mm,
            direction: self.now.direction,
        };
        self.now
    }
}
