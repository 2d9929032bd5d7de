//! Contact pressure: an elastic layer on a stiff backing (Winkler foundation) indented by the object.
//!
//! `p = K · max(0, depth − gap(x, y))`, with the depth that makes the pressures carry the grip force.
//! The gap is sampled on the 0.45 × 0.45 mm element in the middle of each 0.7 × 0.92 mm cell; the mean
//! over the element stands for the cell, so that the sum of pressure times cell area is the force. The
//! pressure is then spread over neighbours, as a layer of finite thickness does, and rescaled.
//!
//! A layer much thinner than the patch is wide does not obey Hertz: under a sphere its patch radius rises
//! as F^¼ and not F^⅓. The test `half_space.rs` compares it with the half-space.

mod asperity;
mod face;
mod layer;
mod map;
mod rocking;
mod spread;
#[cfg(test)]
mod half_space;
#[cfg(test)]
pub(crate) mod tests;

use std::cell::Cell;

use libm::sincos;
use serde::Serialize;
use slipsense::params::{TAXEL_COLS, TAXEL_ROWS, TAXELS};

pub(crate) use asperity::AsperityNoise;
use face::Face;
use layer::Layer;
pub use map::{CELL_MM2, PressureMap};
pub(crate) use map::{active_cells, cell_mm};
pub(crate) use rocking::Rocking;

use crate::draw::{Draw, Rng};
use crate::families::ContactFamily;
use crate::field::Field;
use crate::objects::{Kind, Object};
use crate::recipe::Region;
use spread::Spread;

/// Side of the sensing element (paper: 0.45 × 0.45 mm).
const ELEMENT_MM: f64 = 0.45;
/// Deeper parts of the face never touch: more than a layer is thick, plus what 3° of tilt lift over half the pad.
const REACH_MM: f64 = 2.5;
/// A smaller move leaves the gaps as they were worked out: less than a thousandth of the pitch of the cells.
const STILL_MM: f64 = 2e-4;

/// Where an object lies on a pad.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Pose {
    /// Centre across the finger.
    pub x_mm: f64,
    /// Centre along the finger.
    pub y_mm: f64,
    /// Angle between the object's axis and the finger's.
    pub yaw_rad: f64,
    /// Slope of the object's face across and along its axis.
    pub tilt: [f64; 2],
}

/// Elastic layer of one finger with the object it touches.
#[derive(Serialize)]
pub struct Contact {
    pose: Pose,
    /// As drawn; absent where a test sets the stiffness itself.
    #[serde(skip_serializing_if = "Option::is_none")]
    layer: Option<Layer>,
    /// Layer and object's surface in series.
    stiffness_kpa_per_mm: f64,
    /// Relative rms of the pressure's unevenness under a rough face.
    uneven_rms: f64,
    /// Its correlation length across and along the object's axis.
    uneven_mm: [f64; 2],
    /// In place of the layer.
    #[serde(skip_serializing_if = "Option::is_none")]
    face: Option<Face>,
    /// Slopes of the face now.
    #[serde(skip)]
    tilt: [f64; 2],
    #[serde(skip)]
    object: &'static Object,
    #[serde(skip)]
    uneven: Field,
    #[serde(skip)]
    spread: Spread,
    /// Shift in x and y and turn since gripped, at which `spots` were worked out.
    #[serde(skip)]
    moved: [f64; 3],
    #[serde(skip)]
    spots: Vec<Spot>,
    /// Gaps of all spots, one spot's after the other's, tilted.
    #[serde(skip)]
    gaps_mm: Vec<f64>,
    #[serde(skip)]
    points: Vec<Point>,
    /// Depth found last: where the next search starts.
    #[serde(skip)]
    depth_mm: Cell<f64>,
}

struct Spot {
    cell: usize,
    /// Its points among all: four Gauss points of the element, or its centre where that says the same.
    points: std::ops::Range<usize>,
    uneven: f64,
}

struct Point {
    /// Gap without tilt.
    gap_mm: f64,
    /// Across and along the object's axis.
    u_mm: f64,
    v_mm: f64,
    share: f64,
}

