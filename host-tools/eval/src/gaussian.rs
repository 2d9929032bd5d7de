//! Gaussian class densities for quadratic discriminants, and the scaling of features.

use anyhow::{Context, Result, ensure};
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

/// Share of the identity in a covariance of standardised features: enough to keep it invertible where
/// features are correlated, too little to change a decision (scikit-learn's `reg_param`).
pub(crate) const RIDGE: f64 = 1e-6;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gaussian {
    pub(crate) mean: Vec<f64>,
    /// Covariance, row by row, the ridge included.
    pub(crate) covariance: Vec<Vec<f64>>,
}

impl Gaussian {
    /// Mean, and (1 − [`RIDGE`]) times the covariance (over n) plus [`RIDGE`] times the
    /// identity. Needs at least two samples.
    pub(crate) fn fit<const N: usize>(samples: &[[f64; N]]) -> Result<Self> {
        ensure!(samples.len() >= 2, "{} samples of a class, at least 2 are needed", samples.len());
        let n = samples.len() as f64;
        let mut mean = [0.0; N];
        for sample in samples {
            mean.iter_mut().zip(sample).for_each(|(m, x)| *m += x / n);
        }
        let (mut sums, mut covariance) = ([[0.0; N]; N], vec![vec![0.0; N]; N]);
        for sample in samples {
            for i in 0..N {
                for j in 0..=i {
                    sums[i][j] += (sample[i] - mean[i]) * (sample[j] - mean[j]);
                }
            }
        }
        for (i, row) in sums.iter().enumerate() {
            for (j, sum) in row[..=i].iter().enumerate() {
                let ridge = if i == j { RIDGE } else { 0.0 };
                covariance[i][j] = (1.0 - RIDGE) * sum / n + ridge;
                covariance[j][i] = covariance[i][j];
            }
        }
        Ok(Self { mean: mean.to_vec(), covariance })
    }

    /// The density, ready to evaluate. Refuses what is not a covariance of this size.
    pub(crate) fn density<const N: usize>(&self) -> Result<Density<N>> {
        ensure!(self.mean.len() == N, "mean has {} entries, must have {N}", self.mean.len());
        let square = self.covariance.len() == N && self.covariance.iter().all(|row| row.len() == N);
        ensure!(square, "covariance must be {N} × {N}");
        let mut all = self.mean.iter().chain(self.covariance.iter().flatten());
        ensure!(all.all(|x| x.is_finite()), "mean and covariance must be finite");
        let matrix = DMatrix::from_fn(N, N, |i, j| self.covariance[i][j]);
        ensure!((&matrix - matrix.transpose()).amax() <= 1e-9 * matrix.amax(), "covariance not symmetric");
        let factor = matrix.cholesky().context("covariance must be positive definite")?.l();
        let whiten = factor.clone().try_inverse().context("covariance must be positive definite")?;
        Ok(Density {
            mean: DVector::from_column_slice(&self.mean).as_slice().try_into()?,
            whiten: std::array::from_fn(|i| std::array::from_fn(|j| whiten[(i, j)])),
            half_log_determinant: factor.diagonal().iter().map(|d| d.ln()).sum(),
        })
    }
}

#[derive(Clone, Debug)]
pub(crate) struct Density<const N: usize> {
    mean: [f64; N],
    /// Inverse of the covariance's Cholesky factor, lower triangle.
    whiten: [[f64; N]; N],
    half_log_determinant: f64,
}

impl<const N: usize> Density<N> {
    /// Natural log of the density at `x`, without the constant −N/2 · ln 2π.
    pub(crate) fn ln(&self, x: &[f64; N]) -> f64 {
        let off: [f64; N] = std::array::from_fn(|i| x[i] - self.mean[i]);
        let square = |(i, row): (usize, &[f64; N])| {
            let y: f64 = row[..=i].iter().zip(&off).map(|(w, d)| w * d).sum();
            y * y
        };
        -0.5 * self.whiten.iter().enumerate().map(square).sum::<f64>() - self.half_log_determinant
    }
}

/// Mean and standard deviation of each feature over the training frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scaling {
    pub(crate) mean: Vec<f64>,
    pub(crate) std: Vec<f64>,
}

impl Scaling {
    /// Mean and deviation; a feature that never changes gets a standard deviation of 1.
    pub(crate) fn fit<const N: usize>(samples: &[[f64; N]]) -> Self {
        let n = samples.len().max(1) as f64;
        let mut mean = [0.0; N];
        let mut variance = [0.0; N];
        for sample in samples {
            mean.iter_mut().zip(sample).for_each(|(m, x)| *m += x / n);
        }
        for sample in samples {
            for i in 0..N {
                variance[i] += (sample[i] - mean[i]).powi(2) / n;
            }
        }
        let std = variance.map(|v| if v > 0.0 { v.sqrt() } else { 1.0 });
        Self { mean: mean.to_vec(), std: std.to_vec() }
    }

    pub(crate) fn apply<const N: usize>(&self, sample: &[f64; N]) -> [f64; N] {
        std::array::from_fn(|i| (sample[i] - self.mean[i]) / self.std[i])
    }

    pub(crate) fn validate(&self, features: usize) -> Result<()> {
        ensure!(self.mean.len() == features && self.std.len() == features, "must hold {features} features");
        ensure!(self.mean.iter().all(|m| m.is_finite()), "means must be finite");
        ensure!(self.std.iter().all(|s| s.is_finite() && *s > 0.0), "standard deviations must be above 0");
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_covariance_is_refused() {
        let of = |covariance| Gaussian { mean: vec![0.0; 2], covariance }.density::<2>();
        assert!(of(vec![vec![1.0, 2.0], vec![2.0, 1.0]]).is_err());
        assert!(of(vec![vec![1.0, 0.5], vec![0.0, 1.0]]).is_err());
        assert!(of(vec![vec![1.0]]).is_err());
        assert!(of(vec![vec![f64::NAN, 0.0], vec![0.0, 1.0]]).is_err());
        assert!(of(vec![vec![1.0, 0.0], vec![0.0, 1.0]]).is_ok());
        assert!(Gaussian::fit(&[[1.0]]).is_err());
    }

    #[test]
    fn a_feature_that_never_changes_has_a_deviation_of_1() {
        let scaling = Scaling::fit(&[[1.0, 7.0], [5.0, 7.0]]);
        assert_eq!((scaling.mean, scaling.std), (vec![3.0, 7.0], vec![2.0, 1.0]));
    }
}
