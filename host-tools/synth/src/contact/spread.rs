//! A layer of finite thickness carries load into the neighbours of where it is pressed.

use libm::{ceil, exp};
use slipsense::params::{COL_PITCH_MM, ROW_PITCH_MM, TAXEL_COLS, TAXEL_ROWS, TAXELS};
use slipsense::sensor::active_cols;

use super::map::PressureMap;

/// Cells to each side that a spread reaches at most: 2.1 mm across.
const REACH: usize = 3;
/// Pressures below this share of the highest carry nothing that counts and are left out.
const NEGLIGIBLE: f64 = 1e-3;

pub(crate) struct Spread {
    across_rows: Kernel,
    across_cols: Kernel,
}

struct Kernel {
    /// Weight of the cell itself and of each neighbour, by distance.
    weights: [f64; REACH + 1],
    reach: usize,
}

impl Kernel {
    fn new(sigma_mm: f64, pitch_mm: f32) -> Self {
        let reach = (ceil(2.6 * sigma_mm / f64::from(pitch_mm)) as usize).min(REACH);
        let mut weights: [f64; REACH + 1] = std::array::from_fn(|i| {
            let z = i as f64 * f64::from(pitch_mm) / sigma_mm.max(1e-6);
            if i == 0 { 1.0 } else { exp(-0.5 * z * z) }
        });
        let sum = weights[0] + 2.0 * weights[1..=reach].iter().sum::<f64>();
        weights.iter_mut().for_each(|w| *w /= sum);
        Self { weights, reach }
    }

    /// Weighted sum around `at` of what lies inside `0..len`.
    fn sum(&self, at: usize, len: usize, value: impl Fn(usize) -> f64) -> f64 {
        let mut sum = self.weights[0] * value(at);
        for d in 1..=self.reach {
            if at >= d {
                sum += self.weights[d] * value(at - d);
            }
            if at + d < len {
                sum += self.weights[d] * value(at + d);
            }
        }
        sum
    }
}

impl Spread {
    pub(crate) fn new(sigma_mm: f64) -> Self {
        Self {
            across_rows: Kernel::new(sigma_mm, ROW_PITCH_MM),
            across_cols: Kernel::new(sigma_mm, COL_PITCH_MM),
        }
    }

    /// Spread `sharp`, which is 0 outside `rows` × `cols` (first and last), over the pad.
    pub(crate) fn over(
        &self,
        sharp: &[f64; TAXELS],
        rows: (usize, usize),
        cols: (usize, usize),
        out: &mut PressureMap,
    ) {
        let mut along = [0.0; TAXELS];
        let reach = self.across_cols.reach;
        let wide = cols.0.saturating_sub(reach)..=(cols.1 + reach).min(TAXEL_COLS - 1);
        for row in rows.0..=rows.1 {
            for col in wide.clone() {
                along[row * TAXEL_COLS + col] =
                    self.across_cols.sum(col, TAXEL_COLS, |c| sharp[row * TAXEL_COLS + c]);
            }
        }
        let reach = self.across_rows.reach;
        let mut highest = 0.0f64;
        for row in rows.0.saturating_sub(reach)..=(rows.1 + reach).min(TAXEL_ROWS - 1) {
            let active = active_cols(row);
            for col in active.start.max(*wide.start())..active.end.min(wide.end() + 1) {
                let p = self.across_rows.sum(row, TAXEL_ROWS, |r| along[r * TAXEL_COLS + col]);
                if p > 0.0 {
                    let cell = row * TAXEL_COLS + col;
                    highest = highest.max(p);
                    out.kpa[cell] = p;
                    out.loaded.push(cell);
                }
            }
        }
        let PressureMap { kpa, loaded, .. } = out;
        loaded.retain(|&cell| {
            let counts = kpa[cell] > NEGLIGIBLE * highest;
            if !counts {
                kpa[cell] = 0.0;
            }
            counts
        });
    }
}
