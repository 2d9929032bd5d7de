//! What the network sees of a pad, against the rule for untouched ones. On the microcontroller:
//! `cargo xtask qemu`.

use slipsense::features::pad_cells::PadCells;
use slipsense::features::taxel_change::TaxelChange;
use slipsense::params::{CONTACT_SUM_MIN, PIEZO_CHANNELS, TAXELS};
use slipsense::sensor::{PiezoFrame, is_active};

fn cells(pad: &mut PadCells, scan: &PiezoFrame) -> (bool, Vec<[i16; PIEZO_CHANNELS]>) {
    let mut all = Vec::new();
    let touched = pad.push(scan.counts(), |index, cell| {
        assert_eq!(index, all.len());
        all.push(cell);
    });
    (touched, all)
}

/// `sum` counts on the pad, one per active taxel and the rest on the last.
fn scan_of_sum(sum: u32) -> PiezoFrame {
    let mut left = sum;
    let mut counts = [0; TAXELS];
    for (index, count) in counts.iter_mut().enumerate() {
        if is_active(index / 32, index % 32) && left > 0 {
            *count = 1;
            left -= 1;
        }
    }
    counts[16 * 32 + 16] += left as u16;
    PiezoFrame::from_counts(counts).unwrap()
}

#[test]
fn one_count_less_than_the_threshold_is_nothing_and_the_threshold_is_all_of_it() {
    let mut pad = PadCells::new();
    let (touched, all) = cells(&mut pad, &scan_of_sum(CONTACT_SUM_MIN - 1));
    assert!(!touched && all == [[0; PIEZO_CHANNELS]; TAXELS]);
    let at_threshold = scan_of_sum(CONTACT_SUM_MIN);
    let (touched, all) = cells(&mut pad, &at_threshold);
    assert!(touched);
    assert!(all.iter().zip(at_threshold.counts()).all(|(cell, &count)| cell[0] == count as i16));
    // The averages knew the scan before although the network did not: one taxel rose by one count.
    assert_eq!(all.iter().filter(|cell| cell[1] != 0).count(), 1);
}

#[test]
fn a_touched_pad_is_counts_and_change() {
    let (mut pad, mut change) = (PadCells::new(), TaxelChange::new());
    for step in 0..50u32 {
        let scan = scan_of_sum(CONTACT_SUM_MIN - 500 + step * 37 % 3000);
        let (touched, all) = cells(&mut pad, &scan);
        let mut expected = Vec::new();
        change.push(scan.counts(), |_, count, change| expected.push([count as i16, change]));
        assert_eq!(touched, scan.sum() >= CONTACT_SUM_MIN);
        if touched {
            assert_eq!(all, expected);
        }
        if step == 30 {
            pad.forget();
            change.forget();
        }
    }
}
