//! uavcan.node.Heartbeat, subject 7509: alive, how well, doing what. Every node sends one a second.

use crate::health::{Condition, NO_MODEL, PIEZO_MISSING, ResetCause, Status, XL_MISSING, bits_if};
use crate::params::TAXEL_ROWS;
use crate::wire::bytes::Writer;

/// Subject of uavcan.node.Heartbeat.1.0.
pub const HEARTBEAT_PORT: u16 = 7_509;
/// Time between two, µs: the largest that the standard allows.
pub const HEARTBEAT_PERIOD_US: u64 = 1_000_000;
/// Bytes of the message.
pub(super) const HEARTBEAT_BYTES: usize = 7;

/// What a node is doing (uavcan.node.Mode.1.0).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
#[expect(missing_docs, reason = "the names are those of the standard")]
pub enum Mode {
    Operational = 0,
    Initialization = 1,
    Maintenance = 2,
    SoftwareUpdate = 3,
}

/// Condition by the bits of the vendor status: no model or no sensor left is the end of the purpose; a missing
/// part, lost settings or a restart after a panic are major; what was late, dropped or stuck is small.
pub(super) fn health(status: &Status, flags: u8) -> Condition {
    const MAJOR: u8 =
        vendor_status::SENSOR_MISSING | vendor_status::SETTINGS_DAMAGED | vendor_status::PANICKED;
    let by_flags = if status.no_sensor_left() || flags & vendor_status::NO_DECISION != 0 {
        Condition::Warning
    } else if flags & MAJOR != 0 {
        Condition::Caution
    } else if flags != 0 {
        Condition::Advisory
    } else {
        Condition::Nominal
    };
    status.condition().max(by_flags)
}

pub(super) fn encode(uptime_s: u32, health: Condition, mode: Mode, flags: u8) -> [u8; HEARTBEAT_BYTES] {
    let mut out = [0; HEARTBEAT_BYTES];
    let mut writer = Writer::new(&mut out);
    writer.put(&uptime_s.to_le_bytes());
    writer.put(&[health as u8, mode as u8, flags]);
    out
}

/// Bits of [`vendor_status`] that this status shows.
pub(super) fn flags(status: &Status) -> u8 {
    let missing = status.any_sensor(PIEZO_MISSING | XL_MISSING) || status.frozen;
    let undecided = status.any_sensor(NO_MODEL) || status.self_checks.failed != 0;
    let dropped = status.dropped_raw > 0 || status.broken_raw > 0 || status.lost_received > 0;
    let panicked = status.last_panic != 0 || status.restart[0] == ResetCause::BrownOut as u32;
    let stuck = status.stuck_taxels.iter().take(status.sensors).any(|mask| mask.0 != [0; TAXEL_ROWS]);
    bits_if(missing, vendor_status::SENSOR_MISSING)
        | bits_if(undecided, vendor_status::NO_DECISION)
        | bits_if(status.late_frames > 0 || status.dropped_frames > 0, vendor_status::LATE_FRAMES)
        | bits_if(dropped, vendor_status::RAW_DROPPED)
        | bits_if(status.bus_offs > 0, vendor_status::BUS_OFF)
        | bits_if(panicked, vendor_status::PANICKED)
        | bits_if(stuck, vendor_status::STUCK)
}

/// Bits of the vendor-specific status code in the heartbeat. Counters behind them are registers.
pub mod vendor_status {
    /// An array or an accelerometer of a sensor in use delivers nothing, or an accelerometer nothing that changes.
    pub const SENSOR_MISSING: u8 = 1;
    /// There is no readable model, or the node's checks of itself have failed: class, flag and logits mean nothing.
    pub const NO_DECISION: u8 = 2;
    /// Frames were late or dropped since start.
    pub const LATE_FRAMES: u8 = 4;
    /// Raw frames were dropped, or frames from the bus lost, since start.
    pub const RAW_DROPPED: u8 = 8;
    /// The controller was bus-off since start.
    pub const BUS_OFF: u8 = 16;
    /// The last start followed a panic, a fault, the watchdog, a brown-out or a wait for the clock.
    pub const PANICKED: u8 = 32;
    /// Stored settings were damaged; what could not be read is at its default.
    pub const SETTINGS_DAMAGED: u8 = 64;
    /// Taxels are stuck or saturated.
    pub const STUCK: u8 = 128;
}
