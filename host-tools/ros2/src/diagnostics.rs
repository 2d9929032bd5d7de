//! How each module and each of its sensors is, once a second, for `/diagnostics`.

use std::collections::BTreeMap;

use slipsense::health::{self, Condition};
use slipsense::node::{Mode, vendor_status};
use slipsense::wire::NodeId;
use slipsense_recording::decode::Count;
use slipsense_recording::{DEGRADED, HEALTH, INVALID, words};

use crate::messages::{DiagnosticArray, DiagnosticStatus, Header, KeyValue, frame_of, sensor_frame_of};
use crate::module::Module;

const VENDOR: [(u8, &str); 8] = [
    (vendor_status::SENSOR_MISSING, "a sensor is missing"),
    (vendor_status::NO_DECISION, "no decisions"),
    (vendor_status::LATE_FRAMES, "late frames since start"),
    (vendor_status::RAW_DROPPED, "raw frames dropped since start"),
    (vendor_status::BUS_OFF, "bus-off since start"),
    (vendor_status::PANICKED, "last start after a fault"),
    (vendor_status::SETTINGS_DAMAGED, "settings damaged"),
    (vendor_status::STUCK, "taxels stuck or saturated"),
];
const MODES: [(Mode, &str); 4] = [
    (Mode::Operational, "operational"),
    (Mode::Initialization, "initialization"),
    (Mode::Maintenance, "maintenance"),
    (Mode::SoftwareUpdate, "software update"),
];

const OK: u8 = 0;
const WARN: u8 = 1;
const ERROR: u8 = 2;
const STALE: u8 = 3;

fn values(values: impl IntoIterator<Item = (&'static str, String)>) -> Vec<KeyValue> {
    values.into_iter().map(|(key, value)| KeyValue { key: key.to_owned(), value }).collect()
}

/// All modules, from what they said since the last time.
pub fn array(
    modules: &BTreeMap<NodeId, Module>,
    counts: &BTreeMap<u8, Count>,
    time_us: u64,
) -> DiagnosticArray {
    let mut status = Vec::new();
    for (&node, module) in modules {
        status.push(of_module(node, module, counts.get(&node.get()).copied().unwrap_or_default()));
        let sensors = module.slip.as_ref().map_or(0, |slip| slip.sensors);
        status.extend((0..sensors).map(|sensor| of_sensor(node, sensor, module)));
    }
    DiagnosticArray { header: Header::new(time_us, String::new()), status }
}

fn of_module(node: NodeId, module: &Module, count: Count) -> DiagnosticStatus {
    let second = &module.second;
    let said = module.heartbeat;
    let condition = said.map_or(0, |said| said.health);
    let level = if second.slip_messages == 0 {
        STALE
    } else if second.invalid != 0 || condition >= Condition::Warning as u8 {
        ERROR
    } else if second.degraded != 0 || condition > Condition::Nominal as u8 {
        WARN
    } else {
        OK
    };
    let message = match second.slip_messages {
        0 => "no slip message".to_owned(),
        _ if second.invalid != 0 => format!("flag invalid: {}", words(&INVALID, second.invalid)),
        _ if second.degraded != 0 => words(&DEGRADED, second.degraded),
        _ => words(&VENDOR, said.map_or(0, |said| said.flags)),
    };
    let mut all = values([
        ("slip messages", second.slip_messages.to_string()),
        ("slip messages lost", count.slip_lost.to_string()),
        ("raw messages lost", count.raw_lost.to_string()),
        ("invalid", words(&INVALID, second.invalid)),
        ("degraded", words(&DEGRADED, second.degraded)),
    ]);
    if let Some(slip) = &module.slip {
        all.extend(values([
            ("late frames", slip.late_frames.to_string()),
            ("starts", slip.starts.to_string()),
            ("locked", slip.locked.to_string()),
            ("configuration", format!("{:04x}", slip.configuration)),
        ]));
    }
    if let Some(said) = said {
        let mode =
            MODES.iter().find(|(mode, _)| *mode as u8 == said.mode).map_or("unknown", |(_, name)| name);
        all.extend(values([
            ("uptime", format!("{} s", said.uptime_s)),
            ("mode", mode.to_owned()),
            ("status", words(&VENDOR, said.flags)),
        ]));
    }
    let name = format!("slipsense: {}", frame_of(node));
    DiagnosticStatus { level, name, message, hardware_id: frame_of(node), values: all }
}

fn of_sensor(node: NodeId, sensor: u8, module: &Module) -> DiagnosticStatus {
    let index = usize::from(sensor);
    let (bits, mask) = (module.second.health[index], module.mask(index));
    let level = match bits {
        _ if module.second.slip_messages == 0 => STALE,
        0 => OK,
        bits if bits & (health::PIEZO_MISSING | health::XL_MISSING | health::NO_MODEL) != 0 => ERROR,
        _ => WARN,
    };
    let calibration = module.sensors[index].calibration.as_deref();
    let all = values([
        ("raw messages", module.second.raw_messages[index].to_string()),
        ("calibration", calibration.unwrap_or("not known yet").to_owned()),
        ("masked taxels", mask.map_or("not known yet".to_owned(), |mask| mask.len().to_string())),
    ]);
    DiagnosticStatus {
        level,
        name: format!("slipsense: {}", sensor_frame_of(node, sensor)),
        message: if level == STALE { "no slip message".to_owned() } else { words(&HEALTH, bits) },
        hardware_id: frame_of(node),
        values: all,
    }
}
