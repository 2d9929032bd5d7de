//! Logistic regression by Newton's method (iteratively reweighted least squares).

use anyhow::{Context, Result, bail};
use nalgebra::{DMatrix, DVector};

use crate::fitted::Odds;

/// Penalty on the squared weights, not on the intercept: ½ · this · Σw² beside the sum of the frames'
/// losses (scikit-learn's `C = 1`). Nothing beside thousands of frames, but it keeps the weights finite
/// where a feature separates the classes.
const PENALTY: f64 = 1.0;
/// Newton's method doubles the digits per step; from zero it takes about ten.
const STEPS_MAX: usize = 100;
/// Largest change of a weight at which it has converged.
const CONVERGED: f64 = 1e-9;

/// The log-odds of `true`. Features should be standardised.
pub(crate) fn logistic_regression<const N: usize>(features: &[[f64; N]], positive: &[bool]) -> Result<Odds> {
    let mut weights = DVector::zeros(N + 1);
    for _ in 0..STEPS_MAX {
        let mut gradient = DVector::zeros(N + 1);
        let mut hessian = DMatrix::zeros(N + 1, N + 1);
        for i in 0..N {
            gradient[i] = PENALTY * weights[i];
            hessian[(i, i)] = PENALTY;
        }
        for (x, &positive) in features.iter().zip(positive) {
            let at = |i: usize| if i < N { x[i] } else { 1.0 };
            let odds: f64 = (0..=N).map(|i| weights[i] * at(i)).sum();
            let p = 1.0 / (1.0 + (-odds).exp());
            let off = p - f64::from(u8::from(positive));
            for i in 0..=N {
                gradient[i] += off * at(i);
                for j in 0..=i {
                    hessian[(i, j)] += p * (1.0 - p) * at(i) * at(j);
                }
            }
        }
        // Cholesky reads the lower triangle only.
        let step = hessian.cholesky().context("logistic regression: singular")?.solve(&gradient);
        weights -= &step;
        if step.amax() < CONVERGED {
            return Ok(Odds { weights: weights.as_slice()[..N].to_vec(), intercept: weights[N] });
        }
    }
    bail!("logistic regression has not converged after {STEPS_MAX} steps")
}
