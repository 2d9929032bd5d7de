//! Configuration: what is protected, what it resets, time stamps, interrupt lines.

use super::*;

/// Software initialization: after a reset INIT stands, CCE needs it, and what is protected needs both.
#[test]
fn protected_registers_take_writes_with_init_and_cce_only() {
    let mut bench = Bench::new(Vec::new());
    assert_eq!(bench.get(CCCR), INIT);
    for (register, reset) in [(NBTP, 0x0600_0A03), (DBTP, 0x0A33), (TXBC, 0), (RXF0C, 0), (GFC, 0)] {
        bench.set(register, 0x0011_0010);
        assert_eq!(bench.get(register), reset, "{register:#x} without CCE");
    }
    assert!(bench.tells("CCE"));
    bench.set(CCCR, INIT | CCE);
    bench.set(TXBC, 3 << 24 | TX << 2);
    assert_eq!(bench.get(TXBC), 3 << 24 | TX << 2);
    // INIT falls, CCE with it, and the registers are closed.
    bench.set(CCCR, 0);
    assert_eq!(bench.get(CCCR) & (INIT | CCE), 0);
    bench.set(TXBC, 0);
    assert_eq!(bench.get(TXBC), 3 << 24 | TX << 2);
    // CCE and INIT in one write: CCE is not taken.
    bench.set(CCCR, INIT | CCE);
    assert_eq!(bench.get(CCCR) & (INIT | CCE), INIT);
    // FDOE and BRSE are protected too.
    bench.set(CCCR, INIT | FDOE | BRSE);
    assert_eq!(bench.get(CCCR) & (FDOE | BRSE), 0);
    bench.set(CCCR, INIT | CCE);
    bench.set(CCCR, INIT | CCE | FDOE | BRSE);
    assert_eq!(bench.get(CCCR), INIT | CCE | FDOE | BRSE);
}

/// Setting CCE drops what was pending.
#[test]
fn configuration_resets_requests_and_fifos() {
    let off = Fault { name: "off", kind: Kind::NoAcknowledge, when: 0..u64::MAX };
    let mut bench = Bench::started(vec![off]);
    bench.send(0, 1);
    assert_eq!(bench.get(TXBRP), 1);
    bench.wait(300 * BIT_NS);
    bench.set(CCCR, INIT | FDOE | BRSE);
    bench.set(CCCR, INIT | CCE | FDOE | BRSE);
    assert_eq!(bench.get(TXBRP), 0);
    bench.set(TXBAR, 1);
    assert_eq!(bench.get(TXBRP), 0, "no request while CCE is set");
}

/// FDOE off: a classic frame, whatever the element says; BRS falls with it.
#[test]
fn without_fdoe_frames_are_classic() {
    let mut bench = Bench::configured(Vec::new());
    bench.set(CCCR, INIT | CCE);
    bench.set(CCCR, 0);
    bench.wait(20 * BIT_NS);
    bench.put_word(TX, 0x123 << 18);
    bench.put_word(TX + 1, 1 << 21 | 1 << 20 | 8 << 16);
    bench.set(TXBAR, 1);
    bench.wait(1_000_000);
    assert_eq!(bench.twin.mcu.fdcan[0].wire.log[0].frame.format(), Format::Classic);
}

/// Timestamp counter: nominal bit times, a prescaler, reset by a write; the frame's is that of its start.
#[test]
fn the_timestamp_counts_nominal_bits() {
    let mut bench = Bench::configured(Vec::new());
    bench.set(TSCC, 3 << 16 | 1);
    let at = bench.now + 1_400_000;
    bench.twin.mcu.fdcan[0].wire.peer_queue.push_back((at, standard(1)));
    bench.set(CCCR, FDOE | BRSE);
    bench.wait(1_000_000);
    assert_eq!(bench.get(TSCV), 250);
    bench.set(TSCV, 0);
    assert_eq!(bench.get(TSCV), 0);
    bench.wait(900_000);
    let stamp = bench.word(FIFO0 + 1) & 0xFFFF;
    assert!((100..=101).contains(&stamp), "{stamp}");
}

/// Interrupt registers: a flag reaches the line that ILS names, if IE and ILE let it, until it is cleared.
#[test]
fn flags_reach_the_selected_line() {
    let mut bench = Bench::started(Vec::new());
    bench.set(IE, 1 << 9 | 1 << 10);
    bench.set(ILS, 1 << 10);
    bench.set(ILE, 0b01);
    bench.send(0, 1);
    bench.wait(10 * BIT_NS);
    bench.set(TXBCR, 1);
    bench.wait(1_000_000);
    assert_eq!(bench.get(IR) & (1 << 9 | 1 << 10), 1 << 9 | 1 << 10);
    assert!(bench.line(0) && !bench.line(1), "line 1 is not enabled");
    bench.set(ILE, 0b11);
    assert!(bench.line(1));
    bench.set(IR, 1 << 9);
    assert!(!bench.line(0) && bench.line(1), "a written one clears");
    bench.set(IE, 0);
    assert!(!bench.line(1));
}
