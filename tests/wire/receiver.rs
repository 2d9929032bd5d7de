//! What a bus does to frames: loss, repetition, disorder, damage. That no frames make the receiver panic is shown in
//! `host-tools/recording`.

use proptest::prelude::*;
use slipsense::sensor::PiezoFrame;
use slipsense::wire::{
    CanFrame, Check, FlagState, Frames, IdError, MessageId, NodeId, Priority, RAW_PORT, RawBuffer,
    Reassembler, ReceiveError, Received, Receiver, SlipMessage, SlipReceiver, Transfer, TransferError,
    Transmitter,
};

use super::{NODE, expected, frame, raw};

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// A good transfer is received whatever the bus carried before it.
    #[test]
    fn damage_never_sticks(
        parts in raw(),
        noise in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>(), any::<u8>()), 0..80),
    ) {
        let mut transmitter = Transmitter::new(NODE);
        let mut buffer = RawBuffer::new();
        let mut receiver = Receiver::new(NODE);
        let damaged: Vec<_> = transmitter.raw(&frame(&parts), &mut buffer).collect();
        for (index, place, change) in noise {
            let frame = index.get(&damaged);
            let mut data = frame.data().to_vec();
            let place = usize::from(place) % data.len();
            data[place] ^= change;
            let _ = receiver.accept(&CanFrame::new(frame.id(), &data).unwrap());
        }
        let mut arrived = None;
        // Two, because the noise may have completed a transfer with the identifier of the first.
        for _ in 0..2 {
            for frame in transmitter.raw(&frame(&parts), &mut buffer) {
                arrived = receiver.accept(&frame).ok().flatten().or(arrived);
            }
        }
        prop_assert_eq!(arrived, Some(Received::Raw(expected(&parts))));
    }
}

/// Raw transfers 0, 1, 2, … of 26 frames, each with the sequence number of the transfer.
fn transfers(count: u32) -> Vec<Vec<CanFrame>> {
    let mut transmitter = Transmitter::new(NODE);
    let mut buffer = RawBuffer::new();
    let transfer = |sequence: u32| {
        let scan = PiezoFrame::from_scan(std::array::from_fn(|i| (i as u32 * 7 + sequence) as u16));
        // Samples that differ, so that no two frames carry the same bytes.
        let samples = (0..33).map(|i| [i, sequence as i16, 3 * i]).collect();
        let parts = (1, sequence, 0, 0, Some(scan), Some(samples), 0);
        transmitter.raw(&frame(&parts), &mut buffer).collect()
    };
    (0..count).map(transfer).collect()
}

/// The sequence numbers that arrive and the transfer errors, each in order.
fn receive<'a>(
    receiver: &mut Receiver,
    frames: impl IntoIterator<Item = &'a CanFrame>,
) -> (Vec<u32>, Vec<TransferError>) {
    let (mut arrived, mut errors) = (Vec::new(), Vec::new());
    for frame in frames {
        match receiver.accept(frame) {
            Ok(Some(Received::Raw(raw))) => arrived.push(raw.sequence),
            Ok(None) => {}
            Err(ReceiveError::Transfer { port: RAW_PORT, error }) => errors.push(error),
            other => panic!("{other:?}"),
        }
    }
    (arrived, errors)
}

#[test]
fn a_missing_frame_loses_its_transfer_only() {
    let sent = transfers(3);
    let transfer = 1;
    for missing in 0..26 {
        let mut receiver = Receiver::new(NODE);
        let mut damaged = sent[1].clone();
        damaged.remove(missing);
        let expected = match missing {
            0 => vec![TransferError::NotStarted { transfer }; 25],
            // Nothing tells that the last frame will not come.
            25 => vec![],
            // The frame after the gap has the wrong toggle bit. The rest fits again, up to the CRC.
            // Before the last frame there is no rest.
            24 => vec![TransferError::Toggle { transfer }],
            _ => vec![TransferError::Toggle { transfer }, TransferError::Crc { transfer }],
        };
        let received = receive(&mut receiver, sent[0].iter().chain(&damaged).chain(&sent[2]));
        assert_eq!((received, receiver.missed()), ((vec![0, 2], expected), 1), "frame {missing}");
    }
}

/// What arrives of two transfers, the first of which is damaged.
fn receive_damaged(
    sent: &[Vec<CanFrame>],
    damage: impl FnOnce(&mut Vec<CanFrame>),
) -> (Vec<u32>, Vec<TransferError>) {
    let mut damaged = sent[0].clone();
    damage(&mut damaged);
    receive(&mut Receiver::new(NODE), damaged.iter().chain(&sent[1]))
}

#[test]
fn two_missing_frames_show_in_the_crc() {
    let sent = transfers(2);
    for missing in 1..24 {
        let received = receive_damaged(&sent, |frames| _ = frames.drain(missing..missing + 2));
        assert_eq!(received, (vec![1], vec![TransferError::Crc { transfer: 0 }]));
    }
}