impl Contact {
    /// A finger's layer drawn from its range, and the face of this grasp.
    pub(crate) fn draw(rng: &mut Rng, object: &'static Object, pose: Pose, region: Region) -> Self {
        let layer = Layer::draw(rng, region);
        let rms = rng.between(0.02, 0.08);
        let length = rng.log_between(0.3, 2.0);
        // The surface of a cable hardly changes as it is drawn through the fingers.
        let stretch = if object.kind == Kind::Cable { 12.0 } else { 1.0 };
        let lengths = [length, length * stretch];
        let uneven = Field::draw(rng, lengths);
        let mut contact = Self::new(object, pose, layer.stiffness_kpa_per_mm(), layer.spread_mm());
        contact.layer = Some(layer);
        (contact.uneven_rms, contact.uneven_mm, contact.uneven) = (rms, lengths, uneven);
        contact.sample();
        contact
    }

    /// A layer of given stiffness and spread (Gaussian sigma, 0 for none) under an even face.
    pub fn new(object: &'static Object, pose: Pose, layer_kpa_per_mm: f64, spread_mm: f64) -> Self {
        let own = object.surface.normal_kpa_per_mm();
        let mut contact = Self {
            pose,
            layer: None,
            stiffness_kpa_per_mm: 1.0 / (1.0 / layer_kpa_per_mm + 1.0 / own),
            uneven_rms: 0.0,
            uneven_mm: [0.0; 2],
            face: None,
            tilt: [0.0; 2],
            object,
            uneven: Field::even(),
            spread: Spread::new(spread_mm),
            moved: [0.0; 3],
            spots: Vec::new(),
            gaps_mm: Vec::new(),
            points: Vec::new(),
            depth_mm: Cell::new(0.0),
        };
        contact.sample();
        contact.place([0.0; 2], 0.0, [0.0; 2]);
        contact
    }

    /// Let a face of this family press instead of the layer.
    pub(crate) fn with_face(mut self, family: ContactFamily, rng: &mut Rng) -> Self {
        self.face = Face::draw(family, rng, self.object);
        self
    }

    /// Move the object by `shift_mm` in the pad's x and y and by `turn_rad` about its own centre from
    /// where it was gripped, and let it rock by `rock` (slopes across and along its axis).
    pub fn place(&mut self, shift_mm: [f64; 2], turn_rad: f64, rock: [f64; 2]) {
        let [x, y, turn] = self.moved;
        // A turn moves what lies a pad's half length from the centre.
        let turned_mm = 15.0 * (turn - turn_rad).abs();
        if (x - shift_mm[0]).abs() + (y - shift_mm[1]).abs() + turned_mm > STILL_MM {
            self.moved = [shift_mm[0], shift_mm[1], turn_rad];
            self.sample();
        }
        let tilt = [self.pose.tilt[0] + rock[0], self.pose.tilt[1] + rock[1]];
        self.tilt = tilt;
        self.gaps_mm.clear();
        self.gaps_mm.extend(self.points.iter().map(|p| p.gap_mm + tilt[0] * p.u_mm + tilt[1] * p.v_mm));
    }

    fn centre_mm(&self) -> [f64; 2] {
        [self.pose.x_mm + self.moved[0], self.pose.y_mm + self.moved[1]]
    }

    /// From cells to places across and along the object's axis, mm from its centre where it lies now.
    fn places(&self) -> impl Fn(usize) -> (f64, f64) + use<> {
        let (sin, cos) = sincos(self.pose.yaw_rad + self.moved[2]);
        let centre = self.centre_mm();
        move |cell| {
            let (x, y) = cell_mm(cell);
            let (dx, dy) = (x - centre[0], y - centre[1]);
            (dx * cos + dy * sin, dy * cos - dx * sin)
        }
    }

