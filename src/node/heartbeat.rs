//! uavcan.node.Heartbeat, subject 7509: alive, how well, doing what. Every node sends one a second.

use super::status::{Status, vendor_status};
use crate::board::Condition;
use crate::wire::bytes::Writer;

/// Subject of uavcan.node.Heartbeat.1.0.
pub const HEARTBEAT_PORT: u16 = 7_509;
/// Time between two, µs: the largest that the standard allows.
pub const HEARTBEAT_PERIOD_US: u64 = 1_000_000;
/// Bytes of the message.
pub(super) const HEARTBEAT_BYTES: usize = 7;

/// How well a node is (uavcan.node.Health.1.0).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Health {
    /// All is well.
    Nominal = 0,
    /// Something small, nothing is lost.
    Advisory = 1,
    /// Something major, the main purpose is still served.
    Caution = 2,
    /// The main purpose cannot be served.
    Warning = 3,
}

/// What a node is doing (uavcan.node.Mode.1.0).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Mode {
    /// Its work.
    Operational = 0,
    /// Starting.
    Initialization = 1,
    /// Tests or calibration.
    Maintenance = 2,
    /// Taking a new firmware or model in.
    SoftwareUpdate = 3,
}

/// Health by the bits of the vendor status: no model or no sensor left is the end of the purpose; a missing
/// part, lost settings or a restart after a panic are major; what was late, dropped or stuck is small.
pub(super) fn health(status: &Status, flags: u8) -> Health {
    let dead = crate::wire::health::PIEZO_MISSING | crate::wire::health::XL_MISSING;
    let none_left = status.sensor_health.iter().take(status.sensors).all(|health| health & dead == dead);
    let condition = match status.condition {
        Condition::Nominal => Health::Nominal,
        Condition::Advisory => Health::Advisory,
        Condition::Caution => Health::Caution,
        Condition::Warning => Health::Warning,
    };
    condition.max(health_by_flags(none_left, flags))
}

fn health_by_flags(none_left: bool, flags: u8) -> Health {
    if none_left || flags & vendor_status::NO_MODEL != 0 {
        Health::Warning
    } else if flags
        & (vendor_status::SENSOR_MISSING | vendor_status::SETTINGS_DAMAGED | vendor_status::PANICKED)
        != 0
    {
        Health::Caution
    } else if flags != 0 {
        Health::Advisory
    } else {
        Health::Nominal
    }
}

/// The message.
pub(super) fn encode(uptime_s: u32, health: Health, mode: Mode, flags: u8) -> [u8; HEARTBEAT_BYTES] {
    let mut out = [0; HEARTBEAT_BYTES];
    let mut writer = Writer::new(&mut out);
    writer.put(&uptime_s.to_le_bytes());
    writer.put(&[health as u8, mode as u8, flags]);
    out
}
