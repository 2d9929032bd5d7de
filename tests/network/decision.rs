//! The flag against a naive count, and what an operating point must be.

use proptest::prelude::*;
use slipsense::decision::{Class, Decision, margin};
use slipsense::fixed::Logit;
use slipsense::net::format::{DECISION_FRAMES_MAX, OperatingPoint};

fn logits() -> impl Strategy<Value = [Logit; 3]> {
    let edges = prop_oneof![Just(i16::MIN), Just(i16::MAX), Just(0), any::<i16>(), -3i16..=3];
    proptest::array::uniform3(edges).prop_map(|logits| logits.map(|logit| Logit::from_bits(logit.into())))
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

/// One frame: what the pads say, and the logits.
fn frames() -> impl Strategy<Value = Vec<(Option<bool>, [Logit; 3])>> {
    proptest::collection::vec((any::<Option<bool>>(), logits()), 0..100)
}

proptest! {
    #[test]
    fn the_flag_is_k_of_the_last_n(point in point(), frames in frames()) {
        prop_assert_eq!(point.check(), Ok(()));
        let over = |&(touched, logits): &(Option<bool>, [Logit; 3])| {
            let [no_contact, no_slip, slip] = logits.map(Logit::to_bits);
            let threshold = point.threshold.to_bits();
            match touched {
                Some(false) => false,
                Some(true) => slip - no_slip > threshold,
                None => slip - no_slip.max(no_contact) > threshold,
            }
        };
        let mut decision = Decision::new(point);
        for (newest, &(touched, logits)) in frames.iter().enumerate() {
            let first = (newest + 1).saturating_sub(usize::from(point.n));
            let counted = frames[first..=newest].iter().filter(|&frame| over(frame)).count();
            let flag = decision.step(margin(touched, logits));
            prop_assert_eq!(flag, counted >= usize::from(point.k), "frame {}", newest);
        }
    }

    #[test]
    fn at_argmax_the_flag_is_the_class(frames in frames()) {
        let mut decision = Decision::new(OperatingPoint::EVEN);
        for (touched, logits) in frames {
            let class = Class::new(touched, logits);
            prop_assert_eq!(decision.step(margin(touched, logits)), class == Class::Slip);
        }
    }
}

#[test]
fn the_ends_of_the_range_say_always_and_never() {
    let (always, never) = (OperatingPoint::THRESHOLD_MIN, OperatingPoint::THRESHOLD_MAX);
    let [least, most] = [i16::MIN, i16::MAX].map(|end| Logit::from_bits(end.into()));
    let mut decision = Decision::new(OperatingPoint { threshold: always, k: 1, n: 1 });
    assert!(decision.step(margin(Some(true), [most, most, least])));
    assert!(!decision.step(margin(Some(false), [least, least, most])), "an untouched pad cannot slip");
    let mut decision = Decision::new(OperatingPoint { threshold: never, k: 1, n: 32 });
    assert!(!decision.step(margin(Some(true), [least, least, most])));
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
