//! Service calls, messages without a sender, and several senders at once.

use slipsense::wire::{
    AnonymousId, CanFrame, Frames, IdError, MessageId, NodeId, Priority, ServiceId, ServiceRole,
    SessionError, Sessions, TRANSFER_TIMEOUT_US, TransferError, TransferId,
};

use super::NODE;

fn service(role: ServiceRole, port: u16, destination: u8, source: u8) -> ServiceId {
    let (destination, source) = (NodeId::new(destination).unwrap(), NodeId::new(source).unwrap());
    ServiceId { priority: Priority::Nominal, role, port, destination, source }
}

#[test]
fn identifiers_are_those_of_the_specification() {
    // GetInfo, nominal, from 123 to 42 and back: the example of the specification, section 4.2.
    assert_eq!(service(ServiceRole::Request, 430, 42, 123).to_can(), 0x136B_957B);
    let response = service(ServiceRole::Response, 430, 123, 42);
    assert_eq!(response.to_can(), 0x126B_BDAA);
    assert_eq!(service(ServiceRole::Request, 430, 42, 123).response(), response);
    for role in [ServiceRole::Request, ServiceRole::Response] {
        for port in [0, 1, 384, 511] {
            for (destination, source) in [(0, 127), (127, 0), (42, 43)] {
                let id = service(role, port, destination, source);
                assert_eq!(TransferId::from_can(id.to_can()), Ok(TransferId::Service(id)));
                assert_eq!(TransferId::from_can(id.to_can() | 1 << 23), Err(IdError::Reserved));
            }
        }
    }
    let own = service(ServiceRole::Request, 1, 5, 5);
    assert_eq!(TransferId::from_can(own.to_can()), Err(IdError::Reserved));
    let anonymous = AnonymousId { priority: Priority::Slow, port: 8_165, pseudo_source: 77 };
    assert_eq!(TransferId::from_can(anonymous.to_can()), Ok(TransferId::Anonymous(anonymous)));
    assert_eq!(MessageId::from_can(anonymous.to_can()), Err(IdError::Anonymous));
    let message = MessageId { priority: Priority::High, port: 7_509, node: NODE };
    assert_eq!(TransferId::from_can(message.to_can()), Ok(TransferId::Message(message)));
    assert_eq!(TransferId::from_can(1 << 29), Err(IdError::TooLarge { id: 1 << 29 }));
}

fn frames(source: u8, transfer: u8, bytes: &[u8]) -> Vec<CanFrame> {
    Frames::new(service(ServiceRole::Request, 384, 42, source), transfer, bytes).collect()
}

fn accept<const N: usize>(
    sessions: &mut Sessions<N, 567>,
    frame: &CanFrame,
    now_us: u64,
) -> Result<Option<Vec<u8>>, SessionError> {
    let id = TransferId::from_can(frame.id()).unwrap();
    sessions.accept(id, frame, now_us).map(|arrived| arrived.map(|whole| whole.payload.to_vec()))
}

#[test]
fn transfers_of_several_senders_are_put_together() {
    let mut sessions = Sessions::<4, 567>::new();
    let sent: Vec<_> = (1..5u8).map(|source| frames(source, 7, &[source; 300])).collect();
    for index in 0..5 {
        for (source, frames) in (1..5u8).zip(&sent) {
            assert_eq!(frames[index].ends_transfer(), index == 4);
            let arrived = accept(&mut sessions, &frames[index], 10).unwrap();
            let whole = arrived.map(|bytes| bytes[..300] == [source; 300]);
            assert_eq!(whole, (index == 4).then_some(true));
        }
    }
    assert_eq!(sessions.displaced, 0);
}

#[test]
fn a_client_that_starts_anew_is_heard_after_two_seconds() {
    let mut sessions = Sessions::<2, 567>::new();
    let frame = frames(1, 0, b"first").remove(0);
    assert!(accept(&mut sessions, &frame, 0).unwrap().is_some());
    let repeated = Err(SessionError::Transfer(TransferError::Repeated { transfer: 0 }));
    assert_eq!(accept(&mut sessions, &frame, TRANSFER_TIMEOUT_US), repeated);
    assert!(accept(&mut sessions, &frame, TRANSFER_TIMEOUT_US + 1).unwrap().is_some());
}

#[test]
fn a_new_sender_takes_the_place_of_the_one_silent_longest() {
    let mut sessions = Sessions::<3, 567>::new();
    let long: Vec<_> = (1..4u8).map(|source| frames(source, 0, &[source; 300])).collect();
    // Two with a transfer under way, the second silent longer, and one without, the latest of all.
    accept(&mut sessions, &long[1][0], 10).unwrap();
    accept(&mut sessions, &long[0][0], 20).unwrap();
    accept(&mut sessions, &frames(9, 0, b"short")[0], 30).unwrap();
    accept(&mut sessions, &long[2][0], 40).unwrap();
    assert_eq!(sessions.displaced, 0);
    accept(&mut sessions, &frames(10, 0, b"short")[0], 50).unwrap();
    assert_eq!(sessions.displaced, 1);
    let not_started = Err(SessionError::Transfer(TransferError::NotStarted { transfer: 0 }));
    assert_eq!(accept(&mut sessions, &long[1][1], 60), not_started);
    for (index, frame) in long[0].iter().enumerate().skip(1) {
        assert_eq!(accept(&mut sessions, frame, 70).unwrap().is_some(), index == 4);
    }
    let anonymous = AnonymousId { priority: Priority::Slow, port: 1, pseudo_source: 0 };
    let frame = Frames::new(anonymous, 0, b"x").next().unwrap();
    assert_eq!(accept(&mut sessions, &frame, 80), Err(SessionError::Anonymous));
}
