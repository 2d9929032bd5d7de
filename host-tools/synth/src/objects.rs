//! The objects: shapes, friction and surface. Values are typical of the materials (field ranges), not
//! measurements of particular specimens.

/// What sort of thing it is; the held-out group has one of each at least.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// Long, round, flexible.
    Cable,
    /// Box-like, with ribs or a knurl.
    Connector,
    /// Flat piece of a material, Shore blocks among them.
    Material,
    /// Hard and ringing.
    Tool,
}

/// Geometry of the face that meets a finger. Lengths are along the object's axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// Cylinder lying on the pad.
    Cylinder {
        /// Radius.
        radius_mm: f64,
        /// Length.
        length_mm: f64,
    },
    /// Ball or knob.
    Sphere {
        /// Radius.
        radius_mm: f64,
    },
    /// Flat face with rounded edges.
    Flat {
        /// Across the axis.
        width_mm: f64,
        /// Along the axis.
        length_mm: f64,
        /// Radius of the edges.
        edge_mm: f64,
    },
}

impl Shape {
    /// How far the object may slide along its axis and still lie on the pad.
    pub(crate) fn travel_mm(&self) -> f64 {
        match self {
            Shape::Sphere { .. } => 12.0,
            Shape::Cylinder { length_mm, .. } | Shape::Flat { length_mm, .. } => {
                (length_mm - 14.0).clamp(8.0, 40.0)
            }
        }
    }
}

/// One object of the catalogue.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Object {
    /// Name, as in recipes and in the metadata of episodes.
    pub name: &'static str,
    /// Sort of thing.
    pub kind: Kind,
    /// Never used for training.
    pub held_out: bool,
    /// Face that meets the finger.
    pub shape: Shape,
    /// Stiffness of the object's own surface layer; infinite for hard things.
    pub layer_kpa_per_mm: f64,
    /// Ribs, thread or braid across the axis: pitch. Also the longest texture wavelength.
    pub relief_pitch_mm: f64,
    /// Their depth.
    pub relief_depth_mm: f64,
    /// Static friction against the elastomer of the finger.
    pub mu_static: f64,
    /// Kinetic friction.
    pub mu_kinetic: f64,
    /// Arithmetic mean roughness Ra.
    pub roughness_um: f64,
    /// Wavelengths of periodic texture.
    pub texture_mm: &'static [f64],
    /// Share of the slip vibration that is texture lines, 0–1.
    pub texture_share: f64,
    /// Strength of stick-slip pulses, 0–1.
    pub stick_slip: f64,
    /// The object's own mode, struck through the contact; 0 for things that do not ring.
    pub ring_hz: f64,
}

const HARD: f64 = f64::INFINITY;
const PLAIN: Object = Object {
    name: "",
    kind: Kind::Material,
    held_out: false,
    shape: Shape::Sphere { radius_mm: 10.0 },
    layer_kpa_per_mm: HARD,
    relief_pitch_mm: 1.0,
    relief_depth_mm: 0.0,
    mu_static: 0.6,
    mu_kinetic: 0.5,
    roughness_um: 1.0,
    texture_mm: &[],
    texture_share: 0.0,
    stick_slip: 0.2,
    ring_hz: 0.0,
};

const fn cable(name: &'static str, radius_mm: f64) -> Object {
    Object { name, kind: Kind::Cable, shape: Shape::Cylinder { radius_mm, length_mm: 200.0 }, ..PLAIN }
}

const fn flat(name: &'static str, kind: Kind, width_mm: f64, length_mm: f64) -> Object {
    Object { name, kind, shape: Shape::Flat { width_mm, length_mm, edge_mm: 0.5 }, ..PLAIN }
}

const fn round(name: &'static str, kind: Kind, radius_mm: f64, length_mm: f64) -> Object {
    Object { name, kind, shape: Shape::Cylinder { radius_mm, length_mm }, ..PLAIN }
}

