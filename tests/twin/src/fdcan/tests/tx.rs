//! Sending: queue and cancellation.

use super::*;

/// Tx queue: the smallest identifier of those pending, of equal ones the lowest buffer.
#[test]
fn the_queue_sends_in_the_order_of_identifiers() {
    let mut bench = Bench::started(Vec::new());
    // While the first is on the wires the others queue up behind it.
    for (buffer, id) in [(0, 0x300), (1, 0x200), (2, 0x100)] {
        bench.send(buffer, id);
        bench.wait(10 * BIT_NS);
    }
    bench.wait(1_000_000);
    assert_eq!(bench.sent(), ids(&[0x300, 0x100, 0x200]));
    assert_eq!(bench.get(TXFQS), 0, "empty: put index 0, and level and get index read 0");
}

/// Transmit cancellation: at once while it waits; on the wires it goes through, and TXBCF and TXBTO both tell.
#[test]
fn a_cancelled_frame_leaves_or_goes_through() {
    let mut bench = Bench::started(Vec::new());
    for (buffer, id) in [(0, 0x100), (1, 0x200)] {
        bench.send(buffer, id);
    }
    bench.wait(10 * BIT_NS);
    bench.set(TXBCR, 0b11);
    assert_eq!((bench.get(TXBRP), bench.get(TXBCF)), (0b01, 0b10));
    bench.wait(1_000_000);
    assert_eq!(bench.sent(), ids(&[0x100]));
    assert_eq!((bench.get(TXBRP), bench.get(TXBCF), bench.get(TXBTO)), (0, 0b11, 0b01));
    assert_ne!(bench.get(IR) & 1 << 10, 0, "TCF");
    // A new request takes both flags back.
    bench.send(0, 0x100);
    assert_eq!((bench.get(TXBCF), bench.get(TXBTO)), (0b10, 0));
}

/// What there is no model of is reported: a Tx FIFO, a Tx event, an attempt alone.
#[test]
fn what_has_no_model_is_reported() {
    let requests: [fn(&mut Bench); 3] = [
        |bench| bench.set(TXBC, 3 << 24 | TX << 2),
        |bench| bench.put_word(TX + 1, 1 << 23 | 8 << 16),
        |bench| bench.set(CCCR, INIT | CCE | FDOE | BRSE | 1 << 6),
    ];
    for ask in requests {
        let mut bench = Bench::configured(Vec::new());
        ask(&mut bench);
        let control = bench.get(CCCR);
        bench.set(CCCR, control & !(INIT | CCE));
        bench.set(TXBAR, 1);
        assert!(bench.tells("no model"));
    }
}
