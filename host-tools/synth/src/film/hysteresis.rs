//! Hysteresis: a film reads more while the load falls than while it rises.
//!
//! Play operators on the logarithm of pressure. A printed film's loop is a share of the excursion at
//! every scale: a grip of a newton and a load to full scale both show a few per cent. Operators on
//! pressure itself would be blind below their smallest radius; on `s = log₂(1 + p/p₀)` the same eight
//! radii serve all loads well above `p₀`, 1 kPa.
//!
//! Each play `y = max(s − w, 0, min(s, y))` is the classical one of radius `w/2` shifted by that radius, so
//! that a released film stands at zero. Its output beyond the rising branch `max(0, s − w)` is what
//! hysteresis adds: rising load reads the pressure itself, falling load reads `p · (1 + k·Σ excess)`.
//! Loops nest and close, as those of any sum of plays (Prandtl–Ishlinskii).

use super::curve::Curve;

pub const PLAYS: usize = 8;
/// Widths of the plays: 1 to 8 times this many octaves of pressure. Half of the load is one octave below
/// its peak, where the narrower half of the plays has let go; the wider ones serve full scale, where the
/// law from codes to counts flattens the loop's upper part.
pub const WIDTH_OCTAVES: f64 = 0.28;
/// Pressure below which the film knows no hysteresis, kPa.
pub const FLOOR_KPA: f64 = 1.0;
/// Weight of each play per unit of loop: makes [`Hysteresis::new`]'s argument the largest difference
/// between falling and rising output as share of the output's excursion, within a seventh from 10 kPa to
/// full scale.
const WEIGHT_PER_LOOP: f64 = 0.35;

pub struct Hysteresis {
    weight: f64,
    octaves: Curve,
}

impl Hysteresis {
    /// Hysteresis whose loop is `share` of the excursion at its widest.
    pub fn new(share: f64) -> Self {
        Self { weight: WEIGHT_PER_LOOP * share, octaves: Curve::tabulate(|x| libm::log2(x).max(0.0)) }
    }

    /// One step of the plays to `kpa`; returns the pressure that the film shows, kPa.
    #[inline]
    pub fn step(&self, plays: &mut [f64; PLAYS], kpa: f64) -> f64 {
        if kpa <= 0.0 {
            plays.fill(0.0);
            return 0.0;
        }
        let s = self.octaves.at(1.0 + kpa / FLOOR_KPA);
        let larger = |a: f64, b: f64| if a > b { a } else { b };
        let mut excess = 0.0;
        for (i, y) in plays.iter_mut().enumerate() {
            let rising = larger(s - (i + 1) as f64 * WIDTH_OCTAVES, 0.0);
            *y = larger(if *y < s { *y } else { s }, rising);
            excess += *y - rising;
        }
        kpa * (1.0 + self.weight * excess)
    }
}
