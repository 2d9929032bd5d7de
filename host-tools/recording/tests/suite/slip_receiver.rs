//! The receivers in Rust and C: against vectors that neither made, and against a bus that does all it should not.
//! `SLIPSENSE_MESSAGES=100000000 cargo test --release -p slipsense-recording slip_receiver -- --nocapture` is the full run.

use std::collections::HashMap;
use std::io::{Read, Write};
use std::process::{Child, Command, Stdio};

use slipsense::wire::{Check, FlagState, NodeId, SlipMessage, SlipReceiver, Transmitter};

use super::c_header::compile;

/// Check, state, act, lost.
type Found = (u8, u8, bool, u32);

struct Receivers {
    rust: SlipReceiver,
    c: Child,
    _folder: tempfile::TempDir,
}

impl Receivers {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let c = Command::new(compile(folder.path())).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn();
        Self { rust: SlipReceiver::new(NodeId::DEFAULT), c: c.unwrap(), _folder: folder }
    }

    fn receive(&mut self, frames: &[(u64, Vec<u8>)]) -> Vec<Found> {
        let record = |(now_us, data): &(u64, Vec<u8>)| {
            let mut record = now_us.to_le_bytes().to_vec();
            record.push(data.len() as u8);
            record.extend(data);
            record.resize(73, 0);
            record
        };
        let records: Vec<u8> = frames.iter().flat_map(record).collect();
        self.c.stdin.as_mut().unwrap().write_all(&records).unwrap();
        let mut answers = vec![[0; 7]; frames.len()];
        self.c.stdout.as_mut().unwrap().read_exact(answers.as_flattened_mut()).unwrap();
        let mut found = Vec::new();
        for ((now_us, data), answer) in frames.iter().zip(answers) {
            let check = self.rust.receive(data, *now_us) as u8;
            let (state, act) = (self.rust.state(*now_us) as u8, self.rust.slip(*now_us));
            let [check_c, state_c, act_c, lost @ ..] = answer;
            let in_c = (check_c, state_c, act_c != 0, u32::from_le_bytes(lost));
            assert_eq!((check, state, act, self.rust.lost), in_c, "Rust and C at {now_us} us");
            found.push(in_c);
        }
        found
    }
}

impl Drop for Receivers {
    fn drop(&mut self) {
        drop(self.c.stdin.take());
        let _ = self.c.wait();
    }
}

#[test]
fn receivers_agree_with_the_vectors() {
    let checks = ["ok", "some lost", "repeated", "wrong sequence", "delayed", "error"];
    let states = ["no data", "starting", "valid", "invalid"];
    let (mut receivers, mut lines) = (Receivers::new(), 0);
    for line in include_str!("../../../../tests/vectors/slip_receiver.txt").lines() {
        let [now_us, hex, check, state, lost, act] = line.split(',').collect::<Vec<_>>().try_into().unwrap();
        let byte = |at| u8::from_str_radix(&hex[at..at + 2], 16).unwrap();
        let data = (0..hex.len()).step_by(2).map(byte).collect();
        let (c, s, a, l) = receivers.receive(&[(now_us.parse().unwrap(), data)])[0];
        let found = (checks[usize::from(c)], states[usize::from(s)], l.to_string(), u8::from(a).to_string());
        assert_eq!(found, (check, state, lost.to_owned(), act.to_owned()), "{line}");
        lines += 1;
    }
    assert_eq!(lines, 38);
}

/// Splitmix64.
struct Draw(u64);

impl Draw {
    fn below(&mut self, end: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        (z ^ (z >> 31)) % end
    }
}

const RESTART: usize = 8;
#[rustfmt::skip]
const FAULTS: [&str; 9] =
    ["none", "1 to 3 bits", "random bytes", "lost", "repeated", "reordered", "delayed", "masqueraded", "restart"];

