//! Registers that cannot be written.

use heapless::Vec;

use super::super::counters::Counters;
use super::super::identity::Identity;
use super::super::lock::CHALLENGE_BYTES;
use crate::calibration::{Progress, Summary};
use crate::health::{SelfChecks, Status};
use crate::params::{MAX_SENSORS, TAXEL_ROWS};
use crate::settings::{ELEMENTS_MAX, Kind};

#[derive(Clone, Copy)]
pub(super) enum ReadOnly {
    LateFrames,
    Overruns,
    WorstFrame,
    RawDropped,
    BusOff,
    SensorHealth,
    LastPanic,
    Restart,
    OptionBytes,
    FlashErrors,
    RamErrors,
    LostReceived,
    Uptime,
    SelfTests,
    SelfChecks,
    TransfersDropped,
    TransferErrors,
    AddressConflicts,
    SettingsDamage,
    Stuck(usize),
    Calibration(usize),
    Measurement,
    ModelHash,
    TimeOffset,
    Locked,
    Challenge,
}

/// Names in the order of the list.
pub(super) const READ_ONLY: [(&str, ReadOnly); 24 + 2 * MAX_SENSORS] = [
    ("slipsense.status.late_frames", ReadOnly::LateFrames),
    ("slipsense.status.overruns", ReadOnly::Overruns),
    ("slipsense.status.worst_frame_us", ReadOnly::WorstFrame),
    ("slipsense.status.raw_dropped", ReadOnly::RawDropped),
    ("slipsense.status.bus_off", ReadOnly::BusOff),
    ("slipsense.status.sensor_health", ReadOnly::SensorHealth),
    ("slipsense.status.last_panic", ReadOnly::LastPanic),
    ("slipsense.status.restart", ReadOnly::Restart),
    ("slipsense.status.option_bytes", ReadOnly::OptionBytes),
    ("slipsense.status.flash_errors", ReadOnly::FlashErrors),
    ("slipsense.status.ram_errors", ReadOnly::RamErrors),
    ("slipsense.status.received_lost", ReadOnly::LostReceived),
    ("slipsense.status.uptime_s", ReadOnly::Uptime),
    ("slipsense.status.self_tests", ReadOnly::SelfTests),
    ("slipsense.status.self_checks", ReadOnly::SelfChecks),
    ("slipsense.status.transfers_dropped", ReadOnly::TransfersDropped),
    ("slipsense.status.transfer_errors", ReadOnly::TransferErrors),
    ("slipsense.status.address_conflicts", ReadOnly::AddressConflicts),
    ("slipsense.status.settings_damage", ReadOnly::SettingsDamage),
    ("slipsense.sensor.0.stuck", ReadOnly::Stuck(0)),
    ("slipsense.sensor.1.stuck", ReadOnly::Stuck(1)),
    ("slipsense.sensor.2.stuck", ReadOnly::Stuck(2)),
    ("slipsense.sensor.0.calibration", ReadOnly::Calibration(0)),
    ("slipsense.sensor.1.calibration", ReadOnly::Calibration(1)),
    ("slipsense.sensor.2.calibration", ReadOnly::Calibration(2)),
    ("slipsense.status.measurement", ReadOnly::Measurement),
    ("slipsense.model.hash", ReadOnly::ModelHash),
    ("slipsense.time.offset_us", ReadOnly::TimeOffset),
    ("slipsense.status.locked", ReadOnly::Locked),
    ("slipsense.lock.challenge", ReadOnly::Challenge),
];

const _: () = assert!(TAXEL_ROWS <= ELEMENTS_MAX);

pub(in crate::node) struct NodeState<'a> {
    pub status: &'a Status,
    pub identity: &'a Identity,
    pub uptime_s: u32,
    pub counters: Counters,
    pub time_offset_us: Option<i64>,
    pub locked: bool,
    /// `None`: nothing unlocks this board.
    pub challenge: Option<[u8; CHALLENGE_BYTES]>,
}

