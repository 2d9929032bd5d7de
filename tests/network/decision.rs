//! The alarm against a naive count, and what an operating point must be.

use proptest::prelude::*;
use slipsense::decision::{Class, Decision, margin_q10};
use slipsense::net::format::{ALARM_FRAMES_MAX, OperatingPoint, THRESHOLD_RANGE_Q10};

/// Logits as the network gives them.
fn logits() -> impl Strategy<Value = [i32; 3]> {
    let edges = prop_oneof![Just(i16::MIN), Just(i16::MAX), Just(0), any::<i16>(), -3i16..=3];
    proptest::array::uniform3(edges).prop_map(|logits| logits.map(i32::from))
}

fn point() -> impl Strategy<Value = OperatingPoint> {
    let threshold =
        prop_oneof![Just(THRESHOLD_RANGE_Q10.0), Just(THRESHOLD_RANGE_Q10.1), -3i32..=3, -40_000i32..40_000];
    (threshold, 1..=ALARM_FRAMES_MAX)
        .prop_flat_map(|(threshold_q10, n)| (Just(threshold_q10), 1..=n, Just(n)))
        .prop_map(|(threshold_q10, k, n)| OperatingPoint { threshold_q10, k, n })
}

/// One frame: what the pads say, and the logits.
fn frames() -> impl Strategy<Value = Vec<(Option<bool>, [i32; 3])>> {
    proptest::collection::vec((any::<Option<bool>>(), logits()), 0..100)
}

proptest! {
    #[test]
    fn the_alarm_is_k_of_the_last_n(point in point(), frames in frames()) {
        prop_assert_eq!(point.check(), Ok(()));
        let over = |&(touched, [no_contact, no_slip, slip]): &(Option<bool>, [i32; 3])| match touched {
            Some(false) => false,
            Some(true) => slip - no_slip > point.threshold_q10,
            None => slip - no_slip.max(no_contact) > point.threshold_q10,
        };
        let mut decision = Decision::new(point);
        for (newest, &(touched, logits)) in frames.iter().enumerate() {
            let first = (newest + 1).saturating_sub(usize::from(point.n));
            let counted = frames[first..=newest].iter().filter(|&frame| over(frame)).count();
            let alarm = decision.step(margin_q10(touched, logits));
            prop_assert_eq!(alarm, counted >= usize::from(point.k), "frame {}", newest);
        }
    }

    #[test]
    fn at_argmax_the_alarm_is_the_class(frames in frames()) {
        let mut decision = Decision::new(OperatingPoint::ARGMAX);
        for (touched, logits) in frames {
            let class = Class::of(touched, logits);
            prop_assert_eq!(decision.step(margin_q10(touched, logits)), class == Class::Slip);
        }
    }
}

#[test]
fn the_ends_of_the_range_say_always_and_never() {
    let (always, never) = THRESHOLD_RANGE_Q10;
    let (least, most) = (i32::from(i16::MIN), i32::from(i16::MAX));
    let mut decision = Decision::new(OperatingPoint { threshold_q10: always, k: 1, n: 1 });
    assert!(decision.step(margin_q10(Some(true), [most, most, least])));
    assert!(!decision.step(margin_q10(Some(false), [least, least, most])), "an untouched pad cannot slip");
    let mut decision = Decision::new(OperatingPoint { threshold_q10: never, k: 1, n: 32 });
    assert!(!decision.step(margin_q10(Some(true), [least, least, most])));
}

#[test]
fn points_that_the_alarm_cannot_work_at() {
    let refused = |threshold_q10, k, n| {
        OperatingPoint { threshold_q10, k, n }.check().expect_err("must be refused").to_string()
    };
    assert_eq!(refused(0, 1, 0), "operating point n is 0, allowed are 1 to 32");
    assert_eq!(refused(0, 1, 33), "operating point n is 33, allowed are 1 to 32");
    assert_eq!(refused(0, 0, 5), "operating point k is 0, allowed are 1 to 5");
    assert_eq!(refused(0, 6, 5), "operating point k is 6, allowed are 1 to 5");
    assert_eq!(refused(65_536, 1, 1), "operating point threshold is 65536, allowed are -65536 to 65535");
    assert_eq!(refused(-65_537, 1, 1), "operating point threshold is -65537, allowed are -65536 to 65535");
}
