//! MFCC and quadratic discriminants against librosa and scikit-learn: `tests/python/check_baselines.py`
//! made the numbers and checks them.

use serde::Deserialize;

use crate::fit::logistic_regression::logistic_regression;
use crate::gaussian::Gaussian;
use crate::spectrum::XlSpectrum;

#[derive(Deserialize)]
struct Vectors {
    origin: Origin,
    samples: Vec<[i16; 3]>,
    ends: Vec<usize>,
    mfcc: Vec<[f64; 13]>,
    points: Vec<[f64; 3]>,
    log_ratio: Vec<f64>,
    weights: [f64; 3],
    intercept: [f64; 1],
}

#[derive(Deserialize)]
struct Origin {
    lsb_g: f64,
}

fn vectors() -> Vectors {
    serde_json::from_str(include_str!("../../tests/vectors/baselines.json")).unwrap()
}

/// Largest distance; the vectors have nine decimals.
fn compare(what: &str, pairs: impl Iterator<Item = (f64, f64)>, allowed: f64) {
    let off: Vec<f64> = pairs.map(|(found, expected)| (found - expected).abs()).collect();
    let largest = off.iter().copied().fold(0.0, f64::max);
    println!("{what}: {} numbers, off by {largest:.1e} at most (allowed {allowed:.0e})", off.len());
    assert!(!off.is_empty() && largest <= allowed, "{what}");
}

#[test]
fn mfcc_as_librosa_has_them() {
    let vectors = vectors();
    let mut spectrum = XlSpectrum::default();
    let mut start = 0;
    let mut found = Vec::new();
    for &end in &vectors.ends {
        spectrum.push(&vectors.samples[start..end], vectors.origin.lsb_g);
        start = end;
        found.extend(spectrum.mfcc());
    }
    compare("MFCC", found.into_iter().zip(vectors.mfcc.into_iter().flatten()), 1e-6);
}

#[test]
fn log_ratios_as_scikit_learn_has_them() {
    let vectors = vectors();
    let (first, second) = vectors.points.split_at(vectors.points.len() / 2);
    let density = |points| Gaussian::fit::<3>(points).unwrap().density::<3>().unwrap();
    let (first, second) = (density(first), density(second));
    let found = vectors.points.iter().map(|x| second.ln(x) - first.ln(x));
    compare("QDA, log-likelihood ratio", found.zip(vectors.log_ratio.iter().copied()), 1e-7);
}

#[test]
fn logistic_regression_as_scikit_learn_has_it() {
    let vectors = vectors();
    let positive: Vec<bool> = (0..vectors.points.len()).map(|i| i >= vectors.points.len() / 2).collect();
    let odds = logistic_regression(&vectors.points, &positive).unwrap();
    let found = odds.weights.into_iter().chain([odds.intercept]);
    compare("logistic regression", found.zip(vectors.weights.into_iter().chain(vectors.intercept)), 1e-7);
}
