//! uavcan.time.Synchronization, subject 7168: what time it is for everybody on the bus.
//!
//! A master's message carries the moment at which its *previous* message went out. The node noted when that one arrived;
//! the difference is the offset, as exact as the time at which the user says that a frame was received. The master with
//! the lowest address is followed, another only after it fell silent. An offset that jumps counts when [`JUMP_OFFSETS`]
//! in a row agree: one false message does not move the clock.

use super::fields::Fields;
use crate::wire::NodeId;

/// Subject of uavcan.time.Synchronization.1.0.
pub const TIME_PORT: u16 = 7_168;
/// Longest time between two messages of a master, µs.
const PERIOD_MAX_US: u64 = 1_000_000;
/// A master is silent after this many of its own periods.
const SILENT_PERIODS: u64 = 3;

/// An offset that differs by more from the one in force has jumped, µs.
const JUMP_US: u64 = 1_000;
/// So many offsets in a row must agree on a jump.
pub const JUMP_OFFSETS: u8 = 3;

#[derive(Clone, Copy, Debug)]
struct LastMessage {
    master: NodeId,
    transfer: u8,
    at_us: u64,
    period_us: u64,
}

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct TimeSync {
    last: Option<LastMessage>,
    /// Bus time minus local time; `None` until two consecutive messages were received.
    pub offset_us: Option<i64>,
    /// The last offset that has jumped, and how many agree with it.
    jump: Option<(i64, u8)>,
}

impl TimeSync {
    /// A message arrived, at `now_us` of the local clock.
    pub fn accept(&mut self, master: NodeId, transfer: u8, payload: &[u8], now_us: u64) {
        let mut fields = Fields::new(payload);
        let previous_us = fields.unsigned::<7>();
        if !fields.is_whole() {
            return;
        }
        let mut next = LastMessage { master, transfer, at_us: now_us, period_us: PERIOD_MAX_US };
        if let Some(last) = self.last {
            let since = now_us.saturating_sub(last.at_us);
            let silent = since > SILENT_PERIODS * last.period_us;
            if master != last.master && master > last.master && !silent {
                return;
            }
            let follows = transfer == last.transfer.wrapping_add(1) & 31;
            if master == last.master && follows && since <= PERIOD_MAX_US {
                next.period_us = since;
                if previous_us != 0 {
                    self.measured((previous_us as i64).saturating_sub_unsigned(last.at_us));
                }
            }
        }
        self.last = Some(next);
    }

    fn measured(&mut self, offset_us: i64) {
        let agrees = |other: i64| offset_us.abs_diff(other) <= JUMP_US;
        if self.offset_us.is_some_and(|in_force| !agrees(in_force)) {
            let before = self.jump.filter(|(jumped, _)| agrees(*jumped)).map_or(0, |(_, count)| count);
            self.jump = Some((offset_us, before + 1));
            if before + 1 < JUMP_OFFSETS {
                return;
            }
        }
        self.offset_us = Some(offset_us);
        self.jump = None;
    }
}
