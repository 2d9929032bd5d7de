//! Errors, bus-off and recovery, and the time that a frame takes.

use super::*;

/// Fault confinement: 8 a failed frame; warning at 96, passive at 128, off at 256, with INIT; back after 129
/// times 11 recessive bits from the end of INIT on.
#[test]
fn errors_lead_to_bus_off_and_back() {
    let end = 20_000_000;
    let jam = Fault { name: "jam", kind: Kind::ErrorFrames { per_million: 1_000_000 }, when: 0..end };
    let mut bench = Bench::started(vec![jam]);
    bench.send(0, 0x10);
    bench.wait(end);
    let attempts = bench.twin.mcu.fdcan[0].wire.log.len();
    assert_eq!(attempts, 32, "256 / 8");
    assert_eq!(bench.get(PSR) & (1 << 5 | 1 << 6 | 1 << 7), 1 << 5 | 1 << 6 | 1 << 7, "EP, EW, BO");
    assert_eq!(bench.get(IR) & 0b111 << 23, 0b111 << 23);
    assert_ne!(bench.get(CCCR) & INIT, 0);
    assert_eq!(bench.get(TXBRP), 1, "the request stays");
    let asked = bench.now;
    bench.set(CCCR, FDOE | BRSE);
    bench.wait(10_000_000);
    let log = &bench.twin.mcu.fdcan[0].wire.log;
    let back = log.get(32).expect("sent after the recovery").start_ns - asked;
    assert!((129 * 11..129 * 11 + 12).contains(&(back / BIT_NS)), "back after {back} ns");
    assert_eq!(bench.get(ECR) & 0xFF, 0);
    assert_eq!(bench.get(PSR) & 1 << 7, 0);
}

/// Without acknowledge the node becomes passive and stays on the bus: an error passive transmitter's counter does not
/// rise for a missing acknowledge (ISO 11898-1, fault confinement, rule c exception 1).
#[test]
fn a_missing_acknowledge_never_leads_to_bus_off() {
    let off = Fault { name: "off", kind: Kind::NoAcknowledge, when: 0..50_000_000 };
    let mut bench = Bench::started(vec![off]);
    bench.send(0, 0x10);
    bench.wait(49_000_000);
    assert_eq!(bench.get(ECR) & 0xFF, 128);
    assert_eq!(bench.get(PSR) & 0b111, 3, "LEC: acknowledge error");
    assert_eq!(bench.get(PSR) & 0b111, 7, "LEC: no change since it was read");
    bench.wait(2_000_000);
    assert_eq!(bench.sent().len(), 1);
    assert_eq!(bench.get(ECR) & 0xFF, 127, "down by one");
}

/// A frame of 64 bytes without a dynamic stuff bit, by hand: 16 bits to `res`, BRS half of each rate, 549 bits at the
/// data rate (ESI, DLC, data, stuff count, CRC-21, 7 fixed stuff bits), CRC delimiter, 9 bits.
#[test]
fn an_fd_frame_takes_the_time_of_its_bits() {
    let mut bench = Bench::started(Vec::new());
    bench.put_word(TX, 0x555 << 18);
    bench.put_word(TX + 1, 1 << 21 | 1 << 20 | 0xF << 16);
    (0..16).for_each(|word| bench.put_word(TX + 2 + word, 0x5555_5555));
    bench.set(TXBAR, 1);
    bench.wait(1_000_000);
    let cycles = 16 * 80 + (64 + 2) + (1 + 4 + 512 + 4 + 21 + 7) * 10 + (8 + 16) + 9 * 80;
    let frame = &bench.twin.mcu.fdcan[0].wire.log[0];
    assert_eq!(frame.frame.format(), Format::FD);
    assert!((frame.end_ns - frame.start_ns).abs_diff(cycles * 1_000_000_000 / CLOCK_HZ) <= 1);
}
