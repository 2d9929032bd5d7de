//! The flag against a naive count, and what an operating point must be.

use proptest::prelude::*;
use slipsense::decision::Decision;
use slipsense::fixed::Logit;
use slipsense::net::format::{DECISION_FRAMES_MAX, OperatingPoint};

/// Log-odds as the network gives them; none where no pad is touched.
fn log_odds() -> impl Strategy<Value = Option<Logit>> {
    let edges = prop_oneof![Just(i16::MIN), Just(i16::MAX), Just(0), any::<i16>(), -3i16..=3];
    proptest::option::weighted(0.9, edges.prop_map(|bits| Logit::from_bits(bits.into())))
}

fn at(threshold: i32, k: u8, n: u8) -> OperatingPoint {
    OperatingPoint { threshold: Logit::from_bits(threshold), k, n }
}

fn point() -> impl Strategy<Value = OperatingPoint> {
    let threshold = prop_oneof![Just(-65_536), Just(65_535), -3i32..=3, -40_000i32..40_000];
    (threshold, 1..=DECISION_FRAMES_MAX)
        .prop_flat_map(|(threshold, n)| (Just(threshold), 1..=n, Just(n)))
        .prop_map(|(threshold, k, n)| at(threshold, k, n))
}

proptest! {
    #[test]
    fn the_flag_is_k_of_the_last_n(point in point(), frames in proptest::collection::vec(log_odds(), 0..100)) {
        prop_assert_eq!(point.check(), Ok(()));
        let over = |log_odds: &&Option<Logit>| {
            log_odds.is_some_and(|log_odds| log_odds.to_bits() > point.threshold.to_bits())
        };
        let mut decision = Decision::new(point);
        for (newest, &log_odds) in frames.iter().enumerate() {
            let first = (newest + 1).saturating_sub(usize::from(point.n));
            let counted = frames[first..=newest].iter().filter(over).count();
            prop_assert_eq!(decision.step(log_odds), counted >= usize::from(point.k), "frame {}", newest);
        }
    }
}

#[test]
fn points_that_the_flag_cannot_be_decided_at() {
    let refused = |threshold, k, n| at(threshold, k, n).check().expect_err("must be refused").to_string();
    assert_eq!(refused(0, 1, 0), "operating point n is 0, allowed are 1 to 32");
    assert_eq!(refused(0, 1, 33), "operating point n is 33, allowed are 1 to 32");
    assert_eq!(refused(0, 0, 5), "operating point k is 0, allowed are 1 to 5");
    assert_eq!(refused(0, 6, 5), "operating point k is 6, allowed are 1 to 5");
    assert_eq!(refused(65_536, 1, 1), "operating point threshold is 65536, allowed are -65536 to 65535");
    assert_eq!(refused(-65_537, 1, 1), "operating point threshold is -65537, allowed are -65536 to 65535");
}