/// The catalogue.
#[rustfmt::skip]
pub static CATALOGUE: [Object; 19] = [
    Object { mu_static: 0.7, mu_kinetic: 0.58, roughness_um: 1.2, stick_slip: 0.4, layer_kpa_per_mm: 9e3, ..cable("usb-cable", 2.0) },
    Object { mu_static: 0.65, mu_kinetic: 0.55, roughness_um: 2.0, layer_kpa_per_mm: 6e3, ..cable("mains-cord", 3.6) },
    Object { mu_static: 0.5, mu_kinetic: 0.42, roughness_um: 1.5, texture_mm: &[6.0, 0.35], texture_share: 0.3, relief_pitch_mm: 6.0, relief_depth_mm: 0.02, ..cable("ethernet-cable", 2.8) },
    Object { mu_static: 1.0, mu_kinetic: 0.8, roughness_um: 0.8, stick_slip: 0.8, layer_kpa_per_mm: 3e3, ..cable("silicone-wire", 1.3) },
    Object { held_out: true, mu_static: 0.45, mu_kinetic: 0.38, roughness_um: 4.0, texture_mm: &[1.1, 0.28], texture_share: 0.6, relief_pitch_mm: 1.1, relief_depth_mm: 0.03, ..cable("braided-cable", 3.2) },
    Object { mu_static: 0.45, mu_kinetic: 0.38, roughness_um: 0.6, ring_hz: 2100.0, ..flat("usb-a-plug", Kind::Connector, 12.0, 26.0) },
    Object { mu_static: 0.5, mu_kinetic: 0.42, roughness_um: 0.9, texture_mm: &[1.02], texture_share: 0.5, relief_pitch_mm: 1.02, relief_depth_mm: 0.05, ..flat("rj45-plug", Kind::Connector, 11.0, 24.0) },
    Object { mu_static: 0.5, mu_kinetic: 0.4, roughness_um: 1.8, texture_mm: &[0.8, 0.4], texture_share: 0.6, relief_pitch_mm: 0.8, relief_depth_mm: 0.04, ring_hz: 1700.0, ..round("knurled-jack", Kind::Connector, 5.0, 28.0) },
    Object { held_out: true, mu_static: 0.55, mu_kinetic: 0.45, roughness_um: 1.4, texture_mm: &[2.5, 0.5], texture_share: 0.4, relief_pitch_mm: 2.5, relief_depth_mm: 0.08, ..flat("dsub-hood", Kind::Connector, 15.0, 30.0) },
    Object { mu_static: 1.0, mu_kinetic: 0.85, roughness_um: 1.0, stick_slip: 0.9, layer_kpa_per_mm: 2.5e3, ..flat("shore-60-block", Kind::Material, 12.0, 40.0) },
    Object { held_out: true, mu_static: 0.85, mu_kinetic: 0.7, roughness_um: 1.3, stick_slip: 0.7, layer_kpa_per_mm: 1e4, ..flat("shore-81-block", Kind::Material, 12.0, 40.0) },
    Object { held_out: true, mu_static: 0.75, mu_kinetic: 0.62, roughness_um: 1.1, stick_slip: 0.6, layer_kpa_per_mm: 2e4, ..flat("shore-88-block", Kind::Material, 12.0, 40.0) },
    Object { mu_static: 0.45, mu_kinetic: 0.4, roughness_um: 3.0, texture_mm: &[0.15], texture_share: 0.2, stick_slip: 0.1, ..flat("paper-card", Kind::Material, 18.0, 60.0) },
    Object { mu_static: 0.3, mu_kinetic: 0.25, roughness_um: 0.7, stick_slip: 0.05, ..flat("ptfe-strip", Kind::Material, 10.0, 60.0) },
    Object { mu_static: 0.55, mu_kinetic: 0.45, roughness_um: 5.0, texture_mm: &[2.2, 0.6, 0.09], texture_share: 0.4, ..flat("spruce-strip", Kind::Material, 8.0, 60.0) },
    Object { mu_static: 0.6, mu_kinetic: 0.5, roughness_um: 1.6, texture_mm: &[3.0], texture_share: 0.2, ring_hz: 900.0, ..round("screwdriver-handle", Kind::Tool, 9.0, 60.0) },
    Object { mu_static: 0.4, mu_kinetic: 0.33, roughness_um: 0.5, ring_hz: 2600.0, ..round("hex-key", Kind::Tool, 2.5, 60.0) },
    Object { mu_static: 0.6, mu_kinetic: 0.5, roughness_um: 0.4, stick_slip: 0.5, shape: Shape::Sphere { radius_mm: 11.0 }, kind: Kind::Tool, name: "ball-knob", ..PLAIN },
    Object { held_out: true, mu_static: 0.45, mu_kinetic: 0.36, roughness_um: 2.2, texture_mm: &[1.25, 0.42], texture_share: 0.7, relief_pitch_mm: 1.25, relief_depth_mm: 0.06, ring_hz: 1500.0, ..round("threaded-rod", Kind::Tool, 4.0, 80.0) },
];

/// The object of this name.
pub fn named(name: &str) -> Option<&'static Object> {
    CATALOGUE.iter().find(|o| o.name == name)
}

/// The training group (`false`) or the held-out group (`true`), in the order of the catalogue.
pub fn group(held_out: bool) -> impl Iterator<Item = &'static Object> {
    CATALOGUE.iter().filter(move |o| o.held_out == held_out)
}