/// Every message accepted must be one that was sent; every one believed is later than the one before, and not too old.
/// What comes first after a silence cannot be told from a start, so it is accepted, and not believed.
#[test]
fn a_faulty_bus_makes_no_receiver_believe_what_was_not_sent() {
    let messages: u64 = std::env::var("SLIPSENSE_MESSAGES").map_or(50_000, |text| text.parse().unwrap());
    let (mut receivers, mut draw) = (Receivers::new(), Draw(20_261_123));
    let mut sender = Transmitter::new(NodeId::DEFAULT);
    let mut stranger = Transmitter::new(NodeId::new(43).unwrap());
    let (mut sequence, mut starts, mut start_us) = (0u32, 0u8, 0);
    let (mut by_fault, mut undetected) = ([0u64; FAULTS.len()], [0u64; FAULTS.len()]);
    let (mut held, mut stalled): (Option<Vec<u8>>, Vec<Vec<u8>>) = (None, Vec::new());
    // Number and time of what was sent lately.
    let mut sent: HashMap<Vec<u8>, (u64, u64)> = HashMap::new();
    let (mut last, mut accepted) = (0, 0u64);
    for number in 1..=messages {
        let now_us = 1_000_000 + number * 4167;
        let fault = if draw.below(2) == 0 { draw.below(FAULTS.len() as u64) as usize } else { 0 };
        let fault = if fault == RESTART && draw.below(20) > 0 { 0 } else { fault };
        by_fault[fault] += 1;
        sequence = sequence.wrapping_add(1);
        if fault == RESTART {
            (sequence, starts, start_us) = (0, starts.wrapping_add(1), now_us);
            stalled.clear();
        }
        let timestamp_us = now_us - start_us;
        let mut message =
            SlipMessage { timestamp_us, sequence, starts, sensors: 1, ..SlipMessage::default() };
        message.slip = draw.below(2) == 0;
        message.contact[0].sum = draw.below(1 << 22) as u32;
        let good = sender.slip(&message).data().to_vec();
        sent.insert(good[..63].to_vec(), (number, now_us));
        if number.is_multiple_of(10_000) {
            sent.retain(|_, (old, _)| *old + 1000 > number);
        }
        let mut bad = good.clone();
        let mut arrive = Vec::new();
        match fault {
            1 => (0..1 + draw.below(3)).for_each(|_| {
                let bit = draw.below(63 * 8) as usize;
                bad[bit / 8] ^= 1 << (bit % 8);
            }),
            2 => bad[draw.below(63) as usize..63].fill_with(|| draw.below(256) as u8),
            _ => {}
        }
        match fault {
            1 | 2 => arrive.push(bad),
            3 => {}
            4 => arrive.extend([good.clone(), good]),
            5 => arrive.extend(held.replace(good)),
            6 => stalled.push(good),
            7 => arrive.push(stranger.slip(&message).data().to_vec()),
            _ => arrive.extend([good].into_iter().chain(held.take())),
        }
        if !stalled.is_empty() {
            // All wait behind the first.
            stalled.append(&mut arrive);
            if draw.below(5) == 0 {
                arrive = std::mem::take(&mut stalled);
            }
        }
        let at = |(index, data)| (now_us + 200 + 150 * index as u64, data);
        let frames: Vec<_> = arrive.into_iter().enumerate().map(at).collect();
        for ((at_us, data), found) in frames.iter().zip(receivers.receive(&frames)) {
            if found.0 > Check::SomeLost as u8 {
                continue;
            }
            accepted += 1;
            let believed = found.1 == FlagState::Valid as u8;
            match sent.get(&data[..63]) {
                Some((number, sent_us)) => {
                    let aged = (at_us - sent_us) as i64 > SlipReceiver::AGE_MAX_US + SlipReceiver::JITTER_US;
                    undetected[fault] += u64::from(believed && (aged || *number <= last));
                    last = *number;
                }
                None => undetected[fault] += 1,
            }
        }
        assert_eq!(receivers.rust.state(now_us + 60_000), FlagState::NoData);
    }
    for (name, (count, undetected)) in FAULTS.iter().zip(by_fault.iter().zip(undetected)) {
        println!("{name:>14}: {count} messages, {undetected} undetected");
    }
    println!("{accepted} accepted, {} known to be lost", receivers.rust.lost);
    assert_eq!(undetected, [0; FAULTS.len()]);
    assert!(accepted > messages / 4, "{accepted}");
}
