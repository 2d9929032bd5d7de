//! Kernels with a formula, against that formula in double precision.

use proptest::prelude::*;
use slipsense::fixed::{
    STANDARD_FRAC_BITS, query_key_i16, relu_i16, round_div, round_shift, saturate_i16, scale_q32, standardise,
};
use slipsense::net::softmax::softmax_base2;

proptest! {
    #[test]
    fn rounding_is_floor_of_x_plus_half(x in -(1i64 << 61)..(1i64 << 61), shift in 1u32..=62) {
        let (x, half) = (i128::from(x), 1i128 << (shift - 1));
        prop_assert_eq!(i128::from(round_shift(x as i64, shift)), (x + half).div_euclid(1 << shift));
    }

    #[test]
    fn scaling_is_exact_at_every_extreme(acc: i32, multiplier: i32) {
        for (acc, multiplier) in [(acc, multiplier), (i32::MIN, multiplier), (acc, i32::MAX), (i32::MIN, i32::MIN)] {
            let exact = (i128::from(acc) * i128::from(multiplier) + (1 << 31)).div_euclid(1 << 32);
            prop_assert_eq!(i128::from(scale_q32(acc, multiplier)), exact);
        }
    }

    #[test]
    fn division_rounds_ties_up(x in -(1i32 << 30)..(1 << 30), d in 1i32..1000) {
        let exact = (f64::from(x) / f64::from(d) + 0.5).floor();
        prop_assert_eq!(f64::from(round_div(x, d)), exact);
    }

    #[test]
    fn requantize_saturates(acc: i32, multiplier in 0i32..) {
        let x = scale_q32(acc, multiplier);
        prop_assert_eq!(i32::from(saturate_i16(x)), x.clamp(-32768, 32767));
        prop_assert_eq!(i32::from(relu_i16(x)), x.clamp(0, 32767));
        prop_assert_eq!(i32::from(query_key_i16(x)), x.clamp(-8191, 8191));
    }

    /// Formula, bound of the sum and error of the softmax, over spread-out and equal scores.
    #[test]
    fn softmax_is_a_softmax(scores in prop::collection::vec(-(1i32 << 14)..(1 << 14), 1..=64)) {
        let mut weights = scores.clone();
        softmax_base2(&mut weights);
        let max = *scores.iter().max().unwrap();
        let powers: Vec<f64> = scores.iter().map(|s| f64::from(s - max) / 1024.0).map(f64::exp2).collect();
        let sum: f64 = powers.iter().sum();
        for (&weight, power) in weights.iter().zip(&powers) {
            let exact = (power / sum * 32768.0).min(32767.0);
            // One unit for the rounded weight, one for powers cut off below 2^-15, sum of all of them.
            let allowed = 1.0 + 32768.0 * 2f64.powi(-15) * (1.0 + scores.len() as f64 * power / sum);
            prop_assert!((f64::from(weight) - exact).abs() <= allowed, "{weight} {exact}");
            prop_assert!((0..=32767).contains(&weight));
        }
        let total: i32 = weights.iter().sum();
        prop_assert!(total <= 32768 + scores.len() as i32 / 2);
    }

    #[test]
    fn softmax_survives_the_widest_scores(scores in prop::collection::vec(-(1i32 << 30)..(1 << 30), 1..=64)) {
        let mut weights = scores;
        softmax_base2(&mut weights);
        prop_assert!(weights.iter().all(|weight| (0..=32767).contains(weight)));
    }
}

#[test]
fn softmax_of_equal_scores_is_even() {
    for n in 1..=64 {
        let mut weights = vec![-7; n];
        softmax_base2(&mut weights);
        let even = |&weight: &i32| (f64::from(weight) - 32768.0 / n as f64).abs() <= 1.0;
        assert!(weights.iter().all(even), "{n}: {weights:?}");
    }
}

#[test]
fn standardise_follows_the_formula() {
    use rand::{Rng, SeedableRng};
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(11);
    for round in 0..2000 {
        let n = rng.random_range(2..=128);
        let width = 1i32 << rng.random_range(6..22);
        let x: Vec<i32> = (0..n).map(|_| rng.random_range(-width..width)).collect();
        let epsilon = [1u64, 100, 1_000_000][round % 3];
        let mean = x.iter().map(|&v| f64::from(v)).sum::<f64>() / n as f64;
        let variance = x.iter().map(|&v| (f64::from(v) - mean).powi(2)).sum::<f64>() / n as f64;
        let sigma = (variance + epsilon as f64).sqrt();
        let mut deviations = x.clone();
        let mut out = vec![0; n];
        standardise::<STANDARD_FRAC_BITS>(&mut deviations, epsilon, &mut out);
        for (&x, &y) in x.iter().zip(&out) {
            let exact = (f64::from(x) - mean) / sigma;
            let error = (f64::from(y) / 2048.0 - exact).abs();
            // Half a unit of the output, the rounded mean, and the relative errors of root and reciprocal.
            let relative = 1.0 / (256.0 * sigma) + 2f64.powi(-30);
            let allowed = 0.5 / 2048.0 + 0.5 / sigma + exact.abs() * relative + 1e-9;
            assert!(error <= allowed, "{error} > {allowed} for x {x}, sigma {sigma}");
        }
    }
}

#[test]
fn standardise_of_equal_values_is_zero() {
    for value in [0, -5, (1 << 22) - 1] {
        let mut out = [1i16; 16];
        standardise::<13>(&mut [value; 16], 1, &mut out);
        assert_eq!(out, [0; 16]);
    }
}
