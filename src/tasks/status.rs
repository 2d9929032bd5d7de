//! What the node knows about itself: counters since start, for registers, heartbeat and log.

use crate::board::{CanState, CanStatus, Condition};
use crate::params::MAX_SENSORS;
use crate::pipeline::SensorHealth;
use crate::wire::health;

/// A snapshot. Counters stay at their largest value, but for those of frames, which wrap.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Status {
    /// Frames handed to inference, wraps.
    pub acquired_frames: u32,
    /// Frames for which there was no buffer.
    pub dropped_frames: u32,
    /// Frames decided, wraps.
    pub decided_frames: u32,
    /// Overruns: frames whose decision came more than a frame period after their tick.
    pub late_frames: u32,
    /// Longest time from a tick to the moment at which its slip message could go, µs.
    pub worst_frame_us: u32,
    /// Health of each sensor at the last frame.
    pub health: [SensorHealth; MAX_SENSORS],
    /// Slip messages given up for a newer one. Not one that was taken back too late: it was on the wire and has gone.
    pub replaced_slips: u32,
    /// Raw messages given up before their first CAN frame.
    pub dropped_raw: u32,
    /// Raw messages cut off by bus-off.
    pub broken_raw: u32,
    /// Service frames for which there was no room.
    pub refused_services: u32,
    /// Service frames that the hardware held when the node dropped off the bus.
    pub lost_services: u32,
    /// The node on its bus.
    pub can: CanStatus,
    /// Times that the node has dropped off the bus.
    pub bus_offs: u32,
    /// How long the last time took: from when it was noticed to the first slip message that was handed over after
    /// it, µs. 0 before the first.
    pub bus_off_us: u32,
}

impl Status {
    /// Before the first frame.
    pub const fn new() -> Self {
        Self {
            acquired_frames: 0,
            dropped_frames: 0,
            decided_frames: 0,
            late_frames: 0,
            worst_frame_us: 0,
            health: [SensorHealth(0); MAX_SENSORS],
            replaced_slips: 0,
            dropped_raw: 0,
            broken_raw: 0,
            refused_services: 0,
            lost_services: 0,
            can: CanStatus { state: CanState::ErrorActive, transmit_errors: 0, receive_errors: 0 },
            bus_offs: 0,
            bus_off_us: 0,
        }
    }

    /// How the node is now. What happened once and is over is in the counters.
    pub fn condition(&self) -> Condition {
        let any = |bits: u8| self.health.iter().any(|health| health.0 & bits != 0);
        if any(health::NO_MODEL) || self.can.state == CanState::BusOff {
            Condition::Warning
        } else if any(health::PIEZO_MISSING | health::XL_MISSING) || self.can.state == CanState::ErrorPassive
        {
            Condition::Caution
        } else if self.health.iter().any(|health| health.0 != 0) || self.can.state == CanState::Warning {
            Condition::Advisory
        } else {
            Condition::Nominal
        }
    }
}
