//! Receiving: filters and FIFOs.

use super::*;

/// Standard filters: range, dual, mask, reject, and the global filter for the rest.
#[test]
fn standard_filters_in_their_order() {
    let mut bench = Bench::configured(Vec::new());
    let filter = |kind: u64, to: u64, one: u64, two: u64| kind << 30 | to << 27 | one << 16 | two;
    let filters = [
        filter(0, 1, 0x100, 0x1FF), // range to FIFO 0
        filter(1, 2, 0x200, 0x300), // dual to FIFO 1
        filter(2, 3, 0x400, 0x7F0), // mask 0x400 to 0x40F: rejected
        filter(2, 1, 0x400, 0x700), // 0x400 to 0x4FF, if the one before has not matched
        filter(3, 1, 0x500, 0x500), // switched off
        filter(1, 0, 0x600, 0x600), // switched off
        filter(0, 7, 0x700, 5),     // Rx buffer 5: no model
    ];
    for (index, word) in filters.into_iter().enumerate() {
        bench.put_word(STANDARD + index as u64, word);
    }
    bench.set(SIDFC, (filters.len() as u64) << 16 | STANDARD << 2);
    bench.set(RXF0C, 10 << 16 | FIFO0 << 2);
    // What no filter takes is rejected.
    bench.set(GFC, 0b10 << 4 | 0b10 << 2);
    let frames = [0x0FF, 0x100, 0x1FF, 0x200, 0x250, 0x300, 0x40F, 0x410, 0x500, 0x600, 0x700];
    bench.peer(&frames.map(standard));
    bench.set(CCCR, FDOE | BRSE);
    bench.wait(3_000_000);
    assert_eq!(bench.get(RXF0S) & 0x7F, 3);
    let found: Vec<u64> = (0..3).map(|element| bench.word(FIFO0 + ELEMENT * element) >> 18).collect();
    assert_eq!(found, [0x100, 0x1FF, 0x410]);
    assert_eq!(bench.word(FIFO0 + 2 * ELEMENT + 1) >> 24, 3, "FIDX, ANMF 0");
    assert_eq!(bench.word(FIFO0 + 1) >> 16 & 0xF, 8, "DLC");
    assert_eq!(bench.word(FIFO0 + 2), 0x5555_5555);
    let found: Vec<u64> = (0..2).map(|element| bench.word(FIFO1 + ELEMENT * element) >> 18).collect();
    assert_eq!((found.as_slice(), bench.get(RXF1S) & 0x7F), (&[0x200, 0x300][..], 2));
    assert!(bench.tells("no model"));
}

/// Extended filters: range with and without the XIDAM mask; unmatched ones to FIFO 1.
#[test]
fn extended_filters_with_the_and_mask() {
    let mut bench = Bench::configured(Vec::new());
    bench.put_word(EXTENDED, 1 << 29 | 0x100);
    bench.put_word(EXTENDED + 1, 0x1FF);
    bench.put_word(EXTENDED + 2, 1 << 29 | 0x1000_0200);
    bench.put_word(EXTENDED + 3, 3 << 30 | 0x1000_02FF);
    bench.set(XIDFC, 2 << 16 | EXTENDED << 2);
    bench.set(XIDAM, 0x0000_FFFF);
    bench.set(GFC, 0b10 << 4 | 0b01 << 2);
    bench.peer(&[0x1234_0150, 0x1000_0250, 0x0000_0250].map(extended));
    bench.set(CCCR, FDOE | BRSE);
    bench.wait(2_000_000);
    let found: Vec<u64> = (0..2).map(|element| bench.word(FIFO0 + ELEMENT * element)).collect();
    assert_eq!(found, [1 << 30 | 0x1234_0150, 1 << 30 | 0x1000_0250]);
    assert_eq!(bench.word(FIFO1), 1 << 30 | 0x0250);
    assert_eq!(bench.word(FIFO1 + 1) >> 31, 1, "ANMF");
}

/// Rx FIFO: watermark, full, lost; blocking keeps the old, overwriting the new; acknowledge by index.
#[test]
fn a_full_fifo_blocks_or_overwrites() {
    for overwrite in [false, true] {
        let mut bench = Bench::configured(Vec::new());
        bench.set(RXF0C, u64::from(overwrite) << 31 | 2 << 24 | 3 << 16 | FIFO0 << 2);
        bench.peer(&[1, 2, 3, 4].map(standard));
        bench.set(CCCR, FDOE | BRSE);
        bench.wait(2_000_000);
        let status = bench.get(RXF0S);
        assert_eq!(status & 0x7F, 3);
        assert_ne!(status & 1 << 24, 0, "full");
        assert_eq!(bench.get(IR) & 0b1111, if overwrite { 0b0111 } else { 0b1111 });
        let first = if overwrite { 4 } else { 1 };
        assert_eq!(bench.word(FIFO0) >> 18, first, "element 0");
        let get = status >> 8 & 0x3F;
        assert_eq!(get, u64::from(overwrite));
        bench.set(RXF0A, get);
        assert_eq!(bench.get(RXF0S) & 0x7F, 2);
        bench.set(RXF0A, get);
        assert!(bench.tells("does not hold"), "acknowledged twice");
    }
}
