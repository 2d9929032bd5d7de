//! Variations of the catalogue's objects: two dozen objects are too few for a network to learn what all have in common.

use libm::{exp, log};

use super::{Object, Shape, Surface};
use crate::draw::{Draw, Stream, stream};

/// Standard deviation of the logarithm of lengths, widths and radii.
const SIZES: f64 = 0.15;
/// The same of static friction, modulus, depth, relief and mode.
const MATERIAL: f64 = 0.2;
/// The same of roughness, wavelengths, damping and mass.
const WIDE: f64 = 0.5;
/// Standard deviation of the shares of texture and stick-slip.
const SHARES: f64 = 0.2;
/// Standard deviation of a rubber's hardness, Shore A.
const SHORE_A: f64 = 3.0;

impl Object {
    /// An object like this one, `NAME-varied-SEED`, with size, surface, friction, mode and mass of its own, from a seed; its relief's form
    /// and its kind stay. Itself where [`Object::check`] refuses what was drawn.
    pub(crate) fn varied(&self, seed: u64) -> Self {
        let mut rng = stream(seed, Stream::Object, 0);
        // Deviations end at 2.5 times the standard deviation.
        let mut times = |spread: f64| exp(spread * rng.normal().clamp(-2.5, 2.5));
        let mut object = Self { name: format!("{}-varied-{seed}", self.name), ..self.clone() };
        match &mut object.shape {
            Shape::Sphere { radius_mm } => *radius_mm *= times(SIZES),
            Shape::Cylinder { radius_mm: across_mm, length_mm }
            | Shape::Flat { width_mm: across_mm, length_mm, .. } => {
                *across_mm *= times(SIZES);
                *length_mm *= times(SIZES);
            }
        }
        match &mut object.surface {
            Surface::Hard => {}
            Surface::Elastic { modulus_mpa, depth_mm } => {
                *modulus_mpa *= times(MATERIAL);
                *depth_mm *= times(MATERIAL);
            }
            Surface::Rubber { shore_a, depth_mm } => {
                *shore_a += SHORE_A * log(times(1.0));
                *depth_mm *= times(MATERIAL);
            }
        }
        if let Some(relief) = &mut object.relief {
            relief.pitch_mm *= times(MATERIAL);
            relief.depth_mm *= times(MATERIAL);
        }
        object.mu_static = (object.mu_static * times(MATERIAL)).clamp(0.15, 1.2);
        object.roughness_um = (object.roughness_um * times(WIDE)).clamp(0.2, 10.0);
        for wavelength in &mut object.texture_mm {
            *wavelength = (*wavelength * times(WIDE)).clamp(0.05, 2.0);
        }
        object.ring_hz *= times(MATERIAL);
        object.damping = (object.damping * times(WIDE)).clamp(0.003, 0.4);
        object.mass_g *= times(WIDE);
        object.mu_kinetic = object.mu_static * rng.between(0.75, 0.95);
        if object.texture_mm.is_empty() && rng.chance(0.5) {
            object.texture_mm.push(rng.log_between(0.05, 2.0));
        }
        if !object.texture_mm.is_empty() {
            object.texture_share = (object.texture_share + SHARES * rng.normal()).clamp(0.0, 0.8);
        }
        object.stick_slip = (object.stick_slip + SHARES * rng.normal()).clamp(0.0, 1.0);
        if object.check().is_ok() { object } else { self.clone() }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{CATALOGUE, Group, of_group};

    #[test]
    fn varied_objects_are_possible_differ_and_keep_what_is_held_out() {
        for object in CATALOGUE.iter() {
            let varied: Vec<_> = (0..40).map(|seed| object.varied(seed)).collect();
            assert_eq!(varied[7], object.varied(7), "the same from the same seed");
            for new in &varied {
                new.check().unwrap();
                let form = |o: &super::Object| o.relief.map(|relief| relief.form);
                assert_eq!((new.kind, new.group, form(new)), (object.kind, object.group, form(object)));
            }
            let differ = varied.iter().filter(|new| new.name != object.name).count();
            // The largest is nearly as wide as the pad: half of its sizes are refused.
            assert!(differ >= 12, "{}: {differ} of 40 were possible", object.name);
        }
    }

    /// Training meets rougher surfaces than the catalogue's, but no rubber of the held-out group.
    #[test]
    fn variation_reaches_beyond_the_training_objects() {
        let varied: Vec<_> =
            of_group(Group::Train).flat_map(|o| (0..40).map(|seed| o.varied(seed))).collect();
        let roughest = varied.iter().map(|o| o.roughness_um).fold(0.0, f64::max);
        let known = of_group(Group::Train).map(|o| o.roughness_um).fold(0.0, f64::max);
        assert!(roughest > 1.5 * known, "{roughest} µm, catalogue {known} µm");
        for object in varied {
            if let super::Surface::Rubber { shore_a, .. } = object.surface {
                assert!(shore_a < 78.0, "{}: {shore_a} HA", object.name);
            }
        }
    }
}
