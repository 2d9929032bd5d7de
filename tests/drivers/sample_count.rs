//! The count of samples over gaps.

use proptest::prelude::*;
use slipsense::drivers::SampleCount;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]

    #[test]
    fn a_gap_is_counted_by_the_measured_rate(
        per_mille in -30i64..=30, seconds in 2u64..20, gap_us in 0u64..60_000_000, tick_us in 3_000u64..6_000,
    ) {
        let rate_hz = 8_000.0 * (1.0 + per_mille as f64 / 1000.0);
        let made = |us: u64| (us as f64 * 1e-6 * rate_hz) as u64;
        let mut count = SampleCount::new(8_000);
        let mut now_us = 0;
        count.missed(now_us);
        let mut last = 0;
        while now_us < seconds * 1_000_000 {
            now_us += tick_us;
            count.read(now_us, (made(now_us) - last) as u32);
            last = made(now_us);
            // Exact while nothing is missing.
            prop_assert_eq!(count.total(), last);
        }
        prop_assert_eq!(count.lost(), 0);
        now_us += gap_us;
        count.missed(now_us);
        // One sample of phase, and 125 ppm of the gap for one sample in the second that measured the rate.
        let bound = 2 + made(gap_us) / 8_000 + 1;
        prop_assert!(count.total().abs_diff(made(now_us)) <= bound, "{} {}", count.total(), made(now_us));
        let before = count.total();
        count.resume(now_us + tick_us, 33, 0);
        prop_assert!(count.total() >= before, "never back");
        prop_assert!(count.total().abs_diff(made(now_us + tick_us)) <= bound + 1);
    }
}

/// 8,130 samples in 1,000,003 µs: 8129.976 Hz. Then 33 were made in 4.05 ms of a gap, and 20 of them read.
#[test]
fn the_rate_is_rounded_and_what_is_not_read_is_lost() {
    let mut count = SampleCount::new(8_000);
    count.missed(0);
    count.read(1_000_003, 8_130);
    assert_eq!(count.rate_mhz(), 8_129_976);
    count.resume(1_004_053, 20, 0);
    assert_eq!((count.total(), count.lost()), (8_163, 13));
}

#[test]
fn an_impossible_rate_is_not_believed() {
    let mut count = SampleCount::new(8_000);
    count.missed(0);
    for n in 1..1_000 {
        count.read(n * 4_000, 16);
    }
    assert_eq!(count.rate_mhz(), 8_000_000);
}

#[test]
fn extreme_times_do_not_panic() {
    let mut count = SampleCount::new(16_000);
    count.read(u64::MAX >> 8, 105);
    count.missed(0);
    count.missed(u64::MAX >> 8);
    count.resume(5, 0, 0);
    count.resume(6, 1, 2);
    count.read(4, u32::MAX);
}
