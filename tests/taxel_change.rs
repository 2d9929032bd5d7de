//! The change of the taxels, the network's second channel, against its formula. Bit for bit within the network:
//! `tests/network/batch.rs`; on the microcontroller: `cargo xtask qemu`.

use slipsense::features::taxel_change::{CHANGE_GAIN, TaxelChange};
use slipsense::params::{TAXEL_COLS, TAXELS};
use slipsense::sensor::{PiezoFrame, is_active};

/// A scan with these counts on every active taxel in turn.
fn scan_of(count: impl Fn(usize) -> u16) -> PiezoFrame {
    PiezoFrame::from_scan(std::array::from_fn(count))
}

fn changes(change: &mut TaxelChange, scan: &PiezoFrame) -> Vec<i16> {
    let mut all = vec![i16::MIN; TAXELS];
    change.push(scan.counts(), |index, count, x| {
        assert_eq!(count, scan.counts()[index]);
        all[index] = x;
    });
    all
}

#[test]
fn the_change_of_a_taxel_follows_its_formula_at_every_extreme() {
    // The same recursion in floating point, rounding written out: exact below 2^53.
    let steps = [0u16, 4095, 4095, 0, 1, 4094, 7, 7, 7, 8, 0, 4095];
    for offset in 0..steps.len() {
        let mut change = TaxelChange::new();
        let mut average = f64::NAN;
        for t in 0..60 {
            let count = steps[(t * (offset + 1) + offset) % steps.len()];
            let scan = scan_of(|_| count);
            let found = changes(&mut change, &scan);
            let x = 16.0 * f64::from(count);
            if t == 0 {
                average = x;
            }
            // Cut to 15 bits, which is what a convolution takes.
            let expected = ((x - average) / 2.0).floor().clamp(-16384.0, 16383.0);
            average += ((x - average) / 8.0 + 0.5).floor();
            for (index, &found) in found.iter().enumerate() {
                let active = is_active(index / TAXEL_COLS, index % TAXEL_COLS);
                // Off the pad nothing is read and nothing changes.
                let expected = if active { expected } else { 0.0 };
                assert!(f64::from(found) == expected, "frame {t}, taxel {index}: {found}");
            }
            assert!((0.0..=65535.0).contains(&average));
        }
    }
}

#[test]
fn a_first_scan_and_one_behind_a_gap_have_no_change() {
    let loaded = scan_of(|index| (index % 4096) as u16);
    let mut change = TaxelChange::new();
    assert!(changes(&mut change, &loaded).iter().all(|&x| x == 0));
    assert!(changes(&mut change, &PiezoFrame::zeroed()).iter().any(|&x| x < -4000));
    change.forget();
    assert!(changes(&mut change, &loaded).iter().all(|&x| x == 0));
    // And a load that stays stops being a change: a count more decays to less than half of one.
    let more = scan_of(|index| (index % 4000) as u16 + 1);
    let less = scan_of(|index| (index % 4000) as u16);
    let mut change = TaxelChange::new();
    changes(&mut change, &less);
    let first = changes(&mut change, &more);
    let last = (0..40).fold(Vec::new(), |_, _| changes(&mut change, &more));
    let pad = less.counts().iter().zip(more.counts()).map(|(less, more)| less != more);
    for (active, (first, last)) in pad.zip(first.into_iter().zip(last)) {
        assert!(!active || (first == CHANGE_GAIN as i16 && last.abs() <= 2), "{first} {last}");
    }
}
