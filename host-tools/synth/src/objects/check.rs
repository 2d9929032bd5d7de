//! What an object must be for a fingertip to grip it.

use slipsense::params::{COL_PITCH_MM, ROW_PITCH_MM, TAXEL_COLS, TAXEL_ROWS};

use super::{Object, Relief, Shape, Surface};

/// The pad across the fingers: columns times their pitch, 22.4 mm.
pub const PAD_WIDTH_MM: f64 = COL_PITCH_MM as f64 * TAXEL_COLS as f64;
/// The pad along the finger: rows times their pitch, 29.44 mm.
pub const PAD_LENGTH_MM: f64 = ROW_PITCH_MM as f64 * TAXEL_ROWS as f64;

impl Object {
    /// Refuse what cannot be: sizes, friction, roughness and wavelengths that are negative or not numbers,
    /// kinetic friction above static, and a face wider across its axis than the pad. A face may be longer
    /// than the pad (a cable runs over both ends), but what overhangs on both sides is borne by nothing that
    /// the model has.
    ///
    /// Refuse as well what the model has no answer to: a face that fits between two taxels (0.7 × 0.92 mm) is
    /// not felt, and what is too sticky or too soft follows the whole pull without slipping, though the encoder's
    /// rule would label slip.
    pub fn check(&self) -> Result<(), String> {
        let rule = |field: &str, value: f64, holds: bool, rule: &str| match holds {
            true => Ok(()),
            false => Err(format!("object \"{}\": {field} is {value}, must be {rule}", self.name)),
        };
        let positive = |field, x: f64| rule(field, x, x > 0.0 && x.is_finite(), "a finite number above 0");
        let share = |field, x: f64| rule(field, x, (0.0..=1.0).contains(&x), "0 to 1");
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
        let [across, along] = self.shape.extent_mm();
        rule("shape (width across its axis)", across, across <= PAD_WIDTH_MM, "at most the pad's 22.4 mm")?;
        let smallest = across.min(along);
        rule("shape (smallest width)", smallest, smallest >= 1.0, "at least 1 mm, about a taxel")?;
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
        let stiffness = self.surface.normal_kpa_per_mm();
        rule("surface (modulus over depth, kPa/mm)", stiffness, stiffness >= 100.0, "at least 100")?;
        if let Some(Relief { pitch_mm, depth_mm, .. }) = self.relief {
            rule("relief.pitch_mm", pitch_mm, pitch_mm >= 0.1, "at least 0.1")?;
            let reached = (0.0..=2.5).contains(&depth_mm);
            rule("relief.depth_mm", depth_mm, reached, "0 to 2.5, as deep as a finger reaches")?;
        }
        let (mu_static, mu_kinetic) = (self.mu_static, self.mu_kinetic);
        positive("mu_static", mu_static)?;
        rule("mu_static", mu_static, mu_static <= 3.0, "at most 3")?;
        positive("mu_kinetic", mu_kinetic)?;
        rule("mu_kinetic", mu_kinetic, mu_kinetic <= mu_static, "at most mu_static")?;
        positive("roughness_um", self.roughness_um)?;
        rule("roughness_um", self.roughness_um, self.roughness_um <= 100.0, "at most 100")?;
        for &wavelength in &self.texture_mm {
            rule("texture_mm", wavelength, (0.05..=2.0).contains(&wavelength), "0.05 to 2")?;
        }
        share("texture_share", self.texture_share)?;
        share("stick_slip", self.stick_slip)?;
        let hz = self.ring_hz;
        rule("ring_hz", hz, hz >= 0.0 && hz.is_finite(), "a finite number, 0 or above")?;
        share("damping", self.damping)?;
        positive("mass_g", self.mass_g)
    }
}
