//! A random surface: Gaussian values whose correlation fades with distance.

use libm::{cos, round};
use std::f64::consts::TAU;

use crate::draw::{Draw, Rng};

/// The surface repeats after this distance both ways: more than a patch is wide.
const PERIOD_MM: f64 = 16.0;
/// Points of the table along one side.
const SIDE: usize = 96;
const STEP_MM: f64 = PERIOD_MM / SIDE as f64;
const WAVES: usize = 24;

/// Values of zero mean and unit variance with correlation `exp(−½ (Δu²/ℓu² + Δv²/ℓv²))`.
pub(crate) struct Field(Vec<f32>);

impl Field {
    /// A surface of correlation lengths `[ℓu, ℓv]`: a sum of plane waves whose wave numbers are Gaussian
    /// with deviation 1/ℓ, rounded so that they fit the period.
    pub(crate) fn draw(rng: &mut Rng, correlation_mm: [f64; 2]) -> Self {
        let mut sum = [0.0f64; SIDE * SIDE];
        let amplitude = (2.0 / WAVES as f64).sqrt();
        let circle: [f64; SIDE] = std::array::from_fn(|i| amplitude * cos(TAU * i as f64 / SIDE as f64));
        for _ in 0..WAVES {
            let turns = correlation_mm.map(|length| {
                let number = round(rng.normal() * PERIOD_MM / (TAU * length));
                (number as i64).rem_euclid(SIDE as i64) as usize
            });
            let mut start = rng.count(0, SIDE - 1);
            for row in sum.chunks_exact_mut(SIDE) {
                let mut at = start;
                for value in row {
                    *value += circle[at];
                    at = (at + turns[0]) % SIDE;
                }
                start = (start + turns[1]) % SIDE;
            }
        }
        Self(sum.iter().map(|&v| v as f32).collect())
    }

    pub(crate) fn even() -> Self {
        Self(vec![0.0; SIDE * SIDE])
    }

    /// Value at a place, linear between the points of the table.
    pub(crate) fn at(&self, u_mm: f64, v_mm: f64) -> f64 {
        let split = |mm: f64| {
            // Many periods to the positive side, where cutting off the fraction is rounding down.
            let steps = mm / STEP_MM + (1024 * SIDE) as f64;
            let whole = steps as u32;
            let at = whole as usize % SIDE;
            (at, (at + 1) % SIDE, steps - f64::from(whole))
        };
        let ((u0, u1, fu), (v0, v1, fv)) = (split(u_mm), split(v_mm));
        let row = |v: usize| {
            let (near, far) = (f64::from(self.0[v * SIDE + u0]), f64::from(self.0[v * SIDE + u1]));
            near + fu * (far - near)
        };
        let (near, far) = (row(v0), row(v1));
        near + fv * (far - near)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::within;
    use crate::draw::{Stream, stream};

    #[test]
    fn variance_is_one_and_correlation_fades_as_asked() {
        let (mut power, mut near, mut far, mut count) = (0.0, 0.0, 0.0, 0.0);
        for seed in 0..60 {
            let field = Field::draw(&mut stream(seed, Stream::Contact, 0), [0.8, 2.0]);
            for i in 0..400 {
                let (u, v) = (f64::from(i % 20) * 0.8, f64::from(i / 20) * 0.8);
                let here = field.at(u, v);
                power += here * here;
                near += here * field.at(u + 0.8, v);
                far += here * field.at(u, v + 4.0);
                count += 1.0;
            }
        }
        let (variance, near, far) = (power / count, near / power, far / power);
        within("variance", variance, 0.9..1.1);
        within("correlation at ℓu off", near - libm::exp(-0.5), -0.08..0.08);
        within("correlation at 2 ℓv off", far - libm::exp(-2.0), -0.1..0.1);
    }
}
