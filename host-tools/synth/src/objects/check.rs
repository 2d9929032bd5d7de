//! What an object must be for a fingertip to grip it.

use slipsense::params::{COL_PITCH_MM, ROW_PITCH_MM, TAXEL_COLS, TAXEL_ROWS};

use super::{Object, Shape, Surface};

/// The pad across the fingers: columns times their pitch, 22.4 mm.
pub const PAD_WIDTH_MM: f64 = COL_PITCH_MM as f64 * TAXEL_COLS as f64;
/// The pad along the finger: rows times their pitch, 29.44 mm.
pub const PAD_LENGTH_MM: f64 = ROW_PITCH_MM as f64 * TAXEL_ROWS as f64;

/// Physics that cannot be.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("object \"{object}\": {field} is {value}, must be {rule}")]
pub struct ObjectError {
    /// Name of the object.
    pub object: String,
    /// Field at fault.
    pub field: &'static str,
    /// What it holds.
    pub value: f64,
    /// What it must be.
    pub rule: &'static str,
}

const POSITIVE: &str = "a finite number above 0";
const NOT_NEGATIVE: &str = "a finite number, 0 or above";
const SHARE: &str = "0 to 1";

impl Object {
    /// Refuse what cannot be: sizes, friction, roughness and wavelengths that are negative or not numbers,
    /// kinetic friction above static, and a face wider across its axis than the pad. A face may be longer
    /// than the pad (a cable runs over both ends, and slides along itself), but what overhangs on both
    /// sides is borne by nothing that the model has.
    pub fn check(&self) -> Result<(), ObjectError> {
        let rule = |field: &'static str, value: f64, holds: bool, rule: &'static str| {
            let error = || ObjectError { object: self.name.clone(), field, value, rule };
            if holds { Ok(()) } else { Err(error()) }
        };
        let positive = |field, value: f64| rule(field, value, value > 0.0 && value.is_finite(), POSITIVE);
        let not_negative =
            |field, value: f64| rule(field, value, value >= 0.0 && value.is_finite(), NOT_NEGATIVE);
        let share = |field, value: f64| rule(field, value, (0.0..=1.0).contains(&value), SHARE);

        match self.shape {
            Shape::Cylinder { radius_mm, length_mm } => {
                positive("shape.radius_mm", radius_mm)?;
                positive("shape.length_mm", length_mm)?;
            }
            Shape::Sphere { radius_mm } => positive("shape.radius_mm", radius_mm)?,
            Shape::Flat { width_mm, length_mm, edge_mm } => {
                positive("shape.width_mm", width_mm)?;
                positive("shape.length_mm", length_mm)?;
                positive("shape.edge_mm", edge_mm)?;
                let fits = 2.0 * edge_mm <= width_mm.min(length_mm);
                rule("shape.edge_mm", edge_mm, fits, "at most half the width and half the length")?;
            }
        }
        let across = self.shape.extent_mm()[0];
        rule("shape (width across its axis)", across, across <= PAD_WIDTH_MM, "at most the pad's 22.4 mm")?;
        match self.surface {
            Surface::Hard => {}
            Surface::Elastic { modulus_mpa, depth_mm } => {
                positive("surface.modulus_mpa", modulus_mpa)?;
                positive("surface.depth_mm", depth_mm)?;
            }
            Surface::Rubber { shore_a, depth_mm } => {
                let known = (10.0..=98.0).contains(&shore_a);
                rule("surface.shore_a", shore_a, known, "10 to 98, where Gent's formula holds")?;
                positive("surface.depth_mm", depth_mm)?;
            }
        }
        if let Some(relief) = self.relief {
            positive("relief.pitch_mm", relief.pitch_mm)?;
            not_negative("relief.depth_mm", relief.depth_mm)?;
        }
        positive("mu_static", self.mu_static)?;
        positive("mu_kinetic", self.mu_kinetic)?;
        let slower = self.mu_kinetic <= self.mu_static;
        rule("mu_kinetic", self.mu_kinetic, slower, "at most mu_static")?;
        positive("roughness_um", self.roughness_um)?;
        for &wavelength in &self.texture_mm {
            let heard = (0.05..=2.0).contains(&wavelength);
            rule("texture_mm", wavelength, heard, "0.05 to 2")?;
        }
        share("texture_share", self.texture_share)?;
        share("stick_slip", self.stick_slip)?;
        not_negative("ring_hz", self.ring_hz)?;
        share("damping", self.damping)?;
        positive("mass_g", self.mass_g)
    }
}