/// A value, numbers or bytes.
pub(super) enum Answer<'a> {
    Numbers(Kind, Vec<i64, ELEMENTS_MAX>),
    Bytes(&'a [u8]),
}

impl<'a> NodeState<'a> {
    pub(super) fn answer(&'a self, what: ReadOnly) -> Answer<'a> {
        let status = self.status;
        let count = |value: u32| numbers(Kind::Natural32, &[value.into()]);
        match what {
            ReadOnly::LateFrames => count(status.late_frames),
            ReadOnly::Overruns => count(status.dropped_frames),
            ReadOnly::WorstFrame => count(status.worst_frame_us),
            ReadOnly::RawDropped => count(status.dropped_raw.saturating_add(status.broken_raw)),
            ReadOnly::BusOff => count(status.bus_offs),
            ReadOnly::SensorHealth => {
                numbers(Kind::Natural8, &status.sensor_health.map(|health| health.0.into()))
            }
            ReadOnly::LastPanic => count(status.last_panic),
            ReadOnly::Restart => numbers(Kind::Natural32, &status.restart.map(i64::from)),
            ReadOnly::OptionBytes => numbers(Kind::Natural8, &status.option_bytes.map(i64::from)),
            ReadOnly::FlashErrors => numbers(Kind::Natural32, &status.flash_errors.map(i64::from)),
            ReadOnly::RamErrors => numbers(Kind::Natural32, &status.ram_errors.map(i64::from)),
            ReadOnly::LostReceived => count(status.lost_received),
            ReadOnly::Uptime => count(self.uptime_s),
            ReadOnly::SelfTests => {
                numbers(Kind::Natural32, &[status.self_tests.into(), status.failed_self_tests.into()])
            }
            ReadOnly::SelfChecks => {
                let SelfChecks { passes, inferences, failed } = status.self_checks;
                numbers(Kind::Natural32, &[passes, inferences, failed.into()].map(i64::from))
            }
            ReadOnly::TransfersDropped => count(self.counters.dropped_transfers),
            ReadOnly::TransferErrors => count(self.counters.transfer_errors),
            ReadOnly::AddressConflicts => count(self.counters.address_conflicts),
            ReadOnly::SettingsDamage => count(self.identity.settings.damage.settings),
            ReadOnly::Stuck(sensor) => {
                let rows = status.stuck_taxels.get(sensor).copied().unwrap_or_default();
                numbers(Kind::Natural32, &rows.0.map(i64::from))
            }
            ReadOnly::Calibration(sensor) => {
                let Summary { version, id, faulty, noise } =
                    status.calibrations.get(sensor).copied().unwrap_or_default();
                numbers(Kind::Natural32, &[version, id, faulty, noise].map(i64::from))
            }
            ReadOnly::Measurement => {
                let Progress { sensor, state, frames, wanted, at: (row, col) } = status.measurement;
                let [sensor, state, row, col] = [sensor, state as u8, row, col].map(i64::from);
                numbers(Kind::Natural16, &[sensor, state, frames.into(), wanted.into(), row, col])
            }
            // Empty: there is no readable model.
            ReadOnly::ModelHash => {
                Answer::Bytes(self.identity.model_hash.as_ref().map_or(&[], |hash| &hash[..]))
            }
            // 0 also where no master was received; the timestamp of the answer, 0 then, tells them apart.
            ReadOnly::TimeOffset => numbers(Kind::Integer64, &[self.time_offset_us.unwrap_or(0)]),
            ReadOnly::Locked => numbers(Kind::Bit, &[self.locked.into()]),
            ReadOnly::Challenge => Answer::Bytes(self.challenge.as_ref().map_or(&[], |bytes| &bytes[..])),
        }
    }
}

fn numbers<'a>(kind: Kind, values: &[i64]) -> Answer<'a> {
    // The longest is a mask, asserted above.
    Answer::Numbers(kind, Vec::from_slice(values).unwrap_or_default())
}
