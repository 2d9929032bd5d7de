//! Time and address.

use slipsense::node::{ALLOCATION_PORT, GET_INFO_PORT, JUMP_OFFSETS, Node, REQUEST_PERIOD_MAX_US, TIME_PORT};
use slipsense::settings::{NODE_ID_UNSET, Setting, Settings};
use slipsense::wire::{CanFrame, NodeId, RAW_PORT, SLIP_PORT, TransferId, TransferId::Anonymous};

use super::{NODE, hear, identity, message, node, records, request, said};
use crate::{crc, nameless, settings};

/// A master whose clock is `ahead_us` of the node's sends its n-th message at `at_us`.
fn sync(node: &mut Node, master: u8, n: u8, at_us: u64, previous: Option<u64>, ahead_us: u64) {
    let previous = previous.map_or(0, |at| at + ahead_us);
    hear(node, message(NodeId::new(master).unwrap(), TIME_PORT, n % 32, &previous.to_le_bytes()[..7]), at_us);
}

#[test]
fn two_messages_of_a_master_give_the_time() {
    let mut node = node();
    sync(&mut node, 10, 0, 1_000_000, None, 0);
    assert_eq!(node.bus_time_us(1_000_000), None);
    sync(&mut node, 10, 1, 1_500_000, Some(1_000_000), 777);
    assert_eq!(node.bus_time_us(2_000_000), Some(2_000_777));
    // One message was lost: its successor speaks of a moment that the node did not see.
    sync(&mut node, 10, 3, 2_500_000, Some(2_000_000), 999);
    assert_eq!(node.bus_time_us(2_000_000), Some(2_000_777));
    sync(&mut node, 10, 4, 3_000_000, Some(2_500_000), 999);
    assert_eq!(node.bus_time_us(2_000_000), Some(2_000_999));
    // More than a second: the standard's limit.
    sync(&mut node, 10, 5, 4_100_000, Some(3_000_000), 5);
    assert_eq!(node.bus_time_us(2_000_000), Some(2_000_999));
    // Its clock is set back, behind ours: that counts when it has been said three times.
    sync(&mut node, 10, 6, 4_600_000, None, 0);
    for n in 0..JUMP_OFFSETS {
        assert_eq!(node.bus_time_us(4_600_500), Some(4_601_499));
        let later = 400_000 * u64::from(n);
        let (payload, at) = ((1_000 + later).to_le_bytes(), 5_000_000 + later);
        hear(&mut node, message(NodeId::new(10).unwrap(), TIME_PORT, 7 + n, &payload[..7]), at);
    }
    assert_eq!((node.bus_time_us(4_600_500), node.bus_time_us(10)), (Some(1_500), None));
}

#[test]
fn single_false_times_do_not_move_the_clock() {
    let mut node = node();
    sync(&mut node, 10, 0, 1_000_000, None, 0);
    sync(&mut node, 10, 1, 1_500_000, Some(1_000_000), 777);
    for n in 2..20u8 {
        let at = 1_000_000 + 500_000 * u64::from(n);
        sync(&mut node, 10, n, at, Some(at - 500_000), 10_000 * u64::from(n));
        assert_eq!(node.bus_time_us(0), Some(777));
    }
}

#[test]
fn the_master_with_the_lowest_address_counts() {
    let mut node = node();
    for n in 0..4 {
        let at = 1_000_000 + 500_000 * u64::from(n);
        sync(&mut node, 20, n, at, Some(at - 500_000), 20);
        sync(&mut node, 30, n, at + 10, Some(at + 10 - 500_000), 30);
    }
    assert_eq!(node.bus_time_us(0), Some(20));
    // A lower one displaces it at once, counts from its second message on.
    sync(&mut node, 5, 4, 3_000_000, Some(2_500_000), 5);
    sync(&mut node, 20, 4, 3_000_001, Some(2_500_000), 20);
    assert_eq!(node.bus_time_us(0), Some(20));
    sync(&mut node, 5, 5, 3_500_000, Some(3_000_000), 5);
    assert_eq!(node.bus_time_us(0), Some(5));
    // It falls silent for three of its periods.
    sync(&mut node, 20, 5, 4_999_999, Some(4_500_000), 20);
    assert_eq!(node.bus_time_us(0), Some(5));
    sync(&mut node, 20, 6, 5_100_000, Some(4_999_999), 20);
    assert_eq!(node.bus_time_us(0), Some(5));
    sync(&mut node, 20, 7, 5_600_000, Some(5_100_000), 20);
    assert_eq!(node.bus_time_us(0), Some(20));
}

#[test]
fn time_is_not_followed_where_it_is_switched_off() {
    let mut node = Node::new(identity(), settings(&[(Setting::TimeSync, &[0])]));
    sync(&mut node, 10, 0, 1_000_000, None, 0);
    sync(&mut node, 10, 1, 1_500_000, Some(1_000_000), 777);
    assert_eq!(node.bus_time_us(2_000_000), None);
}

