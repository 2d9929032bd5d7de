//! A locked node: what it refuses, who unlocks it, and that nothing else does.

use std::collections::HashSet;
use std::mem::{Discriminant, discriminant};

use ed25519_dalek::{Signer, SigningKey};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slipsense::node::{
    ACCESS_PORT, Action, CALIBRATE, CHALLENGE_BYTES, COMMAND_PORT, HEARTBEAT_PORT, IDENTIFY, Identity, Node,
    RESTART, SCALE_GAIN, SIGNATURE_PAUSE_US, STORE, UNLOCK, UNLOCK_PREFIX,
};
use slipsense::settings::{Setting, Settings, TABLE};
use slipsense::update::{DEVELOPMENT_KEY, DEVELOPMENT_SEED, unlocks};
use slipsense::wire::{MessageId, NodeId};

use super::commands::command;
use super::mutated::{mutate, valid};
use super::registers::access;
use super::{TOOL, ask, hear, identity, records, request};

fn locked_settings() -> Settings {
    crate::settings(&[(Setting::Lock, &[1])])
}

fn locked(entropy: Option<u64>) -> Node {
    let mut node = Node::new(Identity { entropy, ..identity() }, locked_settings());
    node.set_operational();
    node
}

/// The challenge as the bus has it: time, flags, type, length, bytes.
fn challenge(node: &mut Node, transfer: u8) -> [u8; CHALLENGE_BYTES] {
    let answer = ask(node, ACCESS_PORT, transfer, &access("slipsense.lock.challenge", &[0]), 0).unwrap();
    assert_eq!(answer[9..11], [32, 0]);
    answer[11..11 + CHALLENGE_BYTES].try_into().unwrap()
}

fn sign(seed: &[u8; 32], challenge: &[u8; CHALLENGE_BYTES]) -> [u8; 64] {
    SigningKey::from_bytes(seed).sign(&[&UNLOCK_PREFIX[..], challenge].concat()).to_bytes()
}

/// Send a signature, judge it as a board does; the status of the answer.
fn unlock(node: &mut Node, transfer: u8, signature: &[u8; 64], now_us: u64) -> u8 {
    if let Some(answer) = ask(node, COMMAND_PORT, transfer, &command(UNLOCK, signature), now_us) {
        return answer[0];
    }
    let Some(Action::Unlock(signature)) = node.take_action() else { panic!("no attempt") };
    let valid = node.challenge().is_some_and(|challenge| unlocks(&challenge, &signature, &[DEVELOPMENT_KEY]));
    node.unlock_done(valid);
    super::said(node).iter().find_map(|(_, number, bytes)| (*number == transfer).then(|| bytes[0])).unwrap()
}

#[test]
fn a_locked_node_keeps_its_settings_and_takes_no_command() {
    let mut node = locked(Some(1));
    for (index, definition) in TABLE.iter().enumerate() {
        // A natural8: unusable for most, and refused before that is looked at.
        let answer = ask(&mut node, ACCESS_PORT, index as u8, &access(definition.name, &[11, 1, 0, 1]), 0);
        assert!(answer.is_some(), "{}", definition.name);
    }
    let numbers = [RESTART, STORE, 65_532, 65_533, 0, 1, CALIBRATE, SCALE_GAIN];
    for (transfer, number) in (0..).zip(numbers) {
        let answer = ask(&mut node, COMMAND_PORT, transfer, &command(number, b"0 10"), 0).unwrap();
        assert_eq!((answer[0], &answer[2..8]), (5, &b"locked"[..]), "{number}");
    }
    assert_eq!((node.take_action(), node.take_changed(), node.is_locked()), (None, None, true));
    assert_eq!(node.settings(), &locked_settings());
    assert_eq!(ask(&mut node, COMMAND_PORT, 9, &command(IDENTIFY, b""), 0).unwrap()[0], 0);
    assert_eq!(node.take_action(), Some(Action::Identify));
    hear(&mut node, request(ACCESS_PORT, 2, &access("slipsense.raw.divider", &[11, 1, 0, 1])), 0);
    assert_eq!(records(&mut node), ["slipsense.raw.divider: locked, see slipsense.lock"]);
}

