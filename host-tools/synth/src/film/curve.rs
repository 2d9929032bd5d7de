//! Functions of pressure, tabulated: a power or a logarithm per taxel and frame would be the costly part.

/// Octaves below and above 1 that the table covers.
const LOWEST: i64 = -14;
const HIGHEST: i64 = 16;
/// Knots per octave, as a power of two: linear pieces this short are within 2·10⁻⁵ of a power law.
const KNOT_BITS: u32 = 6;
/// Bits of a double's mantissa that lie below the knots.
const BELOW: u32 = 52 - KNOT_BITS;
/// First knot: exponent and leading mantissa bits of 2^[`LOWEST`].
const FIRST: u64 = ((1023 + LOWEST) as u64) << KNOT_BITS;
const KNOTS: usize = (((HIGHEST - LOWEST) as usize) << KNOT_BITS) + 1;

/// A function of a positive number: straight pieces between 64 knots per octave from 2⁻¹⁴ to 2¹⁶, 0
/// below, constant above. Exact to the bit on every platform, given that the knots are.
pub(crate) struct Curve(Vec<f64>);

impl Curve {
    pub(crate) fn tabulate(f: impl Fn(f64) -> f64) -> Self {
        Self((0..KNOTS as u64).map(|i| f(f64::from_bits((FIRST + i) << BELOW))).collect())
    }

    #[inline]
    pub(crate) fn at(&self, x: f64) -> f64 {
        let bits = x.to_bits();
        let Some(knot) = (bits >> BELOW).checked_sub(FIRST) else { return 0.0 };
        let knot = knot as usize;
        if knot + 1 >= KNOTS {
            return self.0[KNOTS - 1];
        }
        let part = (bits & ((1 << BELOW) - 1)) as f64 * (1.0 / (1u64 << BELOW) as f64);
        self.0[knot] + part * (self.0[knot + 1] - self.0[knot])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::{largest, within};

    #[test]
    fn a_power_is_met_between_the_knots_too() {
        let curve = Curve::tabulate(|x| libm::pow(x, 0.9));
        let off = |i: i32| {
            let x = 1e-4 * libm::pow(1.005, f64::from(i));
            (curve.at(x) / libm::pow(x, 0.9) - 1.0).abs()
        };
        within("tabulated power law off by", largest((1..4000).map(off)), ..2e-5);
        assert_eq!([0.0, 1e-6, 1e9].map(|x| curve.at(x)), [0.0, 0.0, curve.at(65_536.0)]);
    }
}
