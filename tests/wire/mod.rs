//! The bus messages: what is sent is received, at every edge; what a bus does to frames is noticed.
//! The frames themselves are compared with an independent transmitter in `slipsense-recording`
//! (`tests/canadensis.rs`), the layouts with pycyphal (`tests/python/check_can_log.py`).

mod compress;
mod frames;
mod messages;
mod receiver;
mod services;

use proptest::prelude::*;
use slipsense::health;
use slipsense::params::TAXELS;
use slipsense::sensor::{PiezoFrame, SensorInput, XlSample};
use slipsense::wire::{NodeId, RAW_XL_MAX, RawFrame, RawMessage, Region};

const NODE: NodeId = NodeId::DEFAULT;

/// Everything a raw frame is made of, owned; at least one part delivered: time, sequence, sensor, health, scan, samples, `xl_end`.
type RawParts = (u64, u32, u8, u8, Option<PiezoFrame>, Option<Vec<XlSample>>, u32);

fn raw() -> impl Strategy<Value = RawParts> {
    let scan = proptest::collection::vec(any::<u16>(), TAXELS)
        .prop_map(|counts| PiezoFrame::from_scan(counts.try_into().unwrap()));
    (
        0u64..1 << 56,
        any::<u32>(),
        0u8..3,
        any::<u8>(),
        proptest::option::of(scan),
        proptest::option::of(proptest::collection::vec(any::<XlSample>(), 0..400)),
        any::<u32>(),
    )
        .prop_filter("a sensor that delivered nothing sends nothing", |parts: &RawParts| {
            parts.4.is_some() || parts.5.is_some()
        })
}

fn frame(parts: &RawParts) -> RawFrame<'_> {
    let (timestamp_us, sequence, sensor, health, piezo, xl, xl_end) = parts;
    RawFrame {
        timestamp_us: *timestamp_us,
        sequence: *sequence,
        sensor: *sensor,
        health: *health,
        input: SensorInput { piezo: piezo.as_ref(), xl: xl.as_deref(), xl_end: *xl_end },
    }
}

/// What must arrive of it.
fn expected(parts: &RawParts) -> RawMessage {
    let (timestamp_us, sequence, sensor, health, piezo, xl, xl_end) = parts.clone();
    let piezo_health = if piezo.is_none() { health::PIEZO_MISSING } else { 0 };
    let xl_health = if xl.is_none() { health::XL_MISSING } else { 0 };
    let samples = xl.unwrap_or_default();
    let older = samples.len().saturating_sub(RAW_XL_MAX);
    RawMessage {
        timestamp_us,
        sequence,
        sensor,
        health: health | piezo_health | xl_health,
        region: Region::ALL,
        piezo: piezo.unwrap_or(PiezoFrame::zeroed()),
        xl: samples[older..].iter().copied().collect(),
        xl_end,
        xl_dropped: older.min(255) as u8,
    }
}
