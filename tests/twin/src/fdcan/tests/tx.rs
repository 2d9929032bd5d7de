//! Sending: FIFO, queue, cancellation, Tx events.

use super::*;

/// Tx FIFO: in the order of the requests, whatever the identifiers; three elements.
#[test]
fn the_fifo_sends_in_the_order_of_its_elements() {
    let mut bench = Bench::started(0, Vec::new());
    assert_eq!(bench.get(TXFQS), 3, "three free, both indices 0");
    for (buffer, id) in [(0, 0x300), (1, 0x200), (2, 0x100)] {
        bench.fill(buffer, id, false);
        assert_eq!(bench.get(TXFQS) >> 16 & 0x1F, buffer, "put index");
        bench.set(TXBAR, 1 << buffer);
    }
    assert_eq!(bench.get(TXFQS), 1 << 21, "full");
    bench.wait(1_000_000);
    assert_eq!(bench.sent(), ids(&[0x300, 0x200, 0x100]));
    assert_eq!((bench.get(TXBRP), bench.get(TXBTO)), (0, 0b111));
    assert_ne!(bench.get(IR) & 1 << 11, 0, "TFE");
    assert_ne!(bench.get(IR) & 1 << 9, 0, "TC");
}

/// Tx queue: the smallest identifier of those pending, of equal ones the lowest buffer.
#[test]
fn the_queue_sends_in_the_order_of_identifiers() {
    let mut bench = Bench::started(QUEUE, Vec::new());
    // While the first is on the wires the others queue up behind it.
    for (buffer, id) in [(0, 0x300), (1, 0x200), (2, 0x100)] {
        bench.fill(buffer, id, false);
        bench.set(TXBAR, 1 << buffer);
        bench.wait(10 * BIT_NS);
    }
    bench.wait(1_000_000);
    assert_eq!(bench.sent(), ids(&[0x300, 0x100, 0x200]));
    assert_eq!(bench.get(TXFQS), 0, "empty: put index 0, and level and get index read 0");
}

/// Transmit cancellation: at once while it waits; on the wires it goes through, and TXBCF and TXBTO both tell.
#[test]
fn a_cancelled_frame_leaves_or_goes_through() {
    let mut bench = Bench::started(QUEUE, Vec::new());
    for (buffer, id) in [(0, 0x100), (1, 0x200)] {
        bench.fill(buffer, id, false);
        bench.set(TXBAR, 1 << buffer);
    }
    bench.wait(10 * BIT_NS);
    bench.set(TXBCR, 0b11);
    assert_eq!((bench.get(TXBRP), bench.get(TXBCF)), (0b01, 0b10));
    bench.wait(1_000_000);
    assert_eq!(bench.sent(), ids(&[0x100]));
    assert_eq!((bench.get(TXBRP), bench.get(TXBCF), bench.get(TXBTO)), (0, 0b11, 0b01));
    assert_ne!(bench.get(IR) & 1 << 10, 0, "TCF");
    // A new request takes both flags back.
    bench.fill(0, 0x100, false);
    bench.set(TXBAR, 1);
    assert_eq!((bench.get(TXBCF), bench.get(TXBTO)), (0b10, 0));
}

/// Tx events: marker, identifier, full and lost.
#[test]
fn tx_events_are_stored_until_the_fifo_is_full() {
    let mut bench = Bench::started(0, Vec::new());
    for buffer in 0..3 {
        bench.fill(buffer, 0x123, true);
        bench.set(TXBAR, 1 << buffer);
    }
    bench.wait(1_000_000);
    assert_eq!(bench.get(TXEFS), 1 << 25 | 1 << 24 | 2, "two of two, one lost; put index wrapped");
    assert_eq!(bench.get(IR) >> 12 & 0b1111, 0b1111, "new, watermark, full, lost");
    assert_eq!(bench.word(EVENTS), 0x123 << 18);
    assert_eq!(bench.word(EVENTS + 2 + 1) >> 24, 1, "marker of the second");
    assert_eq!(bench.word(EVENTS + 1) >> 22 & 0b11, 1, "event type: Tx event");
    bench.set(TXEFA, 1);
    assert_eq!(bench.get(TXEFS) & 0x3F, 0, "both acknowledged by the index of the last");
}
