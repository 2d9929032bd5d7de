//! Steps of the front end, bit for bit, against the plain formula that each one stands for.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slipsense::features::floor::NoiseFloor;
use slipsense::features::highpass::{FILTERED_FRAC_BITS, HighPassState};
use slipsense::features::mel::mel_power;
use slipsense::features::tables::{HIGHPASS, MEL_RISING_Q24, MEL_SEGMENT_BINS};
use slipsense::fixed::mean;
use slipsense::params::{FFT_BINS, MEL_BINS};

#[test]
fn high_pass_is_the_formula_with_one_rounding_and_what_it_dropped() {
    // The whole coefficients, Q32, in 128-bit integers.
    let one = 1i128 << 32;
    let b0 = one + i128::from(HIGHPASS.difference_q32);
    let (a1, a2) = (-2 * one - i128::from(HIGHPASS.y1_q32), one - i128::from(HIGHPASS.y2_q32));
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for held in [1, 1, 7, 300] {
        let mut x = [rng.random::<i16>() as i128; 2];
        let (mut y, mut dropped) = ([0i128; 2], 0i128);
        let mut state = HighPassState::at_rest(x[0] as i16);
        for _ in 0..3000 / held {
            let level = [i16::MIN, i16::MAX, rng.random()][rng.random_range(0..3)];
            for _ in 0..held {
                let new = i128::from(level);
                let exact =
                    b0 * ((new - 2 * x[0] + x[1]) << FILTERED_FRAC_BITS) - a1 * y[0] - a2 * y[1] + dropped;
                let rounded = (exact + one / 2).div_euclid(one);
                dropped = exact - rounded * one;
                (x, y) = ([new, x[0]], [rounded, y[0]]);
                assert_eq!(i128::from(HIGHPASS.step(&mut state, level)), rounded);
            }
        }
    }
}

#[test]
fn the_mean_rounds_up_and_never_overflows() {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let mut number = || match rng.random_range(0..4) {
        0 => i32::MIN,
        1 => i32::MAX,
        2 => rng.random_range(-3..3),
        _ => rng.random(),
    };
    for _ in 0..10_000 {
        let (a, b) = (number(), number());
        assert_eq!(i64::from(mean(a, b)), (i64::from(a) + i64::from(b) + 1) >> 1, "{a} {b}");
    }
}

#[test]
fn mel_triangles_are_their_weights_and_three_quarters() {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    for shift in [0, 8, 20, 35] {
        let power: [u64; FFT_BINS] = core::array::from_fn(|_| rng.random_range(0..1u64 << 56) >> shift);
        let mut expected = [0u64; MEL_BINS];
        let (mut bin, mut below) = (1, 0);
        for (segment, &count) in MEL_SEGMENT_BINS.iter().enumerate() {
            let here = bin..bin + count as usize;
            let weighted: u128 =
                here.clone().map(|k| u128::from(power[k]) * u128::from(MEL_RISING_Q24[k - 1])).sum();
            let rising = ((weighted + (1 << 23)) >> 24) as u64;
            let falling = power[here].iter().sum::<u64>() - rising;
            if let Some(mel) = segment.checked_sub(1) {
                expected[mel] = (3 * (below + falling) + 2) / 4;
            }
            (bin, below) = (bin + count as usize, rising);
        }
        assert_eq!(mel_power(&power), expected);
    }
}

#[test]
fn the_floor_follows_slowly_upwards_and_fast_downwards() {
    let mut rng = ChaCha8Rng::seed_from_u64(13);
    let mut front = NoiseFloor::new();
    // `floor(x / 2^n + 1/2)`, the rounding rule.
    let rounded = |x: i64, shift: u32| (2 * x + (1 << shift)).div_euclid(2 << shift);
    let mut floor = [0i64; MEL_BINS];
    let mut since_gap = 0;
    for frame in 0..4_000 {
        if frame % 1_500 == 1_499 {
            front.restart();
            since_gap = 0;
        }
        since_gap += 1;
        let most = [34 << 16, 3 << 16, 200][frame / 100 % 3];
        let ln: [i32; MEL_BINS] = core::array::from_fn(|_| rng.random_range(0..most));
        if frame < 4 {
            floor = ln.map(i64::from);
        }
        let expected: [i64; MEL_BINS] = core::array::from_fn(|bin| {
            let above = i64::from(ln[bin]) - floor[bin];
            if since_gap > 4 {
                floor[bin] += rounded(above, if above > 0 { 9 } else { 5 });
            }
            rounded(above, 4).clamp(-32_768, 32_767) * i64::from(since_gap > 4)
        });
        assert_eq!(front.step(&ln).map(i64::from), expected, "frame {frame}");
        assert_eq!(front.floor().map(i64::from), floor, "frame {frame}");
    }
}
