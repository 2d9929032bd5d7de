//! The bus from the module to the gripper's controller: the firmware's messages as CAN frames on the simulated bus,
//! and the library's receiver at its other end.

use std::collections::VecDeque;

use anyhow::{Result, anyhow};
use slipsense::board::TxSlot;
use slipsense::wire::{
    CanFrame, Detail, NodeId, RawBuffer, RawForm, RawFrame, Received, Receiver, SlipMessage, Transmitter,
};
use slipsense_can_sim::busload::CLOCK_HZ;
use slipsense_can_sim::controller::{Arrived, Bus, Disturbance, Timing};

const RATES_BPS: (u32, u32) = (1_000_000, 8_000_000);
/// In this form three sensors fit on such a bus.
const RAW_FORM: RawForm = RawForm::Compressed(Detail::All);

/// A module on a bus, and a receiver.
pub struct Link {
    bus: Bus,
    transmitter: Transmitter,
    receiver: Receiver,
    raw: VecDeque<CanFrame>,
    buffer: RawBuffer,
    now_ns: u64,
}

impl Link {
    /// Other nodes ask for this share of the bus's time, with identifiers between slip and raw messages.
    pub fn new(foreign_percent: u8) -> Result<Self> {
        let timing = Timing::new(CLOCK_HZ, RATES_BPS.0, RATES_BPS.1)
            .map_err(|error| anyhow!("bus of {RATES_BPS:?} bit/s: {error:?}"))?;
        let disturbance =
            Disturbance { foreign_load_percent: foreign_percent.into(), ..Disturbance::default() };
        Ok(Self {
            bus: Bus::new(&timing, disturbance),
            transmitter: Transmitter::new(NodeId::DEFAULT),
            receiver: Receiver::new(NodeId::DEFAULT),
            raw: VecDeque::new(),
            buffer: RawBuffer::new(),
            now_ns: 0,
        })
    }

    /// Hand over the messages of a frame. A slip message that still waits is taken back, as the firmware does;
    /// raw messages that the bus has had no time for are dropped before new ones come.
    pub fn send<'a>(&mut self, slip: &SlipMessage, raw: impl Iterator<Item = RawFrame<'a>>) -> Result<()> {
        let frame = self.transmitter.slip(slip);
        self.bus.withdraw(TxSlot::Slip);
        if !self.bus.is_free(TxSlot::Slip) {
            return Err(anyhow!("frame {}: the slip message before it is still on the bus", slip.sequence));
        }
        self.bus.put(TxSlot::Slip, &frame, self.now_ns);
        self.raw.clear();
        for raw in raw {
            self.raw.extend(self.transmitter.raw_as(RAW_FORM, &raw, &mut self.buffer));
        }
        Ok(())
    }

    /// Let time pass; what arrives meanwhile, with the end of its frame's last bit, nanoseconds since start.
    pub fn advance(&mut self, until_ns: u64) -> Result<Vec<(u64, SlipMessage)>> {
        let mut arrived: Vec<Arrived> = Vec::new();
        loop {
            self.bus.advance(self.now_ns, |frame| arrived.push(frame));
            if self.bus.is_free(TxSlot::Raw)
                && let Some(frame) = self.raw.pop_front()
            {
                self.bus.put(TxSlot::Raw, &frame, self.now_ns);
                continue;
            }
            if self.now_ns >= until_ns {
                break;
            }
            let next_ns = self.bus.next_event_ns().unwrap_or(until_ns);
            self.now_ns = next_ns.clamp(self.now_ns + 1, until_ns);
        }
        let mut received = Vec::new();
        for Arrived { at_ns, frame, .. } in arrived {
            match self.receiver.accept(&frame) {
                Ok(Some(Received::Slip(message))) => received.push((at_ns, message)),
                Ok(_) => {}
                Err(error) => return Err(anyhow!("a frame of the module's: {error}")),
            }
        }
        Ok(received)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_sent_arrives_as_it_was_and_after_the_time_of_its_frame() {
        for (foreign, most_us) in [(0, 150), (100, 300)] {
            let mut link = Link::new(foreign).unwrap();
            let mut received = Vec::new();
            let mut sent_ns = Vec::new();
            for sequence in 0..200u32 {
                let tick_ns = u64::from(sequence) * 4_166_667 + 1_000_000;
                received.extend(link.advance(tick_ns).unwrap());
                let message =
                    SlipMessage { sequence, class: 2, may_begin: true, sensors: 2, ..SlipMessage::default() };
                link.send(&message, std::iter::empty()).unwrap();
                sent_ns.push(tick_ns);
            }
            received.extend(link.advance(2_000_000_000).unwrap());
            assert_eq!(received.len(), 200);
            for ((at_ns, message), (sequence, sent_ns)) in received.iter().zip((0..).zip(sent_ns)) {
                assert_eq!(message.sequence, sequence);
                assert!(message.may_begin && message.sensors == 2);
                let delay_us = (at_ns - sent_ns) / 1000;
                assert!((100..=most_us).contains(&delay_us), "{delay_us} us at {foreign} %");
            }
        }
    }
}
