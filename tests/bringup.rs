//! Verdicts of the bring-up program from made-up measurements; the program itself runs in the board twin.

use slipsense::board::{Accelerometer, XlFault, XlPart};
use slipsense::bringup::{
    ArrayStats, Finding, Settling, XlReadings, judge_array, judge_clock, judge_lines, judge_settling,
    judge_xl,
};
use slipsense::drivers::Adxl380;
use slipsense::drivers::scan::ADDRESS_LINES;
use slipsense::params::TAXELS;
use slipsense::transfer::IDLE_CODE;

use crate::drivers::fake::Wire;
use crate::on_pad;

const PART: XlPart = <Adxl380<'static, Wire> as Accelerometer>::PART;

/// A pad that is pressed unevenly all over, with noise, scanned through lines that select another address.
fn pressed(select: impl Fn(usize) -> usize) -> ArrayStats {
    let mut stats = ArrayStats::new();
    for frame in 0..16 {
        let code = |slot: usize| {
            let taxel = select(slot);
            let uneven = (taxel as u32).wrapping_mul(2_654_435_761) >> 18;
            let press = if on_pad(taxel) { 6_000 + uneven } else { 0 };
            let noise = (slot * 7 + frame * 13) % 21;
            (u32::from(IDLE_CODE) + press + noise as u32) as u16
        };
        stats.add(&std::array::from_fn::<u16, TAXELS, _>(code), 0, 1);
    }
    stats
}

#[test]
fn every_open_address_line_is_named() {
    assert!(matches!(judge_array(&pressed(|slot| slot)), Finding::ArrayAt { pressed: 942, .. }));
    for line in 0..ADDRESS_LINES {
        for held in [0, 1 << line] {
            let stats = pressed(|slot| slot & !(1 << line) | held);
            assert_eq!(judge_array(&stats), Finding::AddressOpen { line: line as u8 });
        }
    }
}

/// Which pairs of lines can be swapped without being seen, because the pad's outline stays the same.
#[test]
fn swapped_lines_show_but_for_those_that_keep_the_outline() {
    let mut unseen = Vec::new();
    for b in 1..ADDRESS_LINES {
        for a in 0..b {
            let stats = pressed(|slot| {
                let differ = (slot >> a ^ slot >> b) & 1;
                slot ^ (differ << a | differ << b)
            });
            match judge_array(&stats) {
                Finding::AddressSwapped { lines } => assert_eq!(lines, (a as u8, b as u8)),
                Finding::ArrayAt { .. } => unseen.push((a, b)),
                other => panic!("{a} {b}: {other}"),
            }
        }
    }
    // A3 and A4 of the columns, and of the rows: the middle half of the pad has no corner.
    assert_eq!(unseen, [(3, 4), (8, 9)]);
}

#[test]
fn an_untouched_pad_is_not_judged() {
    let mut stats = ArrayStats::new();
    for frame in 0..8_u16 {
        stats.add(&std::array::from_fn::<u16, TAXELS, _>(|slot| IDLE_CODE + (slot as u16 + frame) % 9), 0, 1);
    }
    assert_eq!(judge_array(&stats), Finding::NotPressed);
}

#[test]
fn what_is_left_of_an_exponential_is_found_from_three_triggers() {
    for (tau_ns, settled) in [(100.0, true), (154.0, true), (300.0, false), (600.0, false), (2_000.0, false)]
    {
        let left = |at_ns: f64| 30_000.0 * (-at_ns / tau_ns).exp();
        let codes = [1_550.0, 1_800.0, 2_050.0].map(|at| (40_000.0 - left(at)).round() as u32);
        let finding = judge_settling(Settling { codes, step_codes: 30_000 }, 4);
        match finding {
            Finding::Settled { .. } => assert!(settled, "{tau_ns} ns: {finding}"),
            Finding::NotSettled { left_codes, .. } => {
                assert!(!settled, "{tau_ns} ns: {finding}");
                let expected = left(2_050.0);
                assert!((f64::from(left_codes) / expected - 1.0).abs() < 0.1, "{tau_ns} ns: {finding}");
            }
            _ => panic!("{finding}"),
        }
    }
    assert_eq!(judge_settling(Settling { codes: [900; 3], step_codes: 20 }, 4), Finding::NotPressed);
}

#[test]
fn clock_pins_and_parts_are_judged_by_what_they_read() {
    assert_eq!(judge_clock(8_050_000, 8_000_000), Finding::HseAt { hz: 8_050_000 });
    assert_eq!(judge_clock(7_920_000, 8_000_000), Finding::HseOff { hz: 7_920_000 });
    let alone = std::array::from_fn(|line| 1 << line);
    assert_eq!(judge_lines(0, &alone), Finding::LinesFree);
    assert_eq!(judge_lines(1 << 7, &alone), Finding::LineHeld { line: 7, high: true });
    let mut shorted = alone;
    (shorted[2], shorted[6]) = (1 << 2 | 1 << 6, 1 << 2 | 1 << 6);
    assert_eq!(judge_lines(0, &shorted), Finding::LinesShorted { lines: (2, 6) });
    let mut readings = XlReadings::default();
    readings.add(&[[0, 0, 3_000], [10, 0, 3_000]]);
    assert_eq!(judge_xl(Ok(readings), PART, 250, true), Finding::XlGravity { milli_g: 400 });
    let zeros = XlFault::WrongPart { expected: 1, found: 0 };
    let silent = Finding::XlNoAnswer { all_ones: false, only_one: false };
    assert_eq!(judge_xl(Err(zeros), PART, 250, false), silent);
}