#[test]
fn repeated_frames_are_reported_and_harmless() {
    let sent = transfers(2);
    let transfer = 0;
    for repeated in 0..26 {
        let mut receiver = Receiver::new(NODE);
        let mut twice = sent[0].clone();
        twice.insert(repeated, sent[0][repeated]);
        let expected = match repeated {
            // A first frame starts anew; nothing was lost.
            0 => vec![],
            25 => vec![TransferError::NotStarted { transfer }],
            _ => vec![TransferError::Toggle { transfer }],
        };
        let received = receive(&mut receiver, twice.iter().chain(&sent[1]));
        assert_eq!((received, receiver.missed()), ((vec![0, 1], expected), 0), "frame {repeated}");
    }
    let mut receiver = Receiver::new(NODE);
    let slip = Transmitter::new(NODE).slip(&SlipMessage::default());
    assert!(receiver.accept(&slip).unwrap().is_some());
    let error = receiver.accept(&slip).unwrap_err();
    assert_eq!(error.to_string(), "port 6203, transfer 0 repeated");
}

#[test]
fn reordered_frames_are_never_a_message() {
    let sent = transfers(2);
    for first in 0..25 {
        for second in first + 1..26 {
            let (arrived, errors) = receive_damaged(&sent, |frames| frames.swap(first, second));
            assert_eq!(arrived, [1], "frames {first} and {second} swapped");
            assert!(!errors.is_empty());
        }
    }
}

#[test]
fn a_flipped_bit_is_never_a_message() {
    let sent = transfers(2);
    // A stride coprime to 8 and to 63 visits every bit position and every frame.
    for bit in (0..26 * 63 * 8).step_by(37) {
        let (index, byte, bit) = (bit / 8 / 63, bit / 8 % 63, bit % 8);
        let received = receive_damaged(&sent, |frames| {
            let mut data = frames[index].data().to_vec();
            data[byte] ^= 1 << bit;
            frames[index] = CanFrame::new(frames[index].id(), &data).unwrap();
        });
        assert_eq!(received, (vec![1], vec![TransferError::Crc { transfer: 0 }]));
    }
}

#[test]
fn lost_transfers_are_counted() {
    let sent = transfers(70);
    let mut receiver = Receiver::new(NODE);
    let kept = [0, 1, 5, 6, 37, 40, 69];
    let (arrived, errors) = receive(&mut receiver, kept.iter().flat_map(|&index| &sent[index]));
    assert_eq!((arrived, errors), (vec![0, 1, 5, 6, 37, 40, 69], vec![]));
    assert_eq!(receiver.missed(), 3 + 30 + 2 + 28);
    // 32 transfers later the identifier is the same again: no repetition, as the content is another.
    let mut receiver = Receiver::new(NODE);
    assert_eq!(receive(&mut receiver, sent[0].iter().chain(&sent[32])), (vec![0, 32], vec![]));
    assert_eq!(receiver.missed(), 31);
    // Also where a transfer between was cut off.
    let cut_off = sent[0].iter().chain(&sent[1][..2]).chain(&sent[32]);
    assert_eq!(receive(&mut Receiver::new(NODE), cut_off), (vec![0, 32], vec![]));
    // Also where its first frame comes twice.
    let twice = sent[0].iter().chain(&sent[32][..1]).chain(&sent[32]);
    assert_eq!(receive(&mut Receiver::new(NODE), twice), (vec![0, 32], vec![]));
    let (arrived, errors) = receive(&mut Receiver::new(NODE), sent[0].iter().chain(&sent[0]));
    assert_eq!((arrived, errors[0]), (vec![0], TransferError::Repeated { transfer: 0 }));
}

#[test]
fn others_are_passed_over() {
    let mut receiver = Receiver::new(NODE);
    let elsewhere = Transmitter::new(NodeId::new(7).unwrap()).slip(&SlipMessage::default());
    assert_eq!(receiver.accept(&elsewhere), Ok(None));
    let heartbeat = CanFrame::new(0x107D_552A, &[0; 8]).unwrap();
    assert_eq!(receiver.accept(&heartbeat), Ok(None));
    let service = CanFrame::new(0x126B_BDAA, &[0xE0]).unwrap();
    assert_eq!(receiver.accept(&service), Err(ReceiveError::Id(IdError::Service)));
}

