//! The law between codes and counts, over all of both.

use proptest::prelude::*;
use slipsense::params::COUNT_MAX;
use slipsense::transfer::{
    ASYMPTOTE, CODES_MAX, FULL_SCALE_CODES, HALF_CODE, IDLE_CODE, adc_code, code, count,
};

#[test]
fn no_count_is_left_out_and_each_has_its_fewest_codes() {
    assert_eq!((count(0), count(FULL_SCALE_CODES), count(CODES_MAX)), (0, COUNT_MAX, COUNT_MAX));
    let mut before = 0;
    for codes in 1..=CODES_MAX {
        let now = count(codes);
        assert!(now == before || now == before + 1, "{codes} codes: {before}, then {now}");
        if now > before {
            assert_eq!(u32::from(code(now)), codes, "the first of count {now}");
        }
        before = now;
    }
    assert_eq!(before, COUNT_MAX);
    assert_eq!((code(0), code(u16::MAX)), (0, code(COUNT_MAX)));
    assert!((0..=COUNT_MAX).all(|n| count(u32::from(adc_code(n) - IDLE_CODE)) == n));
}

proptest! {
    #[test]
    fn rounding_is_that_of_the_real_law(codes in 0..=CODES_MAX) {
        let exact = f64::from(ASYMPTOTE) * f64::from(codes) / f64::from(codes + HALF_CODE);
        prop_assert_eq!(count(codes), (exact + 0.5).floor().min(f64::from(COUNT_MAX)) as u16);
    }
}
