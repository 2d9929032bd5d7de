//! The receiver's end of the protected slip message: what each frame was, and whether the flag may be believed now. The
//! faults are those of AUTOSAR's end-to-end protection; `slipsense c-header` prints the same in C.

use super::cyphal::{TAIL_END, TAIL_START, TAIL_TOGGLE};
use super::id::NodeId;
use super::slip::{INVALID_STARTING, SLIP_BYTES, SlipMessage};

/// What a received frame was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Check {
    /// The next message.
    Ok = 0,
    /// A later message; those between, at most [`SlipReceiver::LOST_MAX`], are lost.
    SomeLost = 1,
    /// The message accepted last, once more. Not accepted.
    Repeated = 2,
    /// An earlier message, of an earlier start even, or one too far ahead. Not accepted.
    WrongSequence = 3,
    /// A message that took longer than the quickest by more than [`SlipReceiver::AGE_MAX_US`]. Not accepted.
    Delayed = 4,
    /// Not a slip message of this node: length, tail byte, CRC, or a class without meaning. Not accepted.
    Error = 5,
}

/// May the flag be believed?
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum FlagState {
    /// No message was accepted within [`SlipReceiver::TIMEOUT_US`].
    NoData = 0,
    /// Fewer than [`SlipReceiver::STARTING_MESSAGES`] were accepted in a row, or the sender says that it starts.
    Starting = 1,
    /// Act on it.
    Valid = 2,
    /// The sender says why not: [`SlipMessage::invalid`].
    Invalid = 3,
}

/// Of the slip messages of one node. All times are microseconds of one clock of the receiver, which never goes back.
#[derive(Clone, Debug)]
pub struct SlipReceiver {
    node: NodeId,
    last: Option<SlipMessage>,
    /// When `last` came.
    arrived_us: u64,
    /// Least difference of arrival and timestamp, raised by 1/256 of the time: the clocks may drift so much.
    least_us: u64,
    /// Accepted in a row, up to [`STARTING_MESSAGES`](Self::STARTING_MESSAGES).
    accepted: u8,
    /// Messages that are known to be lost, wraps.
    pub lost: u32,
}

impl SlipReceiver {
    /// Three periods.
    pub const TIMEOUT_US: u64 = 12_500;
    /// Three periods.
    pub const AGE_MAX_US: i64 = 12_500;
    /// Half a period: what the quickest messages may differ by.
    pub const JITTER_US: i64 = 2_083;
    /// As many as fit into the timeout.
    pub const LOST_MAX: u32 = 2;
    /// From silence to a flag that may be believed.
    pub const STARTING_MESSAGES: u8 = 3;

    /// Before the first message of `node`.
    pub const fn new(node: NodeId) -> Self {
        Self { node, last: None, arrived_us: 0, least_us: 0, accepted: 0, lost: 0 }
    }

    /// Take the data of a frame with the slip message's identifier and the node's address.
    pub fn receive(&mut self, data: &[u8], now_us: u64) -> Check {
        let single = TAIL_START | TAIL_END | TAIL_TOGGLE;
        let fields = match data.split_last() {
            Some((tail, fields)) if fields.len() == SLIP_BYTES && tail & single == single => fields,
            _ => return Check::Error,
        };
        let Ok(message) = SlipMessage::decode(self.node, fields) else { return Check::Error };
        let offset_us = now_us.wrapping_sub(message.timestamp_us);
        let since_us = now_us.saturating_sub(self.arrived_us);
        let (mut lost, mut late_us, mut accepted) = (0, 0, 0);
        if let Some(last) = &self.last {
            let silent = since_us > Self::TIMEOUT_US;
            let restarts = message.starts.wrapping_sub(last.starts);
            if restarts == 0 && !silent {
                match message.sequence.wrapping_sub(last.sequence) {
                    0 => return Check::Repeated,
                    ahead @ 1.. if ahead <= Self::LOST_MAX + 1 => lost = ahead - 1,
                    _ => return Check::WrongSequence,
                }
                accepted = self.accepted;
            } else if restarts > u8::MAX / 2 && !silent {
                return Check::WrongSequence;
            }
            // Without its supply a sender forgets its starts, and its clock.
            if restarts == 0 && message.timestamp_us > last.timestamp_us {
                let least_us = self.least_us.wrapping_add(since_us / 256);
                late_us = offset_us.wrapping_sub(least_us) as i64;
                let before_us = self.arrived_us.wrapping_sub(last.timestamp_us);
                let slower_us = offset_us.wrapping_sub(before_us) as i64;
                let starting = accepted < Self::STARTING_MESSAGES && slower_us < -Self::JITTER_US;
                if starting || late_us < -Self::JITTER_US {
                    // Then those before were delayed: what waited somewhere comes in a burst.
                    accepted = 0;
                }
            }
        }
        if late_us > Self::AGE_MAX_US {
            return Check::Delayed;
        }
        self.lost = self.lost.wrapping_add(lost);
        self.least_us = offset_us.wrapping_sub(late_us.max(0) as u64);
        self.accepted = (accepted + 1).min(Self::STARTING_MESSAGES);
        self.arrived_us = now_us;
        self.last = Some(message);
        if lost > 0 { Check::SomeLost } else { Check::Ok }
    }

    /// May the flag of [`message`](Self::message) be believed at this time?
    pub fn state(&self, now_us: u64) -> FlagState {
        match &self.last {
            Some(last) if now_us.saturating_sub(self.arrived_us) <= Self::TIMEOUT_US => {
                if last.invalid & !INVALID_STARTING != 0 {
                    FlagState::Invalid
                } else if last.invalid != 0 || self.accepted < Self::STARTING_MESSAGES {
                    FlagState::Starting
                } else {
                    FlagState::Valid
                }
            }
            _ => FlagState::NoData,
        }
    }

    /// The message accepted last.
    pub const fn message(&self) -> Option<&SlipMessage> {
        self.last.as_ref()
    }

    /// Act: the flag is up and may be believed.
    pub fn slip(&self, now_us: u64) -> bool {
        self.state(now_us) == FlagState::Valid && self.last.is_some_and(|last| last.slip)
    }
}
