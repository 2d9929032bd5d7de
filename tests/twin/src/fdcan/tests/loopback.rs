//! Test modes: what is sent comes back, and what the wires outside see and say of it.

use super::*;

const TEST: u64 = 0x10;
const MON: u64 = 1 << 5;
const TEST_ENABLE: u64 = 1 << 7;
const LBCK: u64 = 1 << 4;
/// RX, recessive, and TX held dominant.
const RX: u64 = 1 << 7;
const DOMINANT: u64 = 0b10 << 5;

/// Nobody outside acknowledges, and a node outside has something to say.
#[test]
fn a_frame_comes_back_without_acknowledge_and_the_wires_see_it_in_external_mode_only() {
    for monitors in [false, true] {
        let off = Fault { name: "off", kind: Kind::NoAcknowledge, when: 0..u64::MAX };
        let mut bench = Bench::configured(vec![off]);
        let mode = INIT | CCE | FDOE | BRSE | TEST_ENABLE | if monitors { MON } else { 0 };
        bench.set(CCCR, mode);
        bench.set(TEST, LBCK);
        bench.peer(&[standard(0x7FF)]);
        bench.set(CCCR, mode & !(INIT | CCE));
        bench.wait(20 * BIT_NS);
        bench.send(0, 0x123);
        bench.wait(1_000_000);
        assert_eq!((bench.get(TXBRP), bench.get(TXBTO)), (0, 1), "sent");
        assert_eq!(bench.get(RXF0S) & 0x7F, 1, "its own frame alone, not the one outside");
        assert_eq!(bench.word(FIFO0) >> 18, 0x123);
        assert_eq!(bench.word(FIFO0 + 2), 0x5555_5555);
        assert_eq!(bench.get(ECR), 0, "no error is counted");
        // External loop back drives TX; internal, which monitors, holds it recessive.
        assert_eq!(bench.sent(), ids(if monitors { &[] } else { &[0x123] }), "on the wires outside");
    }
}

/// Bus monitoring without loop back: nothing is sent.
#[test]
fn a_monitor_sends_nothing() {
    let mut bench = Bench::configured(Vec::new());
    bench.set(CCCR, INIT | CCE | FDOE | BRSE | MON);
    bench.set(CCCR, FDOE | BRSE | MON);
    bench.send(0, 0x123);
    bench.wait(1_000_000);
    assert_eq!((bench.sent(), bench.get(RXF0S) & 0x7F), (Vec::new(), 0));
}

/// The test register takes writes while CCCR.TEST stands, and forgets them with it.
#[test]
fn loop_back_ends_with_the_test_mode() {
    let mut bench = Bench::new(Vec::new());
    bench.set(TEST, LBCK);
    assert_eq!(bench.get(TEST), RX);
    bench.set(CCCR, INIT | CCE);
    bench.set(CCCR, INIT | CCE | TEST_ENABLE);
    bench.set(TEST, LBCK);
    assert_eq!(bench.get(TEST), LBCK | RX);
    // The transceiver carries TX to RX.
    bench.set(TEST, DOMINANT);
    assert_eq!(bench.get(TEST), DOMINANT);
    bench.set(CCCR, INIT | CCE);
    assert_eq!(bench.get(TEST), RX);
}
