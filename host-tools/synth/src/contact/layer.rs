//! The elastic layer of a fingertip.

use serde::Serialize;

use crate::draw::{Draw, Rng};
use crate::recipe::Region;

/// Softest and stiffest foundation, kPa/mm (1–10 · 10⁹ N/m³).
const STIFFNESS: (f64, f64) = (1e3, 1e4);
/// Half width of the patch that the correction for a finite patch is worked out for.
const PATCH_MM: f64 = 2.0;

/// Elastic layer bonded to a stiff backing.
#[derive(Clone, Debug, Serialize)]
pub struct Layer {
    /// Young's modulus E, 1–5 MPa.
    pub modulus_mpa: f64,
    /// Thickness h, 0.5–1.5 mm.
    pub thickness_mm: f64,
    /// Poisson's ratio of a filled elastomer, 0.45–0.48.
    pub poisson: f64,
    /// Sigma of the Gaussian that spreads the pressure, over h: 0.4–0.8.
    pub spread_over_thickness: f64,
    /// Factor on the stiffness: 1 in the middle, more towards the palm, where the skin runs out over the edge of the
    /// backing and is held from the side. A modelling choice, no finger has been measured.
    pub local_stiffening: f64,
}

impl Layer {
    /// Draw layers until the stiffness in the middle of the pad is within 1–10 · 10⁹ N/m³.
    pub(crate) fn draw(rng: &mut Rng, region: Region) -> Self {
        let mut layer = loop {
            let layer = Self {
                modulus_mpa: rng.log_between(1.0, 5.0),
                thickness_mm: rng.between(0.5, 1.5),
                poisson: rng.between(0.45, 0.48),
                spread_over_thickness: rng.between(0.4, 0.8),
                local_stiffening: 1.0,
            };
            if (STIFFNESS.0..=STIFFNESS.1).contains(&layer.stiffness_kpa_per_mm()) {
                break layer;
            }
        };
        let stiffening = rng.between(1.4, 2.0);
        if region == Region::Palm {
            layer.local_stiffening = stiffening;
        }
        layer
    }

    /// Stiffness per area K, kPa/mm (10⁶ N/m³): modulus over thickness. The modulus is the confined one,
    /// E(1−ν)/((1+ν)(1−2ν)), for a patch much wider than the layer is thick. Under a finite patch the
    /// nearly incompressible layer also escapes sideways, against the shear of its bond: E(1+2S²) with
    /// the shape factor S = half width / 2h (Gent and Lindley 1959). The two give way in series, as those
    /// authors add the bulk modulus; without this, K would run to infinity as ν nears one half.
    pub fn stiffness_kpa_per_mm(&self) -> f64 {
        let (e, nu) = (1e3 * self.modulus_mpa, self.poisson);
        let confined = e * (1.0 - nu) / ((1.0 + nu) * (1.0 - 2.0 * nu));
        let shape = PATCH_MM / (2.0 * self.thickness_mm);
        let bonded = e * (1.0 + 2.0 * shape * shape);
        self.local_stiffening / (1.0 / confined + 1.0 / bonded) / self.thickness_mm
    }

    pub fn spread_mm(&self) -> f64 {
        self.spread_over_thickness * self.thickness_mm
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::{median, within};
    use crate::draw::{Stream, stream};

    #[test]
    fn layers_stay_in_their_ranges_and_the_palm_is_stiffer() {
        let mut rng = stream(3, Stream::Contact, 0);
        let mut drawn = |region| -> Vec<f64> {
            let stiffness = |_| {
                let layer = Layer::draw(&mut rng, region);
                assert!((0.999..5.001).contains(&layer.modulus_mpa));
                assert!((0.499..1.501).contains(&layer.thickness_mm));
                layer.stiffness_kpa_per_mm()
            };
            (0..2000).map(stiffness).collect()
        };
        let (centre, palm) = (drawn(Region::Centre), drawn(Region::Palm));
        assert!(centre.iter().all(|k| (999.0..=10_001.0).contains(k)));
        within("palm's median over the centre's", median(palm) / median(centre), 1.4..);
    }
}
