//! A million mutated frames: valid requests of every service with bits flipped, lengths changed, frames
//! lost, repeated and swapped, and frames of nothing but chance.
//!
//! What a request may change is decided by [`Oracle`], which puts transfers together and reads them on its
//! own, by the standard's text, and shares no code with the node.

use rand::seq::IndexedRandom;
use rand::{Rng, RngCore, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slipsense::node::{
    ACCESS_PORT, ALLOCATION_PORT, Action, BEGIN_SOFTWARE_UPDATE, CALIBRATE, COMMAND_PORT, FACTORY_RESET,
    FILE_READ_PORT, GET_INFO_PORT, LIST_PORT, Node, RESTART, SCALE_GAIN, SELF_TEST, STORE, TIME_PORT,
};
use slipsense::settings::{Setting, Settings, TABLE, check};
use slipsense::wire::{CAN_ID_MAX, CanFrame, FD_LENGTHS, Frames, NodeId, Priority, ServiceId, ServiceRole};

use super::commands::command;
use super::registers::access;
use super::{NODE, TOOL, hear, identity, message, request};
use crate::crc;

const FRAMES: u32 = 1_000_000;

/// Puts the transfers of requests together, by sender and port, and says what the last one may write.
#[derive(Default)]
struct Oracle {
    /// By identifier without priority and transfer identifier: bytes, next toggle. A start that repeats an old
    /// transfer must not end another one that is under way.
    open: std::collections::HashMap<(u32, u8), (Vec<u8>, bool)>,
}

impl Oracle {
    /// The payload that this frame completes.
    fn accept(&mut self, frame: &CanFrame) -> Option<Vec<u8>> {
        let (&tail, bytes) = frame.data().split_last()?;
        let (start, end, toggle, transfer) =
            (tail & 0x80 != 0, tail & 0x40 != 0, tail & 0x20 != 0, tail & 31);
        if start && !toggle {
            return None;
        }
        let key = (frame.id() & 0x03FF_FFFF, transfer);
        if start {
            self.open.insert(key, (Vec::new(), true));
        }
        let (so_far, next) = self.open.get_mut(&key)?;
        if toggle != *next {
            return None;
        }
        so_far.extend(bytes);
        *next = !*next;
        if !end {
            return None;
        }
        let (mut whole, ..) = self.open.remove(&key)?;
        if !start {
            if crc(&whole) != 0 {
                return None;
            }
            whole.truncate(whole.len() - 2);
        }
        Some(whole)
    }
}

/// The setting and the numbers that a payload for Access asks for, if it is one that may write.
fn asked(payload: &[u8]) -> Option<(Setting, Vec<i64>)> {
    let length = usize::from(*payload.first()?);
    let setting = Setting::from_name(payload.get(1..1 + length)?)?;
    let value = &payload[1 + length..];
    let width = match value.first()? {
        3 => 0,
        4 | 8 => 8,
        5 | 9 => 4,
        6 | 10 => 2,
        7 | 11 => 1,
        _ => return None,
    };
    let signed = (4..=7).contains(&value[0]);
    let (count, rest) = match width {
        0 | 1 => (usize::from(u16::from_le_bytes([*value.get(1)?, *value.get(2)?])), &value[3..]),
        _ => (usize::from(*value.get(1)?), &value[2..]),
    };
    let number = |bytes: &[u8]| {
        let negative = signed && bytes[bytes.len() - 1] & 0x80 != 0;
        let mut wide = if negative { [0xFF; 8] } else { [0; 8] };
        wide[..bytes.len()].copy_from_slice(bytes);
        i64::from_le_bytes(wide)
    };
    let numbers = match width {
        0 => {
            let bytes = rest.get(..count.div_ceil(8))?;
            (0..count).map(|i| i64::from(bytes[i / 8] >> (i % 8) & 1)).collect()
        }
        _ => rest.get(..count * width)?.chunks(width).map(number).collect(),
    };
    Some((setting, numbers))
}

/// Frames of a valid transfer of any service.
pub fn valid(rng: &mut ChaCha8Rng, source: NodeId, transfer: u8, node: &Node) -> Vec<CanFrame> {
    let id = node.node_id().unwrap_or(NODE);
    let to_node = |port, payload: &[u8]| {
        let (priority, role) = match port {
            FILE_READ_PORT => (Priority::Low, ServiceRole::Response),
            _ => (Priority::Nominal, ServiceRole::Request),
        };
        let service = ServiceId { priority, role, port, destination: id, source };
        Frames::new(service, transfer, payload).collect()
    };
    match rng.random_range(0..8) {
        0 => to_node(GET_INFO_PORT, &[]),
        1 => to_node(LIST_PORT, &rng.random_range(0u16..80).to_le_bytes()),
        2 | 3 => {
            let definition = TABLE.choose(rng).unwrap();
            let mut value = Vec::new();
            let count = definition.default.len();
            match definition.kind {
                slipsense::settings::Kind::Bit => value.extend([3, 1, 0, rng.random_range(0..2)]),
                kind => {
                    let bytes = kind.bytes();
                    value.extend([[0, 11, 10, 9, 9][bytes], count as u8]);
                    value.extend((bytes == 1).then_some(0));
                    for element in 0..count {
                        let (min, max) = definition.rule(element).bounds();
                        let number = min + (rng.next_u64() % (max - min + 1) as u64) as i64;
                        value.extend(&number.to_le_bytes()[..bytes]);
                    }
                }
            }
            to_node(ACCESS_PORT, &access(definition.name, &value))
        }
        4 => {
            let numbers =
                [RESTART, STORE, FACTORY_RESET, SELF_TEST, BEGIN_SOFTWARE_UPDATE, CALIBRATE, SCALE_GAIN];
            // Also a path.
            to_node(COMMAND_PORT, &command(*numbers.choose(rng).unwrap(), b"0 10"))
        }
        5 => {
            let bytes: Vec<u8> = (0..rng.random_range(0..=256)).map(|_| rng.random()).collect();
            to_node(FILE_READ_PORT, &[&[0, 0][..], &(bytes.len() as u16).to_le_bytes(), &bytes].concat())
        }
        6 => message(source, TIME_PORT, transfer, &rng.next_u64().to_le_bytes()[..7]),
        _ => message(source, ALLOCATION_PORT, transfer, b"\x2A\x000123456789abcdef"),
    }
}

pub fn mutate(rng: &mut ChaCha8Rng, frame: &CanFrame) -> CanFrame {
    let (mut id, mut data) = (frame.id(), frame.data().to_vec());
    match rng.random_range(0..6) {
        0 => id ^= 1 << rng.random_range(0..29),
        1 => data.truncate(FD_LENGTHS[rng.random_range(0..16)].into()),
        2 => {
            let length: u8 = FD_LENGTHS[rng.random_range(0..16)];
            data.resize(length.into(), rng.random());
        }
        3 => id = rng.random_range(0..=CAN_ID_MAX),
        _ => {}
    }
    for _ in 0..rng.random_range(0..3) {
        let bits = data.len() * 8;
        if bits > 0 {
            let bit = rng.random_range(0..bits);
            data[bit / 8] ^= 1 << (bit % 8);
        }
    }
    while !FD_LENGTHS.contains(&(data.len() as u8)) {
        data.pop();
    }
    CanFrame::new(id & CAN_ID_MAX, &data).unwrap()
}

#[test]
fn a_million_mutated_frames_change_nothing_they_should_not() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let mut node = Node::new(identity(), Settings::new());
    let mut oracle = Oracle::default();
    let (mut writes, mut restarts, mut commands, mut answers, mut now) = (0u32, 0u32, 0u32, 0u64, 0u64);
    let mut queue: Vec<CanFrame> = Vec::new();
    let mut transfers = [0u8; 4];
    for _ in 0..FRAMES {
        if queue.is_empty() {
            let client = rng.random_range(0..4usize);
            let source = NodeId::new(TOOL.get() - client as u8).unwrap();
            queue = valid(&mut rng, source, transfers[client], &node);
            transfers[client] = transfers[client].wrapping_add(1) & 31;
            if rng.random_range(0..8) == 0 && queue.len() > 1 {
                let (a, b) = (rng.random_range(0..queue.len()), rng.random_range(0..queue.len()));
                queue.swap(a, b);
            }
            queue.reverse();
        }
        let next = queue.pop().unwrap();
        let frame = match rng.random_range(0..10) {
            0 => {
                let length: usize = FD_LENGTHS[rng.random_range(0..16)].into();
                let data: Vec<u8> = (0..length).map(|_| rng.random()).collect();
                queue.push(next);
                CanFrame::new(rng.random_range(0..=CAN_ID_MAX), &data).unwrap()
            }
            1..=3 => mutate(&mut rng, &next),
            4 => {
                queue.push(next);
                next
            }
            _ => next,
        };
        now += rng.random_range(0..20_000);
        let before = node.settings().clone();
        node.accept(&frame, now);
        let may = oracle.accept(&frame);

        // A service request to this node, by its identifier.
        let own = u32::from(node.node_id().map_or(255, |id| id.get()));
        let request = frame.id() & 0x0380_0000 == 0x0300_0000 && frame.id() >> 7 & 127 == own;
        let port = (frame.id() >> 14 & 0x1FF) as u16;
        if *node.settings() != before {
            assert!(request, "{frame:?} changed a setting");
            let payload = may.clone().expect("only a whole transfer changes a setting");
            match port {
                ACCESS_PORT => {
                    let (setting, numbers) = asked(&payload).expect("a write");
                    assert_eq!(check(setting, &numbers), Ok(()), "{frame:?}");
                    let mut expected = before;
                    expected.set(setting, &numbers).unwrap();
                    assert_eq!(*node.settings(), expected, "{frame:?}");
                    writes += 1;
                }
                COMMAND_PORT => {
                    assert_eq!(payload[..2], FACTORY_RESET.to_le_bytes());
                    assert_eq!(*node.settings(), Settings::new());
                    commands += 1;
                }
                _ => panic!("{frame:?} changed a setting"),
            }
            assert!(node.take_changed().is_some());
            while node.take_changed().is_some() {}
        }
        node.poll(now);
        while let Some(action) = node.take_action() {
            commands += 1;
            match action {
                Action::Restart => {
                    assert!(may.as_ref().is_some_and(|payload| payload[..2] == RESTART.to_le_bytes()));
                    restarts += 1;
                }
                Action::BeginUpdate { target, file } => node.begin_download(target, file, 10_000),
                Action::Store | Action::FactoryReset | Action::SelfTest | Action::Calibrate(_) => {
                    node.command_done(Ok(()))
                }
                _ => {}
            }
        }
        if let Some(chunk) = node.take_chunk() {
            assert!(chunk.offset < 10_000 && chunk.bytes.len() <= 256);
            node.chunk_done(&chunk, Ok(()));
        }
        while let Some(frame) = node.next_frame() {
            assert!(FD_LENGTHS.contains(&(frame.data().len() as u8)));
            answers += 1;
        }
        // A node that was written the address 65535 or another one keeps the one it has until it restarts.
        assert_eq!(node.node_id(), Some(NODE));
    }
    // It still works.
    hear(&mut node, request(GET_INFO_PORT, 0, &[]), now + 3_000_000);
    assert!(node.next_frame().is_some());
    println!(
        "node: {FRAMES} frames, mutated or of chance: {writes} valid writes, {commands} commands, {restarts} of \
         them restarts, {answers} frames sent, {:?}; no panic, no other change; {} bytes of RAM, all of them in the \
         node",
        node.counters(),
        size_of::<Node>()
    );
    assert!(writes > 1_000 && commands > 1_000 && restarts > 100 && answers > 100_000);
}