#[test]
fn a_node_without_address_asks_until_it_has_one() {
    let mut node = Node::new(identity(), settings(&[(Setting::NodeId, &[NODE_ID_UNSET])]));
    let mut asked = Vec::new();
    let mut now = 0;
    // xorshift64 from the unique identifier, stirred with the time.
    let unique_id = identity().unique_id;
    let mut chance = u64::from(crc(&unique_id)) << 32 | u64::from(crc(&unique_id[1..])) << 8 | 1;
    while asked.len() < 50 {
        let next = node.poll(now);
        chance ^= now << 1;
        chance ^= chance << 13;
        chance ^= chance >> 7;
        chance ^= chance << 17;
        assert_eq!(next, now + chance % REQUEST_PERIOD_MAX_US);
        for (id, transfer, payload) in said(&mut node) {
            let Anonymous(id) = id else { panic!("{id:?}") };
            assert_eq!((id.port, usize::from(transfer)), (ALLOCATION_PORT, asked.len() % 32));
            assert_eq!(u16::from(id.pseudo_source), crc(&payload[..18]) & 127);
            assert_eq!(payload[..2], 125u16.to_le_bytes());
            assert_eq!(&payload[2..18], b"0123456789abcdef");
            asked.push(now);
        }
        now = next.max(now + 1);
    }
    let gaps: Vec<u64> = asked.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let mean = gaps.iter().sum::<u64>() / gaps.len() as u64;
    assert!((300_000..700_000).contains(&mean), "{mean} µs on average");
    // It has no address, and learns none from another node.
    hear(&mut node, request(GET_INFO_PORT, 0, &[]), now);
    let allocator = NodeId::new(1).unwrap();
    hear(&mut node, message(allocator, ALLOCATION_PORT, 0, b"\x63\x00another unique."), now);
    assert_eq!((node.node_id(), node.is_drained()), (None, true));
    hear(&mut node, message(allocator, ALLOCATION_PORT, 1, b"\x63\x000123456789abcdef"), now);
    assert_eq!(node.node_id(), NodeId::new(99));
    node.poll(now);
    let from_99 = |id: &TransferId| matches!(id, TransferId::Message(id) if id.node.get() == 99);
    assert!(said(&mut node).iter().all(|(id, ..)| from_99(id)));

    let mut silent = Node::new(identity(), nameless());
    (0..100).for_each(|now| _ = silent.poll(now * 100_000));
    hear(&mut silent, message(allocator, ALLOCATION_PORT, 2, b"\x63\x000123456789abcdef"), now);
    assert_eq!((silent.is_drained(), silent.node_id()), (true, None));
}

#[test]
fn a_second_node_with_the_same_address_is_noticed() {
    let mut node = node();
    for n in 0..3 {
        hear(&mut node, message(NODE, 1_000, n, b"not ours"), 0);
    }
    assert_eq!(node.counters().address_conflicts, 3);
    assert_eq!(records(&mut node), ["another node has this address"; 2], "the first and the second");
}

#[test]
fn the_filters_let_through_what_the_node_looks_at_and_little_else() {
    let nameless = Node::new(identity(), settings(&[(Setting::NodeId, &[NODE_ID_UNSET])]));
    let passes =
        |node: &Node, frame: &CanFrame| node.filters().iter().any(|(id, mask)| frame.id() & mask == *id);
    let node = node();
    let other = NodeId::new(43).unwrap();
    // By the identifier's layout: a service bit, an anonymous bit, then subject or destination, then the sender.
    let exact = [(7_168 << 8, 0x031F_FF00), (0x0200_0000 | 42 << 7, 0x0200_3F80), (42, 0x0300_007F)];
    assert_eq!(node.filters(), exact);
    assert_eq!(nameless.filters(), [exact[0], (8_165 << 8, 0x031F_FF00)]);
    let time = &message(other, TIME_PORT, 0, b"1234567")[0];
    let allocation = &message(other, ALLOCATION_PORT, 0, b"1")[0];
    let call = &request(GET_INFO_PORT, 0, &[])[0];
    assert_eq!([time, allocation, call].map(|frame| passes(&node, frame)), [true, false, true]);
    assert_eq!([time, allocation, call].map(|frame| passes(&nameless, frame)), [true, true, false]);
    for port in [SLIP_PORT, RAW_PORT, 7_509] {
        assert!(!passes(&node, &message(other, port, 0, b"1")[0]));
        assert!(passes(&node, &message(NODE, port, 0, b"1")[0]), "address conflict");
    }
    // Whatever the filters hold back changes nothing, not even a counter.
    let mut looked = Node::new(identity(), Settings::new());
    let (before, mut held_back) = (looked.counters(), 0);
    for step in 0..200_000u32 {
        let id = step.wrapping_mul(2_654_435_761) >> 3 & !(1 << 23);
        let frame = CanFrame::new(id, &[0xE0]).unwrap();
        if !passes(&looked, &frame) && TransferId::from_can(id).is_ok() {
            looked.accept(&frame, 0);
            held_back += 1;
        }
    }
    assert_eq!((looked.counters(), looked.is_drained()), (before, true));
    assert!(held_back > 50_000, "{held_back}");
}
