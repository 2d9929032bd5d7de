//! Arbitration, acknowledge, errors, bus-off and recovery.

use slipsense_can_sim::{
    Bus, Disturbance, ErrorState, FaultConfinement, Field, Format, Frame, FrameBits, Id, Outcome,
    RECOVERY_BITS, Timing,
};

const NOMINAL: u64 = 80;
const GOOD: Disturbance = Disturbance { wrong_bit: None, no_acknowledge: false };

fn timing() -> Timing {
    Timing::new(80_000_000, 1_000_000, 8_000_000).unwrap()
}

fn wrong(bit: u32) -> Disturbance {
    Disturbance { wrong_bit: Some(bit), ..GOOD }
}

fn frame(id: u16) -> Frame {
    Frame::new(Id::Standard(id), Format::FD, &[0xA5; 64]).unwrap()
}

#[test]
fn the_lowest_identifier_goes_first_and_the_loser_right_after() {
    let mut bus = Bus::<3>::new(timing());
    let (low, high) = (frame(0x100), frame(0x101));
    let first = bus.attempt(0, &[Some(&high), Some(&low), None], GOOD).unwrap().unwrap();
    assert_eq!((first.node, first.start, first.end), (1, 0, timing().frame(&low)));
    let second = bus.attempt(0, &[Some(&high), None, None], GOOD).unwrap().unwrap();
    assert_eq!((second.node, second.start), (0, first.end + 3 * NOMINAL));
    assert!(bus.attempt(0, &[None, None, None], GOOD).unwrap().is_none());
    let clash = bus.attempt(second.end, &[Some(&low), Some(&high), Some(&low)], GOOD).unwrap_err();
    assert_eq!(clash.nodes, (0, 2));
}

/// A frame that arrives while another is on the bus waits for its end, whatever its identifier.
#[test]
fn a_frame_on_the_bus_is_not_interrupted() {
    let mut bus = Bus::<2>::new(timing());
    let (low, high) = (frame(1), frame(0x700));
    let first = bus.attempt(0, &[None, Some(&high)], GOOD).unwrap().unwrap();
    let second = bus.attempt(first.start + 1, &[Some(&low), None], GOOD).unwrap().unwrap();
    assert_eq!(second.start, first.end + 3 * NOMINAL);
}

/// ISO 11898-1: alone on the bus a node counts to 128, becomes error passive, and goes on trying for ever.
#[test]
fn a_node_alone_becomes_passive_and_never_goes_off() {
    let mut bus = Bus::<1>::new(timing());
    let frame = frame(0x123);
    let mut ends = Vec::new();
    for _ in 0..40 {
        let attempt = bus.attempt(0, &[Some(&frame)], GOOD).unwrap().unwrap();
        assert_eq!(attempt.outcome, Outcome::NotAcknowledged);
        ends.push((attempt.start, attempt.end));
    }
    assert_eq!((bus.node(0).transmit_errors(), bus.node(0).state()), (128, ErrorState::Passive));
    // Active: error flag and delimiter, intermission. Passive: 8 bits of silence more.
    let gap = |n: usize| ends[n + 1].0 - ends[n].1;
    assert_eq!((gap(3), gap(30)), (3 * NOMINAL, 11 * NOMINAL));
    let whole = timing().frame(&frame);
    let to_ack = whole - 8 * NOMINAL;
    assert_eq!(ends[0].1 - ends[0].0, to_ack + (6 + 8) * NOMINAL);
}

