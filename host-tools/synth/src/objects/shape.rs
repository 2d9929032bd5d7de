//! Geometry of the face that meets a finger.

use serde::{Deserialize, Serialize};

/// Geometry of the face. Lengths are along the object's axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Shape {
    Cylinder {
        /// Radius; 1–6 mm for cables.
        radius_mm: f64,
        length_mm: f64,
    },
    /// Ball or knob.
    Sphere { radius_mm: f64 },
    /// Flat face with rounded edges: a box, a block, a strip.
    Flat {
        /// Across the axis.
        width_mm: f64,
        /// Along the axis.
        length_mm: f64,
        /// Radius of the edges, 0.3–0.8 mm.
        edge_mm: f64,
    },
}

impl Shape {
    /// Full extent of the face across and along its axis.
    pub fn extent_mm(&self) -> [f64; 2] {
        match *self {
            Self::Cylinder { radius_mm, length_mm } => [2.0 * radius_mm, length_mm],
            Self::Sphere { radius_mm } => [2.0 * radius_mm; 2],
            Self::Flat { width_mm, length_mm, .. } => [width_mm, length_mm],
        }
    }

    /// How far the object may slide along its axis and still lie on the pad.
    pub(crate) fn travel_mm(&self) -> f64 {
        match self {
            Self::Sphere { .. } => 12.0,
            Self::Cylinder { length_mm, .. } | Self::Flat { length_mm, .. } => {
                (length_mm - 14.0).clamp(8.0, 40.0)
            }
        }
    }

    /// Height of the smooth face above its highest point at `(u, v)`; infinite beside the object.
    pub(crate) fn bare_gap_mm(&self, u: f64, v: f64) -> f64 {
        match *self {
            Self::Cylinder { radius_mm: r, length_mm } => {
                if u.abs() < r && v.abs() < length_mm / 2.0 {
                    r - (r * r - u * u).sqrt()
                } else {
                    f64::INFINITY
                }
            }
            Self::Sphere { radius_mm: r } => {
                let d2 = u * u + v * v;
                if d2 < r * r { r - (r * r - d2).sqrt() } else { f64::INFINITY }
            }
            Self::Flat { width_mm, length_mm, edge_mm: r } => {
                let out_u = (u.abs() - width_mm / 2.0 + r).max(0.0);
                let out_v = (v.abs() - length_mm / 2.0 + r).max(0.0);
                let d2 = out_u * out_u + out_v * out_v;
                match d2 {
                    0.0 => 0.0,
                    d2 if d2 < r * r => r - (r * r - d2).sqrt(),
                    _ => f64::INFINITY,
                }
            }
        }
    }

    /// The face is an even plane all around `(u, v)`, as far as `margin_mm`.
    pub(crate) fn even_around(&self, u: f64, v: f64, margin_mm: f64) -> bool {
        match *self {
            Self::Flat { width_mm, length_mm, edge_mm } => {
                let inset = edge_mm + margin_mm;
                u.abs() < width_mm / 2.0 - inset && v.abs() < length_mm / 2.0 - inset
            }
            _ => false,
        }
    }
}

/// Periodic height of the face.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Relief {
    pub form: Form,
    /// Distance between two tops.
    pub pitch_mm: f64,
    pub depth_mm: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Form {
    /// Smooth waves across the axis.
    Rings,
    /// Flat tops with narrow grooves across the axis.
    Ridges,
    /// Sharp V grooves across the axis.
    Thread,
    /// Pyramids between two sets of V grooves at 45°.
    Knurl,
    /// Smooth strands crossing at 45°.
    Braid,
    /// Smooth waves along the axis: wires side by side, flutes.
    Lanes,
    /// Smooth waves at 45°: strands wound around each other, helical flutes.
    Twist,
}

impl Relief {
    /// Depth below the tops at `(u, v)`.
    pub(super) fn depth_at(&self, u: f64, v: f64) -> f64 {
        // 0 on a top, 1 in a valley, straight in between.
        let valley = |mm: f64| {
            // Far to the positive side, where cutting off the fraction is rounding down, and cheap.
            let cycles = mm / self.pitch_mm + 4096.0;
            1.0 - (2.0 * (cycles - f64::from(cycles as u32)) - 1.0).abs()
        };
        // Within 1 % of a raised cosine.
        let smooth = |w: f64| w * w * (3.0 - 2.0 * w);
        const DIAGONAL: f64 = std::f64::consts::FRAC_1_SQRT_2;
        let (left, right) = ((v + u) * DIAGONAL, (v - u) * DIAGONAL);
        self.depth_mm
            * match self.form {
                Form::Rings => smooth(valley(v)),
                Form::Ridges => ((valley(v) - 0.6) / 0.4).max(0.0),
                Form::Thread => valley(v),
                Form::Knurl => valley(left).max(valley(right)),
                Form::Braid => 0.5 * (smooth(valley(left)) + smooth(valley(right))),
                Form::Lanes => smooth(valley(u)),
                Form::Twist => smooth(valley(left)),
            }
    }
}
