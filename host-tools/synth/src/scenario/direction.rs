//! Which way an object slips over the pad: one way on the rig, any by hand. Training has both.

use libm::{cos, sin};
use serde::{Deserialize, Serialize};

/// A pull within this of the rig's direction counts as vertical, degrees.
pub const VERTICAL_WITHIN_DEG: f64 = 15.0;

/// Way of a slip, relative to the pad; in the metadata of episodes by hand as `slip_direction`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SlipDirection {
    /// As the rig's crosshead pulls, along the pad towards its tip, within [`VERTICAL_WITHIN_DEG`].
    Vertical,
    /// Any other way in the pad's plane, the rig's backwards among them.
    OtherInPlane,
    /// A turn about the pad's normal.
    Rotational,
}

/// Unit vector in the first finger's pad x and y of a pull this far counter-clockwise from the rig's, degrees.
pub(crate) fn unit_vector(angle_deg: f64) -> [f64; 2] {
    let angle = angle_deg.to_radians();
    [-sin(angle), cos(angle)]
}
