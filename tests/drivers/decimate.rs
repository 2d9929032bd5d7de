//! The decimation filter: its response as its documentation states it, and its arithmetic against the definition.

use std::f64::consts::PI;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slipsense::drivers::decimate::{DELAY_SAMPLES, Decimator, TAPS};
use slipsense::sensor::XlSample;

const RATE_HZ: f64 = 16_000.0;

/// What an impulse of this height gives at each place of the filter, the latest first.
fn impulses(height: i16) -> Vec<i16> {
    let impulse = |back: usize| {
        let mut filter = Decimator::primed([0; 3]);
        let mut output = 0;
        for n in 0..TAPS {
            let sample = if n + back + 1 == TAPS { [height, 0, 0] } else { [0; 3] };
            output = filter.push(sample, true).expect("kept")[0];
        }
        output
    };
    (0..TAPS).map(impulse).collect()
}

fn gain_db(taps: &[f64], hz: f64) -> f64 {
    let angle = |n: usize| 2.0 * PI * hz / RATE_HZ * (n as f64 - DELAY_SAMPLES as f64);
    let gain: f64 = taps.iter().enumerate().map(|(n, tap)| tap * angle(n).cos()).sum();
    20.0 * gain.abs().max(1e-9).log10()
}

#[test]
fn the_response_is_what_its_documentation_says() {
    // Read out of the filter by impulses: 2^14 gives each to half a unit.
    let taps: Vec<f64> =
        impulses(1 << 14).into_iter().map(|tap| f64::from(tap) / f64::from(1 << 14)).collect();
    assert!(taps.iter().eq(taps.iter().rev()), "linear phase");
    let over = |from: f64, to: f64| (0..=2_000).map(move |i| from + (to - from) * f64::from(i) / 2_000.0);
    let worst = |range: &mut dyn Iterator<Item = f64>| range.fold(f64::MIN, f64::max);
    let ripple = worst(&mut over(0.0, 3_300.0).map(|hz| gain_db(&taps, hz).abs()));
    let stop = worst(&mut over(4_700.0, 8_000.0).map(|hz| gain_db(&taps, hz)));
    let half = gain_db(&taps, 4_000.0);
    assert!(ripple < 0.012 && ripple > 0.005, "{ripple}");
    assert!((half + 6.02).abs() < 0.02, "{half}");
    assert!(stop < -59.0 && stop > -62.0, "{stop}");
}

/// The definition, in 64 bits, with the coefficients rounded to Q15.
fn direct(input: &[XlSample], at: usize, axis: usize, taps_q15: &[i64]) -> i16 {
    let product = |(n, tap): (usize, &i64)| tap * i64::from(input[at.saturating_sub(n)][axis]);
    let sum: i64 = taps_q15.iter().enumerate().map(product).sum();
    (sum + (1 << 14)).div_euclid(1 << 15).clamp(-32_768, 32_767) as i16
}

#[test]
fn streaming_is_the_definition_for_any_cuts_and_for_extreme_input() {
    // Exact: twice what an impulse of 2^14 gives is a coefficient to one unit, and all coefficients are even there or
    // read by an impulse of −2^15, which is the coefficient itself.
    let taps_q15: Vec<i64> = impulses(i16::MIN).into_iter().map(|output| -i64::from(output)).collect();
    assert_eq!(taps_q15.iter().sum::<i64>(), 1 << 15, "gravity passes unchanged");
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for kind in 0..4 {
        let mut value = |n: usize| match kind {
            0 => rng.random(),
            1 => [i16::MIN, i16::MAX][rng.random_range(0..2)],
            // The signs of the coefficients: the largest sum there is.
            2 => [i16::MAX, i16::MIN][usize::from(taps_q15[n % TAPS] < 0)],
            _ => rng.random_range(-100..100),
        };
        let input: Vec<XlSample> = (0..600).map(|n| std::array::from_fn(|_| value(n))).collect();
        let mut filter = Decimator::primed(input[0]);
        for (n, &sample) in input.iter().enumerate() {
            let keep = n % 2 == 1;
            let expected = keep.then(|| std::array::from_fn(|axis| direct(&input, n, axis, &taps_q15)));
            assert_eq!(filter.push(sample, keep), expected, "kind {kind}, sample {n}");
        }
    }
}
