//! What the network sees of a pad: the delta against its formula, the rule for untouched pads; the first scan and one
//! behind a gap: `network::streaming`. On the microcontroller:
//! `cargo xtask qemu`.

use slipsense::features::piezo::PiezoFrontEnd;
use slipsense::params::{CONTACT_SUM_MIN, PIEZO_CHANNELS, TAXEL_COLS, TAXEL_ROWS, TAXELS};
use slipsense::sensor::PiezoFrame;

use crate::on_pad;

type Cells = Vec<[i16; PIEZO_CHANNELS]>;

/// As of a pad that is touched, whatever its sum.
fn cells(pad: &mut PiezoFrontEnd, scan: &PiezoFrame) -> Cells {
    let mut rows = [[[i16::MIN; PIEZO_CHANNELS]; TAXEL_COLS]; TAXEL_ROWS];
    assert!(pad.push_rows(scan.counts(), CONTACT_SUM_MIN, rows.iter_mut()));
    assert!(rows.as_flattened().iter().zip(scan.counts()).all(|(cell, &count)| cell[0] == count as i16));
    rows.as_flattened().to_vec()
}

fn front_end_cells(pad: &mut PiezoFrontEnd, scan: &PiezoFrame) -> (bool, Cells) {
    let mut all = Vec::new();
    let touched = pad.push(scan.counts(), |index, cell| {
        assert_eq!(index, all.len());
        all.push(cell);
    });
    (touched, all)
}

/// `sum` counts on the pad, one per active taxel and the rest on one in the middle.
fn scan_of_sum(sum: u32) -> PiezoFrame {
    let active: Vec<usize> = (0..TAXELS).filter(|&index| on_pad(index)).take(sum as usize).collect();
    let mut counts = [0; TAXELS];
    active.iter().for_each(|&index| counts[index] = 1);
    counts[16 * 32 + 16] += (sum as usize - active.len()) as u16;
    PiezoFrame::from_counts(counts).unwrap()
}

#[test]
fn the_delta_of_a_taxel_follows_its_formula_at_every_extreme() {
    // The same recursion in floating point, rounding written out: exact below 2^53.
    let steps = [0u16, 4095, 4095, 0, 1, 4094, 7, 7, 7, 8, 0, 4095];
    for offset in 0..steps.len() {
        let mut pad = PiezoFrontEnd::new();
        let mut average = f64::NAN;
        for t in 0..60 {
            let count = steps[(t * (offset + 1) + offset) % steps.len()];
            let found = cells(&mut pad, &PiezoFrame::from_scan([count; TAXELS]));
            let x = 16.0 * f64::from(count);
            if t == 0 {
                average = x;
            }
            let expected = ((x - average) / 2.0).floor().clamp(-16384.0, 16383.0);
            average += ((x - average) / 8.0 + 0.5).floor();
            assert!((0.0..=65535.0).contains(&average));
            for (index, &[_, found]) in found.iter().enumerate() {
                let expected = if on_pad(index) { expected } else { 0.0 };
                assert!(f64::from(found) == expected, "frame {t}, taxel {index}: {found}");
            }
        }
    }
}

#[test]
fn one_count_less_than_the_threshold_is_nothing_and_the_threshold_is_all_of_it() {
    let mut pad = PiezoFrontEnd::new();
    let (touched, all) = front_end_cells(&mut pad, &scan_of_sum(CONTACT_SUM_MIN - 1));
    assert!(!touched && all == [[0; PIEZO_CHANNELS]; TAXELS]);
    let at_threshold = scan_of_sum(CONTACT_SUM_MIN);
    let (touched, all) = front_end_cells(&mut pad, &at_threshold);
    assert!(touched);
    assert!(all.iter().zip(at_threshold.counts()).all(|(cell, &count)| cell[0] == count as i16));
    // The averages took the scan before although the network did not: one taxel rose by one count.
    assert_eq!(all.iter().filter(|cell| cell[1] != 0).count(), 1);
}

#[test]
fn a_touched_pad_is_counts_and_delta() {
    let [mut pad, mut delta] = [PiezoFrontEnd::new(), PiezoFrontEnd::new()];
    for step in 0..50u32 {
        let scan = scan_of_sum(CONTACT_SUM_MIN - 500 + step * 37 % 3000);
        let (touched, all) = front_end_cells(&mut pad, &scan);
        let expected = cells(&mut delta, &scan);
        assert_eq!(touched, scan.sum() >= CONTACT_SUM_MIN);
        assert!(!touched || all == expected);
        if step == 30 {
            pad.reset();
            delta.reset();
        }
    }
}
