//! What the tasks know and the bus wants to: filled by them, read by heartbeat and registers.

use crate::board::Condition;
use crate::params::{MAX_SENSORS, TAXEL_ROWS};
use crate::settings::TaxelMask;
use crate::wire::health;

/// How the board is. The counters count since start and stay at their largest value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Status {
    /// Frames whose decision came after the next tick.
    pub late_frames: u32,
    /// Frames for which acquisition had no buffer.
    pub overruns: u32,
    /// Longest time from a tick to its slip message in the bus queue, µs.
    pub worst_frame_us: u32,
    /// Raw frames dropped whole because the bus could not carry them.
    pub dropped_raw_frames: u32,
    /// How often the CAN controller went bus-off.
    pub bus_off_count: u32,
    /// Health byte of each sensor's last frame, bits of [`health`].
    pub sensor_health: [u8; MAX_SENSORS],
    /// Sensors in use; entries beyond are not looked at.
    pub sensors: usize,
    /// Taxels found stuck or saturated, by sensor.
    pub stuck_taxels: [TaxelMask; MAX_SENSORS],
    /// How the board is by its own judgement; the health in the heartbeat is no better.
    pub condition: Condition,
    /// Why the board started anew: the hash of the panic's reason, 0: no panic.
    pub last_panic: u32,
    /// Self tests since start, and how many of them failed.
    pub self_tests: (u32, u32),
}

impl Status {
    /// Nothing happened yet.
    pub const fn new() -> Self {
        Self {
            late_frames: 0,
            overruns: 0,
            worst_frame_us: 0,
            dropped_raw_frames: 0,
            bus_off_count: 0,
            sensor_health: [0; MAX_SENSORS],
            sensors: 1,
            stuck_taxels: [[0; TAXEL_ROWS]; MAX_SENSORS],
            condition: Condition::Nominal,
            last_panic: 0,
            self_tests: (0, 0),
        }
    }

    /// Bits of [`vendor_status`] that this shows.
    pub(super) fn flags(&self) -> u8 {
        let mut flags = 0;
        let missing = health::PIEZO_MISSING | health::XL_MISSING;
        for health in self.sensor_health.iter().take(self.sensors) {
            if health & missing != 0 {
                flags |= vendor_status::SENSOR_MISSING;
            }
            if health & health::NO_MODEL != 0 {
                flags |= vendor_status::NO_MODEL;
            }
        }
        for (condition, flag) in [
            (self.late_frames > 0 || self.overruns > 0, vendor_status::LATE_FRAMES),
            (self.dropped_raw_frames > 0, vendor_status::RAW_DROPPED),
            (self.bus_off_count > 0, vendor_status::BUS_OFF),
            (self.last_panic != 0, vendor_status::PANICKED),
            (
                self.stuck_taxels.iter().take(self.sensors).flatten().any(|&row| row != 0),
                vendor_status::STUCK,
            ),
        ] {
            if condition {
                flags |= flag;
            }
        }
        flags
    }
}

impl Default for Status {
    fn default() -> Self {
        Self::new()
    }
}

/// Bits of the vendor-specific status code in the heartbeat. Counters behind them are registers.
pub mod vendor_status {
    /// An array or an accelerometer of a sensor in use delivers nothing.
    pub const SENSOR_MISSING: u8 = 1;
    /// There is no readable model: class, flag and logits mean nothing.
    pub const NO_MODEL: u8 = 2;
    /// Frames were late or dropped since start.
    pub const LATE_FRAMES: u8 = 4;
    /// Raw frames were dropped since start.
    pub const RAW_DROPPED: u8 = 8;
    /// The controller was bus-off since start.
    pub const BUS_OFF: u8 = 16;
    /// The last start followed a panic.
    pub const PANICKED: u8 = 32;
    /// Stored settings were damaged; what could not be read is at its default.
    pub const SETTINGS_DAMAGED: u8 = 64;
    /// Taxels are stuck or saturated.
    pub const STUCK: u8 = 128;
}
