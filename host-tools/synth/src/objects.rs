//! The objects: shapes, friction and surface. The catalogue is a file, `catalogue.json`; its values are
//! typical of the materials (ranges of handbooks), not measurements of particular specimens.

mod check;
mod shape;
#[cfg(test)]
mod tests;
mod varied;

use std::sync::{LazyLock, Mutex, PoisonError};

use serde::{Deserialize, Serialize};

pub use check::{PAD_LENGTH_MM, PAD_WIDTH_MM};
pub use shape::{Form, Relief, Shape};

/// What sort of thing it is; the held-out group has at least two of each.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// Long, flexible, the same along its axis.
    Cable,
    /// Box-like or round, with ribs or a knurl.
    Connector,
    /// Flat piece of a material, Shore blocks among them.
    Material,
    /// Rigid and mostly ringing.
    Tool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Group {
    /// Training, and tests of known objects.
    Train,
    /// One of the training objects kept apart for choosing among trained models.
    Val,
    /// Tests of unknown objects only.
    HeldOut,
}

/// What the object's face is made of, where it gives way under a fingertip.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Surface {
    /// Much stiffer than the finger.
    Hard,
    /// Elastic over a depth comparable with the patch.
    Elastic {
        /// Young's modulus.
        modulus_mpa: f64,
        /// Thickness of the skin, or the depth to which the patch is felt in a solid block.
        depth_mm: f64,
    },
    /// The same for a rubber of known hardness, its modulus by [`gent_mpa`].
    Rubber {
        /// Shore A durometer hardness, 10–98.
        shore_a: f64,
        depth_mm: f64,
    },
}

impl Surface {
    /// Normal stiffness per area, kPa/mm: E / depth, free to bulge at the sides. Infinite for hard things.
    pub fn normal_kpa_per_mm(&self) -> f64 {
        match *self {
            Self::Hard => f64::INFINITY,
            Self::Elastic { modulus_mpa, depth_mm } => 1e3 * modulus_mpa / depth_mm,
            Self::Rubber { shore_a, depth_mm } => 1e3 * gent_mpa(shore_a) / depth_mm,
        }
    }

    /// Tangential stiffness per area, kPa/mm: G / depth with G = E / 3 (Poisson's ratio near one half).
    pub fn tangential_kpa_per_mm(&self) -> f64 {
        self.normal_kpa_per_mm() / 3.0
    }
}

/// Young's modulus in MPa of a rubber of `shore_a` hardness (A. N. Gent, "On the relation between
/// indentation hardness and Young's modulus", 1958). 60 HA: 3.6, 81 HA: 10, 88 HA: 17 MPa.
pub fn gent_mpa(shore_a: f64) -> f64 {
    0.0981 * (56.0 + 7.66 * shore_a) / (0.137505 * (254.0 - 2.54 * shore_a))
}

/// One object, of the catalogue or of a recipe.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Object {
    /// Name, as in recipes and in the metadata of episodes.
    pub name: String,
    pub kind: Kind,
    pub group: Group,
    /// Face that meets the finger.
    pub shape: Shape,
    /// How the face gives way.
    pub surface: Surface,
    /// Ribs, thread, braid or lanes on the face.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub relief: Option<Relief>,
    /// Static friction against the elastomer of the finger: metal and plastic 0.3–0.8, rubber 0.6–1.2,
    /// paper and tape 0.3–0.6, wet or oily 0.1–0.3.
    pub mu_static: f64,
    /// Kinetic friction, 0.75–0.95 of the static.
    pub mu_kinetic: f64,
    /// Arithmetic mean roughness Ra.
    pub roughness_um: f64,
    /// Wavelengths of periodic texture along the axis, 0.05–2 mm.
    pub texture_mm: Vec<f64>,
    /// Share of the slip vibration that is texture lines, 0–1.
    pub texture_share: f64,
    /// Strength of stick-slip pulses, 0–1.
    pub stick_slip: f64,
    /// The object's own mode, struck through the contact; 0 for things that do not ring.
    pub ring_hz: f64,
    /// Damping ratio of that mode, or of the object's share in the finger's modes, 0–1.
    pub damping: f64,
    /// Mass that a hand has to carry.
    pub mass_g: f64,
}

impl Object {
    /// Height of the face above its top, mm, at `u` across and `v` along its axis, mm; infinite beside the object.
    pub(crate) fn gap_mm(&self, u: f64, v: f64) -> f64 {
        let bare = self.shape.bare_gap_mm(u, v);
        match &self.relief {
            Some(relief) if bare.is_finite() => bare + relief.depth_at(u, v),
            _ => bare,
        }
    }

    /// Training must never see it.
    pub fn held_out(&self) -> bool {
        self.group == Group::HeldOut
    }
}

/// The catalogue: 14 cables, 7 connectors, 9 materials, 7 tools; 24 for training, 4 for validation, 9
/// held out. The file is part of the program and is checked by a test, so reading it cannot fail.
pub static CATALOGUE: LazyLock<Vec<Object>> =
    LazyLock::new(|| serde_json::from_str(include_str!("../catalogue.json")).expect("catalogue.json"));

pub fn named(name: &str) -> Option<&'static Object> {
    CATALOGUE.iter().find(|o| o.name == name)
}

/// This object for as long as the program runs, as everything that grips one of the catalogue relies on: leaked, equal
/// ones once, so that a set of many episodes of one object costs no more memory than one episode.
pub(crate) fn keep(object: &Object) -> &'static Object {
    static KEPT: Mutex<Vec<&'static Object>> = Mutex::new(Vec::new());
    // Nothing panics between lock and push, and a list without the last one is still right.
    let mut kept = KEPT.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(known) = kept.iter().find(|known| **known == object) {
        return known;
    }
    let object: &'static Object = Box::leak(Box::new(object.clone()));
    kept.push(object);
    object
}

/// The objects of exactly this group, in the order of the catalogue.
pub fn of_group(group: Group) -> impl Iterator<Item = &'static Object> {
    CATALOGUE.iter().filter(move |o| o.group == group)
}
