//! Word-wise passes over a scan against the plain ones, over random and extreme scans.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slipsense::contact::ContactSummary;
use slipsense::fixed::Q;
use slipsense::params::{ACTIVE_TAXELS, COUNT_MAX, TAXEL_COLS, TAXEL_TOUCH_MIN, TAXELS};
use slipsense::sensor::{PiezoFrame, TaxelMask};

use crate::on_pad;

/// Scans as an ADC might write them, of all kinds.
fn scans() -> impl Iterator<Item = [u16; TAXELS]> {
    let mut rng = ChaCha8Rng::seed_from_u64(21);
    (0..600).map(move |n| {
        std::array::from_fn(|_| match n % 6 {
            0 => u16::MAX,
            1 => rng.random(),
            2 => [0, COUNT_MAX][rng.random_range(0..2)],
            3 => TAXEL_TOUCH_MIN - rng.random_range(0..2),
            4 => rng.random_range(0..COUNT_MAX),
            _ => [0, rng.random_range(0..=COUNT_MAX)][usize::from(rng.random_range(0..200) == 0)],
        })
    })
}

#[test]
fn a_scan_is_what_its_taxels_are() {
    for scan in scans() {
        let frame = PiezoFrame::from_scan(scan);
        let expected: Vec<u16> =
            scan.iter().enumerate().map(|(i, &count)| if on_pad(i) { count % 4096 } else { 0 }).collect();
        assert_eq!(frame.counts()[..], expected);
        assert_eq!(frame.sum(), expected.iter().map(|&count| u32::from(count)).sum::<u32>());
        assert_eq!(frame.is_saturated(), expected.contains(&COUNT_MAX));
        let active: Vec<u16> = (0..TAXELS).filter(|&i| on_pad(i)).map(|i| expected[i]).collect();
        assert_eq!(active.len(), ACTIVE_TAXELS);
        assert!(frame.active().eq(active));
        assert_contact(&frame);
    }
}

/// A contact has the sums of its taxels.
fn assert_contact(frame: &PiezoFrame) {
    let summary = ContactSummary::new(frame);
    let (mut area, mut weight, mut row, mut col) = (0, 0u64, 0u64, 0u64);
    for (index, &count) in frame.counts().iter().enumerate().filter(|(_, count)| **count >= TAXEL_TOUCH_MIN) {
        area += 1;
        weight += u64::from(count);
        row += u64::from(count) * (index / TAXEL_COLS) as u64;
        col += u64::from(count) * (index % TAXEL_COLS) as u64;
    }
    assert_eq!((summary.sum, summary.area), (frame.sum(), area));
    if weight > 0 {
        let mean = |moment: u64| Q::from_bits(((512 * moment + weight) / (2 * weight)) as u16);
        assert_eq!([summary.centroid_row, summary.centroid_col], [row, col].map(mean));
    }
}

#[test]
fn one_taxel_at_full_scale_is_seen_wherever_it_is() {
    for index in (0..TAXELS).filter(|&i| on_pad(i)) {
        let mut scan = [COUNT_MAX - 1; TAXELS];
        assert!(!PiezoFrame::from_scan(scan).is_saturated());
        scan[index] = COUNT_MAX;
        assert!(PiezoFrame::from_scan(scan).is_saturated());
    }
}

#[test]
fn a_mask_zeroes_what_it_names_and_nothing_else() {
    let mut rng = ChaCha8Rng::seed_from_u64(22);
    for scan in scans() {
        let mut mask = TaxelMask::NONE;
        let masked: Vec<usize> = (0..rng.random_range(0..40)).map(|_| rng.random_range(0..TAXELS)).collect();
        for &index in &masked {
            mask = mask.with(index / TAXEL_COLS, index % TAXEL_COLS);
        }
        let mut frame = PiezoFrame::from_scan(scan);
        frame.mask(&mask);
        let mut expected = scan;
        masked.iter().for_each(|&index| expected[index] = 0);
        let expected = PiezoFrame::from_scan(expected);
        assert_eq!(frame.counts(), expected.counts());
        assert_eq!((frame.sum(), frame.is_saturated()), (expected.sum(), expected.is_saturated()));
        let any = masked.iter().any(|&index| on_pad(index));
        assert_eq!((frame.is_masked(), mask.is_empty()), (any, !any), "cells beside the pad do not count");
    }
}

#[test]
fn a_mask_knows_its_taxels_and_no_others() {
    let mask = TaxelMask::NONE.with(3, 31).with(40, 2).with(2, 32);
    let named: Vec<usize> = (0..TAXELS).filter(|i| mask.masks(i / TAXEL_COLS, i % TAXEL_COLS)).collect();
    assert_eq!(named, [3 * TAXEL_COLS + 31]);
    assert!(!mask.masks(40, 2));
}
