//! An independent transmitter of Cyphal/CAN as oracle: the crate `canadensis_can` 0.6 cuts the same
//! transfers into the same frames, byte for byte.

use std::convert::Infallible;

use canadensis_can::driver::TransmitDriver;
use canadensis_can::{CanNodeId, CanTransferId, CanTransmitter, Frame, Mtu};
use canadensis_core::time::{Clock, Microseconds32};
use canadensis_core::transfer::{Header, MessageHeader, Transfer};
use canadensis_core::transport::Transmitter as _;
use canadensis_core::{OutOfMemoryError, Priority as TheirPriority, SubjectId, nb};
use slipsense::wire::{Frames, MessageId, NodeId, Priority};

struct ZeroClock;

impl Clock for ZeroClock {
    fn now(&mut self) -> Microseconds32 {
        Microseconds32::from_ticks(0)
    }
}

#[derive(Default)]
struct Sent(Vec<Frame>);

impl TransmitDriver<ZeroClock> for Sent {
    type Error = Infallible;

    fn try_reserve(&mut self, _: usize) -> Result<(), OutOfMemoryError> {
        Ok(())
    }

    fn transmit(&mut self, frame: Frame, _: &mut ZeroClock) -> nb::Result<Option<Frame>, Infallible> {
        self.0.push(frame);
        Ok(None)
    }

    fn flush(&mut self, _: &mut ZeroClock) -> nb::Result<(), Infallible> {
        Ok(())
    }
}

const PRIORITIES: [(Priority, TheirPriority); 8] = [
    (Priority::Exceptional, TheirPriority::Exceptional),
    (Priority::Immediate, TheirPriority::Immediate),
    (Priority::Fast, TheirPriority::Fast),
    (Priority::High, TheirPriority::High),
    (Priority::Nominal, TheirPriority::Nominal),
    (Priority::Low, TheirPriority::Low),
    (Priority::Slow, TheirPriority::Slow),
    (Priority::Optional, TheirPriority::Optional),
];

/// The frames that canadensis makes of a transfer.
fn oracle(id: MessageId, transfer: u8, payload: &[u8]) -> Vec<(u32, Vec<u8>)> {
    let mut sent = Sent::default();
    let header = MessageHeader {
        timestamp: Microseconds32::from_ticks(0),
        transfer_id: CanTransferId::try_from(transfer).unwrap(),
        priority: PRIORITIES[id.priority as usize].1,
        subject: SubjectId::try_from(id.port).unwrap(),
        source: Some(CanNodeId::try_from(id.node.get()).unwrap()),
    };
    let transfer = Transfer { header: Header::Message(header), loopback: false, payload };
    CanTransmitter::new(Mtu::CanFd64).push(transfer, &mut ZeroClock, &mut sent).unwrap();
    sent.0.iter().map(|frame| (frame.id().into(), frame.data().to_vec())).collect()
}

#[test]
fn transfers_of_every_length_are_the_oracles() {
    let bytes: Vec<u8> = (0..1_900u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    for length in 0..=bytes.len() {
        let id = MessageId {
            priority: PRIORITIES[length % 8].0,
            port: (length * 31 % 8_192) as u16,
            node: NodeId::new((length % 128) as u8).unwrap(),
        };
        let transfer = (length % 32) as u8;
        let payload = &bytes[..length];
        let ours: Vec<_> = Frames::new(id, transfer, payload).map(|f| (f.id(), f.data().to_vec())).collect();
        assert_eq!(ours, oracle(id, transfer, payload), "{length} bytes");
    }
}