    /// Gaps of the cells under the object where it lies now.
    fn sample(&mut self) {
        // Two Gauss points each way.
        const OFF_MM: f64 = ELEMENT_MM / 2.0 * 0.577_350_269_189_625_8;
        let place = self.places();
        let half = self.object.shape.extent_mm().map(|mm| mm / 2.0 + ELEMENT_MM);
        self.spots.clear();
        self.points.clear();
        if self.face.is_some() {
            return;
        }
        for cell in active_cells() {
            let (u, v) = place(cell);
            if u.abs() > half[0] || v.abs() > half[1] {
                continue;
            }
            let first = self.points.len();
            if self.object.relief.is_none() && self.object.shape.even_around(u, v, ELEMENT_MM) {
                self.points.push(Point { gap_mm: 0.0, u_mm: u, v_mm: v, share: 1.0 });
            } else {
                for (du, dv) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
                    let (u_mm, v_mm) = (u + du * OFF_MM, v + dv * OFF_MM);
                    let gap_mm = self.object.gap_mm(u_mm, v_mm);
                    if gap_mm < REACH_MM {
                        self.points.push(Point { gap_mm, u_mm, v_mm, share: 0.25 });
                    }
                }
            }
            if self.points.len() > first {
                let uneven = self.uneven_rms * self.uneven.at(u, v);
                self.spots.push(Spot { cell, points: first..self.points.len(), uneven });
            }
        }
    }

    /// Indentation at which the layer carries `force_n`. The force rises with depth in straight pieces
    /// that only get steeper, so Newton steps settle after a few, from above after the first.
    fn indent_mm(&self, force_n: f64) -> f64 {
        let load_mm = force_n * 1e3 / (self.stiffness_kpa_per_mm * CELL_MM2);
        let mut depth = self.depth_mm.get();
        for _ in 0..100 {
            let (mut shares, mut gaps) = (0.0, 0.0);
            for (&gap, point) in self.gaps_mm.iter().zip(&self.points) {
                // Without a branch, so that it can be done for several at a time.
                let touches = if gap < depth { point.share } else { 0.0 };
                shares += touches;
                gaps += touches * gap;
            }
            let next = if shares > 0.0 {
                (load_mm + gaps) / shares
            } else {
                // Deep enough for one point to carry it all.
                self.gaps_mm.iter().fold(f64::INFINITY, |a, &g| a.min(g)) + 4.0 * load_mm
            };
            let step = next - depth;
            depth = next;
            if step.abs() < 1e-10 {
                break;
            }
        }
        self.depth_mm.set(depth);
        depth
    }

    /// Pressures under a grip of `force_n` newtons sheared by `shear` = lean · Q / F, a vector in the pad's
    /// x and y: the moment of the shear about the layer tilts the pressure by
    /// `1 + shear · (r − centroid) / half length of the patch along the shear`, towards the leading edge.
    /// Nothing touches where the force is not a finite number above 0 or no object lies on the pad.
    pub fn pressures(&self, force_n: f64, shear: [f64; 2], out: &mut PressureMap) {
        out.clear();
        out.pivot_mm = self.centre_mm();
        if !(force_n > 0.0 && force_n.is_finite()) {
            return;
        }
        match &self.face {
            Some(face) => face.press(self.object, force_n, self.places(), self.tilt, out),
            None if self.points.is_empty() => {}
            None => self.press(force_n, out),
        }
        if out.loaded.is_empty() {
            return;
        }
        lean(shear, out);
        out.carry(force_n);
    }

    fn press(&self, force_n: f64, out: &mut PressureMap) {
        let depth = self.indent_mm(force_n);
        let mut sharp = [0.0; TAXELS];
        let (mut rows, mut cols) = ((TAXEL_ROWS, 0), (TAXEL_COLS, 0));
        for spot in &self.spots {
            let points = spot.points.clone();
            let gaps = self.gaps_mm[points.clone()].iter().zip(&self.points[points]);
            let dent: f64 = gaps.map(|(&gap, point)| point.share * (depth - gap).max(0.0)).sum();
            if dent > 0.0 {
                sharp[spot.cell] = self.stiffness_kpa_per_mm * dent;
                rows = (rows.0.min(spot.cell / TAXEL_COLS), rows.1.max(spot.cell / TAXEL_COLS));
                cols = (cols.0.min(spot.cell % TAXEL_COLS), cols.1.max(spot.cell % TAXEL_COLS));
            }
        }
        self.spread.over(&sharp, rows, cols, out);
        for spot in &self.spots {
            out.kpa[spot.cell] *= (1.0 + spot.uneven).max(0.0);
        }
    }
}

fn lean(shear: [f64; 2], out: &mut PressureMap) {
    let size = (shear[0] * shear[0] + shear[1] * shear[1]).sqrt();
    if size < 1e-9 {
        return;
    }
    let along = |cell: usize| {
        let (x, y) = cell_mm(cell);
        (x * shear[0] + y * shear[1]) / size
    };
    let (mut moment, mut total) = (0.0, 0.0);
    for &cell in &out.loaded {
        moment += out.kpa[cell] * along(cell);
        total += out.kpa[cell];
    }
    let centroid = moment / total;
    let extent = out.loaded.iter().map(|&cell| (along(cell) - centroid).abs()).fold(0.5, f64::max);
    for &cell in &out.loaded {
        out.kpa[cell] *= 1.0 + (size * (along(cell) - centroid) / extent).clamp(-0.9, 0.9);
    }
}
