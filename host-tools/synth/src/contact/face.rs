//! Pressures of faces that no elastic layer makes: the relative pressure at a place of the object's face under a force.
//!
//! Places are `u` across and `v` along the object's axis, mm from its centre; the sum is scaled to the force later.

use libm::{exp, log, pow};
use serde::Serialize;
use slipsense::params::TAXELS;

use super::map::{PressureMap, active_cells};
use crate::draw::{Draw, Rng};
use crate::families::ContactFamily;
use crate::objects::{Object, PAD_LENGTH_MM, PAD_WIDTH_MM, Shape};

/// Pressures below this share of the highest are left out.
const NEGLIGIBLE: f64 = 1e-3;
/// Force that widths are stated at, N.
const REFERENCE_N: f64 = 2.0;
/// Slope of the face at which one edge bears twice the mean.
const TILT_FULL: f64 = 0.03;

#[derive(Serialize)]
pub(super) enum Face {
    /// Half width of a round thing's plateau at the reference, its growth with force, and the plateau's flatness.
    Conforming { half_mm: f64, exponent: f64, flatness: f64 },
    /// Width of the summits and the depth of their heights.
    Summits {
        width_mm: f64,
        depth_mm: f64,
        summits: Vec<Summit>,
        /// Indices of the summits, sorted by their `u_mm`.
        #[serde(skip)]
        by_u: Vec<usize>,
    },
    /// Half width of a ball's patch and of a rod's at the reference; what rounds the edges of a flat punch.
    HalfSpace { half_mm: f64, edge: f64 },
}

#[derive(Serialize)]
pub(super) struct Summit {
    u_mm: f64,
    v_mm: f64,
    below_mm: f64,
}

impl Face {
    /// `None` for the foundation.
    pub fn draw(family: ContactFamily, rng: &mut Rng, object: &Object) -> Option<Self> {
        Some(match family {
            ContactFamily::Foundation => return None,
            ContactFamily::Conforming => Self::Conforming {
                half_mm: rng.log_between(1.2, 5.0),
                exponent: rng.between(0.1, 0.3),
                flatness: rng.log_between(1.5, 6.0),
            },
            ContactFamily::Summits => {
                let (pitch_mm, depth_mm) = (rng.log_between(1.0, 3.0), rng.log_between(0.02, 0.15));
                let half = half_mm(object);
                let count = (4.0 * half[0] * half[1] / (pitch_mm * pitch_mm)).ceil() as usize + 1;
                let summits: Vec<_> = (0..count)
                    .map(|_| {
                        let (u_mm, v_mm) = (rng.between(-half[0], half[0]), rng.between(-half[1], half[1]));
                        let shape_mm = object.shape.bare_gap_mm(0.98 * u_mm, 0.98 * v_mm);
                        let below_mm = depth_mm * rng.exponential(1e-4) + shape_mm;
                        Summit { u_mm, v_mm, below_mm }
                    })
                    .filter(|summit| summit.below_mm.is_finite())
                    .collect();
                let mut by_u: Vec<_> = (0..summits.len()).collect();
                by_u.sort_by(|&a, &b| summits[a].u_mm.total_cmp(&summits[b].u_mm));
                Self::Summits { width_mm: pitch_mm * rng.between(0.25, 0.6), depth_mm, summits, by_u }
            }
            ContactFamily::HalfSpace => {
                Self::HalfSpace { half_mm: rng.log_between(0.8, 3.0), edge: rng.log_between(0.03, 0.3) }
            }
        })
    }

    /// Relative pressures of an object at whose [`place`](super::Contact::places) each cell lies.
    pub fn press(
        &self,
        object: &Object,
        force_n: f64,
        place: impl Fn(usize) -> (f64, f64),
        tilt: [f64; 2],
        out: &mut PressureMap,
    ) {
        let half = half_mm(object);
        let (mut pressures, mut near) = ([0.0; TAXELS], Vec::new());
        for cell in active_cells() {
            let (u, v) = place(cell);
            if u.abs() < half[0] && v.abs() < half[1] {
                let lean = 1.0 + (tilt[0] * u / half[0] + tilt[1] * v / half[1]) / TILT_FULL;
                pressures[cell] = self.at(object, force_n, (u, v), half, &mut near) * lean.clamp(0.0, 2.0);
            }
        }
        let highest = pressures.iter().fold(0.0, |a: f64, &p| a.max(p));
        for cell in active_cells().filter(|&cell| pressures[cell] > NEGLIGIBLE * highest) {
            out.kpa[cell] = pressures[cell];
            out.loaded.push(cell);
        }
    }

    fn at(
        &self,
        object: &Object,
        force_n: f64,
        (u, v): (f64, f64),
        half: [f64; 2],
        near: &mut Vec<usize>,
    ) -> f64 {
        let force = force_n / REFERENCE_N;
        match self {
            Self::Conforming { half_mm, exponent, flatness } => {
                let grown = half_mm * pow(force, *exponent);
                let [a, b] = match object.shape {
                    Shape::Flat { .. } => half,
                    Shape::Cylinder { .. } => [grown.min(half[0]), half[1]],
                    Shape::Sphere { .. } => [grown.min(half[0]); 2],
                };
                let side = |x: f64, a: f64| (1.0 - pow((x / a).abs(), *flatness)).max(0.0);
                side(u, a) * side(v, b)
            }
            Self::Summits { width_mm, depth_mm, summits, by_u } => {
                let depth = depth_mm * (2.0 + log(force.max(1e-3))).max(0.3);
                let reach = 2.5 * width_mm;
                let first = by_u.partition_point(|&s| summits[s].u_mm - u <= -reach);
                let across = by_u[first..].iter().copied().take_while(|&s| summits[s].u_mm - u < reach);
                near.clear();
                near.extend(
                    across.filter(|&s| summits[s].below_mm < depth && (summits[s].v_mm - v).abs() < reach),
                );
                // Summed as drawn: a float sum depends on the order.
                near.sort_unstable();
                near.iter()
                    .map(|&s| {
                        let Summit { u_mm, v_mm, below_mm } = summits[s];
                        let (du, dv) = ((u_mm - u) / width_mm, (v_mm - v) / width_mm);
                        (depth - below_mm) * exp(-0.5 * (du * du + dv * dv))
                    })
                    .sum()
            }
            Self::HalfSpace { half_mm, edge } => {
                let punch = |x: f64, a: f64| 1.0 / (1.0 - (x / a) * (x / a) + edge).sqrt();
                let ellipse = |r2: f64| (1.0 - r2).max(0.0).sqrt();
                match object.shape {
                    Shape::Sphere { .. } => {
                        let a = half_mm * pow(force, 1.0 / 3.0);
                        ellipse((u * u + v * v) / (a * a))
                    }
                    Shape::Cylinder { .. } => {
                        let a = half_mm * force.sqrt();
                        ellipse(u * u / (a * a)) * punch(v, half[1])
                    }
                    Shape::Flat { .. } => punch(u, half[0]) * punch(v, half[1]),
                }
            }
        }
    }
}

/// Half of what can touch the pad, across and along the object's axis.
fn half_mm(object: &Object) -> [f64; 2] {
    let [width, length] = object.shape.extent_mm();
    [width.min(1.4 * PAD_WIDTH_MM) / 2.0, length.min(1.4 * PAD_LENGTH_MM) / 2.0]
}