#[test]
fn an_update_key_unlocks_once_until_the_next_start() {
    let mut node = locked(Some(7));
    let asked = challenge(&mut node, 0);
    assert_eq!(unlock(&mut node, 1, &sign(&[9; 32], &asked), 0), 1);
    assert!(node.is_locked());
    // Another attempt comes after a pause; a wrong signature does not use the challenge up.
    let valid = sign(&DEVELOPMENT_SEED, &asked);
    assert_eq!(unlock(&mut node, 2, &valid, SIGNATURE_PAUSE_US - 1), 5);
    assert_eq!(unlock(&mut node, 3, &valid, SIGNATURE_PAUSE_US), 0);
    assert!(!node.is_locked());
    assert_ne!(challenge(&mut node, 4), asked);
    assert_eq!(ask(&mut node, COMMAND_PORT, 6, &command(RESTART, b""), 0).unwrap()[0], 0);
    // What was recorded opens no other start, nor a board without random numbers.
    for entropy in [Some(8), None] {
        assert_eq!(unlock(&mut locked(entropy), 7, &valid, 0), 1);
    }
    assert_eq!(locked(None).challenge(), None);
}

/// What a node did while hostile ones sent.
#[derive(Default)]
struct Met {
    frames: u64,
    /// When they left.
    heartbeats_ms: Vec<u64>,
    unlocks: u32,
    actions: HashSet<Discriminant<Action>>,
    changed: u32,
}

/// Milliseconds in which the bus takes one frame of the node: its answers fill the outbox, and heartbeats overtake them.
const BUSY_MS: u32 = 3;

fn meet_hostile(node: &mut Node, transfers: u32) -> Met {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut met = Met::default();
    for transfer in 0..transfers {
        let now_us = u64::from(transfer) * 1_000;
        let (hostile, number) =
            (NodeId::new(random.random_range(0..128)).unwrap_or(TOOL), transfer as u8 & 31);
        let sent = match random.random_range(0..8) {
            0 => request(COMMAND_PORT, number, &command(UNLOCK, &random.random::<[[u8; 32]; 2]>().concat())),
            _ => valid(&mut random, hostile, number, node),
        };
        for frame in sent {
            let damaged = random.random_range(0..4) == 0;
            node.accept(&if damaged { mutate(&mut random, &frame) } else { frame }, now_us);
            met.frames += 1;
        }
        node.poll(now_us);
        let left = if transfer % BUSY_MS == 0 { node.next_frame() } else { None };
        if left.is_some_and(|frame| MessageId::from_can(frame.id()).is_ok_and(|id| id.port == HEARTBEAT_PORT))
        {
            met.heartbeats_ms.push(transfer.into());
        }
        while let Some(action) = node.take_action() {
            met.actions.insert(discriminant(&action));
            match action {
                Action::Unlock(signature) => {
                    met.unlocks += 1;
                    let challenge = node.challenge().unwrap();
                    node.unlock_done(unlocks(&challenge, &signature, &[DEVELOPMENT_KEY]));
                }
                Action::Store | Action::FactoryReset | Action::SelfTest | Action::Calibrate(_) => {
                    node.command_done(Ok(()));
                }
                _ => {}
            }
        }
        met.changed += std::iter::from_fn(|| node.take_changed()).count() as u32;
    }
    met
}

#[test]
fn nothing_that_a_hostile_node_sends_changes_a_locked_one() {
    let transfers: u32 = std::env::var("SLIPSENSE_HOSTILE").map_or(200_000, |text| text.parse().unwrap());
    let mut node = locked(Some(3));
    let met = meet_hostile(&mut node, transfers);
    let harmless = [discriminant(&Action::Unlock([0; 64])), discriminant(&Action::Identify)];
    assert_eq!((met.changed, met.actions.difference(&harmless.into()).count()), (0, 0));
    assert!(node.is_locked() && node.settings() == &locked_settings());
    // One signature a second, and nearly that many are tried.
    let seconds = transfers / 1_000;
    assert!((seconds * 9 / 10..=seconds + 1).contains(&met.unlocks), "{} signatures", met.unlocks);
    // One heartbeat a second, however many answers wait for the bus.
    let beats = &met.heartbeats_ms;
    assert_eq!(beats.len(), transfers.div_ceil(1_000) as usize);
    let late = (0..).zip(beats).map(|(n, ms)| ms - n * 1_000).max().unwrap();
    assert!(late < u64::from(BUSY_MS), "a heartbeat {late} ms late");
    assert!(node.counters().dropped_transfers > transfers / 10, "the outbox was never full");
    println!(
        "{} hostile frames: no state change, {} signatures checked, {} heartbeats, none missing, {late} ms late at most",
        met.frames,
        met.unlocks,
        beats.len()
    );
    // The same traffic changes a node that is not locked, in every way.
    let mut open = Node::new(Identity { entropy: Some(3), ..identity() }, Settings::new());
    let met = meet_hostile(&mut open, transfers.min(200_000));
    assert!(met.changed > 1_000, "{} settings", met.changed);
    // Restart, store, factory reset, self test, calibrate, update.
    assert_eq!(met.actions.difference(&harmless.into()).count(), 6);
}