#[test]
fn the_reassembler_names_what_is_wrong() {
    let mut session = Reassembler::<100>::new();
    let full = |tail: u8| [vec![1; 63], vec![tail]].concat();
    assert_eq!(session.accept(&[]), Err(TransferError::NoTail));
    assert_eq!(session.accept(&[0b1100_0000]), Err(TransferError::Version));
    assert_eq!(session.accept(&[0, 0b1010_0011]), Err(TransferError::ShortFrame { transfer: 3, length: 2 }));
    let shorter = TransferError::ShortFrame { transfer: 3, length: 48 };
    assert_eq!(session.accept(&full(0b1010_0011)), Ok(None));
    assert_eq!(session.accept(&[vec![1; 47], vec![0b0000_0011]].concat()), Err(shorter));
    assert_eq!(session.accept(&full(0b1010_0011)), Ok(None));
    assert_eq!(session.accept(&full(0b0000_0100)), Err(TransferError::NotStarted { transfer: 4 }));
    let too_long = TransferError::TooLong { transfer: 3, capacity: 100 };
    assert_eq!(session.accept(&full(0b0000_0011)), Err(too_long));
    // It is over: what follows has no start.
    assert_eq!(session.accept(&full(0b0110_0011)), Err(TransferError::NotStarted { transfer: 3 }));
    let empty = Transfer { transfer: 9, missed: 0, payload: &[] };
    assert_eq!(session.accept(&[0b1110_1001]), Ok(Some(empty)));
    let mut shorter = Reassembler::<100>::with_frame_bytes(48);
    assert_eq!(shorter.accept(&[vec![1; 47], vec![0b1010_0011]].concat()), Ok(None));
    // A transfer of 64 bytes is the shortest of two frames.
    let id = MessageId { priority: Priority::Low, port: 1, node: NODE };
    let payload: Vec<u8> = (0..64).collect();
    assert_eq!(Frames::new(id, 12, &payload).size_hint(), (2, Some(2)));
    let frames: Vec<_> = Frames::new(id, 12, &payload).collect();
    assert_eq!(session.accept(frames[0].data()), Ok(None));
    let whole = Transfer { transfer: 12, missed: 2, payload: &payload };
    assert_eq!(session.accept(frames[1].data()), Ok(Some(whole)));
}

/// Silence begins behind the timeout: up to it a message of the same number is one that was there already.
#[test]
fn a_slip_message_at_the_timeout_is_not_yet_after_silence() {
    let frame = Transmitter::new(NODE).slip(&SlipMessage { sequence: 7, ..SlipMessage::default() });
    for (after_us, check) in [(0, Check::Repeated), (1, Check::Ok)] {
        let mut receiver = SlipReceiver::new(NODE);
        assert_eq!(receiver.receive(frame.data(), 1_000), Check::Ok);
        let now_us = 1_000 + SlipReceiver::TIMEOUT_US + after_us;
        assert_eq!(receiver.state(now_us) == FlagState::NoData, after_us > 0);
        assert_eq!(receiver.receive(frame.data(), now_us), check);
    }
}

/// What is said of messages a period apart, each later than its timestamp by a second and so much, and what the flag is
/// after them.
fn delayed(delays_us: [i64; 3]) -> ([Check; 3], FlagState) {
    let (mut receiver, mut transmitter) = (SlipReceiver::new(NODE), Transmitter::new(NODE));
    assert_eq!(receiver.message(), None);
    let mut untied = transmitter.clone().slip(&SlipMessage::default()).data().to_vec();
    *untied.last_mut().unwrap() &= !0x20;
    assert_eq!(receiver.receive(&untied, 0), Check::Error, "toggle 0");
    let mut now_us = 0;
    let checks = std::array::from_fn(|n| {
        let timestamp_us = 4_167 * n as u64;
        now_us = (1_000_000 + timestamp_us).wrapping_add_signed(delays_us[n]);
        let message = SlipMessage { sequence: n as u32, timestamp_us, ..SlipMessage::default() };
        let check = receiver.receive(transmitter.slip(&message).data(), now_us);
        assert_eq!(receiver.message() == Some(&message), check != Check::Delayed);
        check
    });
    (checks, receiver.state(now_us))
}

#[test]
fn delays_and_bursts_are_noticed_to_the_microsecond() {
    use Check::{Delayed, Ok, SomeLost};
    assert_eq!(delayed([0; 3]), ([Ok; 3], FlagState::Valid));
    // 65 µs of the delay may be the clocks'.
    assert_eq!(delayed([0, 12_565, 12_565]).0, [Ok; 3]);
    assert_eq!(delayed([0, 12_566, 0]).0, [Ok, Delayed, SomeLost]);
    // Sooner after the one before than half a period: those before were delayed.
    assert_eq!(delayed([0, 3_000, 3_000 - 2_083]), ([Ok; 3], FlagState::Valid));
    assert_eq!(delayed([0, 3_000, 3_000 - 2_084]), ([Ok; 3], FlagState::Starting));
    // Sooner than the quickest, 8 µs of it the clocks'.
    assert_eq!(delayed([0, -2_075, -2_075]), ([Ok; 3], FlagState::Valid));
    assert_eq!(delayed([0, -2_076, -2_076]), ([Ok; 3], FlagState::Starting));
}
