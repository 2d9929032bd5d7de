//! What the drivers make of any bytes.

use proptest::prelude::*;
use slipsense::board::FifoSamples;
use slipsense::drivers::adxl38x::{Framer, OutOfStep};
use slipsense::drivers::icm42688::parse;

/// Samples of a stream of entries by definition: x, y and z right after each other, where z is not followed back.
fn definition(entries: &[[u8; 3]]) -> Vec<[i16; 3]> {
    let value = |[_, high, low]: [u8; 3]| i16::from_be_bytes([high, low]);
    // Three in the right order overlap no others in it.
    let samples = entries.array_windows::<3>().filter(|three| three.map(|[axis, ..]| axis & 3) == [0, 1, 2]);
    samples.map(|three| three.map(value)).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2_000))]

    #[test]
    fn entries_become_samples_only_in_step(entries in prop::collection::vec((0u8..4, any::<[u8; 2]>()), 0..400)) {
        let entries: Vec<[u8; 3]> = entries.into_iter().map(|(axis, [h, l])| [axis, h, l]).collect();
        let mut framer = Framer::default();
        let made: Vec<_> = entries.iter().filter_map(|&entry| framer.push(entry).ok().flatten()).collect();
        prop_assert_eq!(made, definition(&entries));
    }

    #[test]
    fn one_cut_is_one_break(samples in 2usize..60, from in 0usize..180, length in 1usize..30) {
        let mut entries: Vec<[u8; 3]> =
            (0..samples * 3).map(|i| [(i % 3) as u8, (i / 3) as u8, 7]).collect();
        let from = from % entries.len();
        entries.drain(from..(from + length).min(samples * 3));
        let mut framer = Framer::default();
        let pushed: Vec<_> = entries.iter().map(|&entry| framer.push(entry)).collect();
        let breaks = pushed.iter().filter(|result| **result == Err(OutOfStep)).count();
        prop_assert!(breaks <= 1);
        let made = pushed.iter().filter_map(|result| result.ok().flatten());
        // A cut of whole samples amid one leaves the right axes of two: only the level of the FIFO tells of that.
        prop_assert!(length % 3 == 0 || made.clone().all(|[x, y, z]| x == y && y == z));
        let seen = if from + length >= samples * 3 { from / 3 } else { samples.saturating_sub(length.div_ceil(3) + 1) };
        prop_assert!(made.count() >= seen.min(samples - 1));
    }

    #[test]
    fn packets_end_at_the_first_that_is_none(
        good in 0usize..200, rest in prop::collection::vec(any::<u8>(), 0..64), header in any::<u8>(),
    ) {
        let mut bytes = Vec::new();
        for n in 0..good {
            bytes.extend([0x40, 0, n as u8, 1, n as u8, 2, n as u8, 25]);
        }
        bytes.push(header);
        bytes.extend(&rest);
        let mut samples = FifoSamples::new();
        let broken = parse(&bytes, &mut samples);
        let expected: Vec<[i16; 3]> = (0..good as i16).map(|n| n & 255).map(|n| [n, 256 + n, 512 + n]).collect();
        prop_assert_eq!(&samples[..good], &expected[..]);
        if header >> 4 != 4 && rest.len() >= 7 {
            prop_assert_eq!((samples.len(), broken), (good, 1));
        }
        prop_assert!(broken <= 1);
    }
}