#[test]
fn errors_put_a_node_off_and_quiet_brings_it_back() {
    let mut bus = Bus::<2>::new(timing());
    let mine = frame(0x10);
    let bits = FrameBits::of(&mine).total();
    let mut attempts = 0;
    let mut now = 0;
    while bus.node(0).state() != ErrorState::BusOff {
        let attempt = bus.attempt(now, &[Some(&mine), None], wrong(bits / 2)).unwrap().unwrap();
        assert_eq!(attempt.outcome, Outcome::Error(Field::Data));
        now = attempt.end;
        attempts += 1;
    }
    assert_eq!(attempts, 32, "256 / 8");
    assert_eq!((bus.node(1).receive_errors(), bus.node(1).state()), (32, ErrorState::Active));
    assert!(bus.attempt(now, &[Some(&mine), None], GOOD).unwrap().is_none());

    // Nothing happens unless its software asks.
    bus.advance(now + 100 * RECOVERY_BITS * NOMINAL);
    assert_eq!(bus.node(0).state(), ErrorState::BusOff);
    now += 100 * RECOVERY_BITS * NOMINAL;
    bus.request_recovery(0, now);
    // Another node's frame in between delays it by all but its recessive end.
    let other = frame(0x20);
    let between = bus.attempt(now, &[None, Some(&other)], GOOD).unwrap().unwrap();
    assert_eq!(between.outcome, Outcome::NotAcknowledged, "the node that is off does not acknowledge");
    let delay = bus.ready(1).unwrap() - now - 11 * NOMINAL;
    let back = now + RECOVERY_BITS * NOMINAL + delay;
    bus.advance(back - 1);
    assert_eq!(bus.node(0).state(), ErrorState::BusOff);
    bus.advance(back);
    assert_eq!((bus.node(0).state(), bus.node(0).transmit_errors()), (ErrorState::Active, 0));
    assert_eq!(bus.attempt(back, &[Some(&mine), None], GOOD).unwrap().unwrap().outcome, Outcome::Sent);
}

/// Where the error is decides what it costs: early ones are cheap.
#[test]
fn an_error_ends_the_frame_where_it_is_seen() {
    let mine = frame(0x10);
    let mut last = 0;
    for bit in 0..FrameBits::of(&mine).total() {
        let mut bus = Bus::<2>::new(timing());
        let attempt = bus.attempt(0, &[Some(&mine), None], wrong(bit)).unwrap().unwrap();
        assert!(matches!(attempt.outcome, Outcome::Error(_)));
        // The switch back from the data rate ends the bit it happens in later than the next would.
        assert!(attempt.end + NOMINAL > last && attempt.end > 20 * NOMINAL);
        last = attempt.end;
    }
    let mut bus = Bus::<2>::new(timing());
    let attempt = bus.attempt(0, &[Some(&mine), None], wrong(100_000)).unwrap().unwrap();
    assert_eq!(attempt.outcome, Outcome::Sent);
    let unheard = Disturbance { no_acknowledge: true, ..GOOD };
    let attempt = bus.attempt(attempt.end, &[Some(&mine), None], unheard).unwrap().unwrap();
    assert_eq!((attempt.outcome, bus.node(0).transmit_errors()), (Outcome::NotAcknowledged, 8));
}

#[test]
fn counters_follow_the_rules() {
    let mut node = FaultConfinement::new();
    for _ in 0..95 {
        node.receive_error();
    }
    assert_eq!((node.receive_errors(), node.warns(), node.state()), (95, false, ErrorState::Active));
    node.receive_error();
    assert_eq!((node.warns(), node.state()), (true, ErrorState::Active));
    for _ in 0..40 {
        node.receive_error();
    }
    assert_eq!((node.receive_errors(), node.state()), (128, ErrorState::Passive));
    node.received();
    assert_eq!((node.receive_errors(), node.state()), (127, ErrorState::Active));
    node.received();
    assert_eq!(node.receive_errors(), 126);
    node.transmitted();
    assert_eq!(node.transmit_errors(), 0);
    for _ in 0..16 {
        node.transmit_error();
    }
    assert_eq!((node.transmit_errors(), node.state()), (128, ErrorState::Passive));
    node.transmitted();
    assert_eq!((node.transmit_errors(), node.state()), (127, ErrorState::Active));
    for _ in 0..16 {
        node.transmit_error();
    }
    assert_eq!((node.transmit_errors(), node.state()), (255, ErrorState::Passive));
    node.not_acknowledged();
    assert_eq!(node.transmit_errors(), 255);
    node.transmit_error();
    assert_eq!(node.state(), ErrorState::BusOff);
}
