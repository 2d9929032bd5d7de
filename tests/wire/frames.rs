//! What a frame is: lengths, identifiers.

use slipsense::sensor::PiezoFrame;
use slipsense::wire::{
    CAN_ID_MAX, CanFrame, Detail, FD_LENGTHS, IdError, LengthError, MessageId, NodeId, Priority, RAW_PORT,
    RawBuffer, RawForm, SLIP_PORT, SlipMessage, Transmitter, fd_length,
};

use super::{NODE, frame};

#[test]
fn lengths_are_those_of_can_fd() {
    let mut valid = 0;
    for length in 0..=80 {
        let frame = CanFrame::new(1, &vec![7; length]);
        if FD_LENGTHS.iter().any(|&fd| usize::from(fd) == length) {
            assert_eq!(frame.unwrap().data(), vec![7; length]);
            assert_eq!(fd_length(length), Some(length));
            valid += 1;
        } else {
            assert_eq!(frame, Err(LengthError::Length { length }));
            assert!(fd_length(length).is_none_or(|longer| longer > length));
        }
    }
    assert_eq!(valid, 16);
    assert_eq!(fd_length(65), None);
    assert_eq!(CanFrame::new(1 << 29, &[]), Err(LengthError::Id { id: 1 << 29 }));
}

/// Also where the transfer goes on behind a frame's end, as in the shorter ones of compressed messages.
#[test]
fn a_frame_holds_nothing_behind_its_length() {
    let scan = PiezoFrame::from_scan(std::array::from_fn(|i| (i as u16).wrapping_mul(40_503)));
    let parts = (0, 1, 0, 0, Some(scan), Some(vec![[1, -2, 3]; 33]), 33);
    let (mut transmitter, mut buffer) = (Transmitter::new(NODE), RawBuffer::new());
    for form in [RawForm::Plain, RawForm::Compressed(Detail::All)] {
        for sent in transmitter.raw_as(form, &frame(&parts), &mut buffer) {
            assert_eq!(Ok(sent), CanFrame::new(sent.id(), sent.data()));
        }
    }
    assert_eq!(format!("{:?}", CanFrame::new(0x123, &[0xAB, 1]).unwrap()), "00000123##1AB01");
}

#[test]
fn identifiers_round_trip_and_foreign_ones_are_named() {
    // A heartbeat as canadensis sends it: subject 7509, node 42, nominal.
    let heartbeat = MessageId { priority: Priority::Nominal, port: 7_509, node: NODE };
    assert_eq!(heartbeat.to_can(), 0x107D_552A);
    for priority in 0..8u32 {
        for port in [0, 1, SLIP_PORT, RAW_PORT, 8_191] {
            for node in [0, 1, 42, 127] {
                let id = priority << 26 | 3 << 21 | u32::from(port) << 8 | node;
                let message = MessageId::from_can(id).unwrap();
                assert_eq!((message.port, u32::from(message.node.get())), (port, node));
                assert_eq!((message.priority as u32, message.to_can()), (priority, id));
                // A receiver ignores these two bits.
                assert_eq!(MessageId::from_can(id & !(3 << 21)), Ok(message));
            }
        }
    }
    let id = heartbeat.to_can();
    let too_large = IdError::TooLarge { id: 1 << 29 };
    assert_eq!(MessageId::from_can(1 << 29), Err(too_large));
    assert_eq!(too_large.to_string(), "identifier 20000000 has more than 29 bits");
    assert_eq!(MessageId::from_can(CAN_ID_MAX), Err(IdError::Service));
    assert_eq!(MessageId::from_can(id | 1 << 25), Err(IdError::Service));
    assert_eq!(MessageId::from_can(id | 1 << 24), Err(IdError::Anonymous));
    assert_eq!(MessageId::from_can(id | 1 << 23), Err(IdError::Reserved));
    assert_eq!(MessageId::from_can(id | 1 << 7), Err(IdError::Reserved));
    assert_eq!(NodeId::new(128), None);
}

#[test]
fn the_slip_message_wins_the_bus() {
    // The most favourable node for the raw frame, the least for the slip message.
    let slip = Transmitter::new(NodeId::new(127).unwrap()).slip(&SlipMessage::default());
    let mut buffer = RawBuffer::new();
    let mut transmitter = Transmitter::new(NodeId::new(0).unwrap());
    let raw = transmitter.raw(&frame(&(0, 0, 0, 0, None, Some(vec![]), 0)), &mut buffer).next().unwrap();
    assert!(slip.id() < raw.id());
    assert_eq!(raw.id(), 0x1878_3900);
    transmitter.set_node_id(NODE);
    assert_eq!(transmitter.slip(&SlipMessage::default()).id(), 0x0478_3B2A);
}
