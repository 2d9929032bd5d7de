//! One frame as the page gets it: fixed size, little endian.
//!
//! | bytes | what |
//! |---|---|
//! | 4 | sequence number of the frame |
//! | 4 | frames lost right before it |
//! | 8 | time of its tick, µs, a 64-bit float |
//! | 1 | class: 0 no contact, 1 contact without slip, 2 slip |
//! | 1 | flags: 1 slip, 2 slip may begin, 4 the truth is known, 8 slip in truth |
//! | 1, 1 | sensors in use; why slip must not be believed |
//! | 12 | logits, 1/1024 nat; of a log in steps of 1/256 |
//! | 1, 1 | late frames so far, modulo 256; what makes slip worse |
//! | 6 | unused |
//!
//! and per sensor of the session, in use or not
//!
//! | bytes | what |
//! |---|---|
//! | 1, 1 | health bits (`slipsense::health`); 1 taxels present, 2 log-mel present |
//! | 2 | taxels in contact |
//! | 4 | sum of the counts |
//! | 2, 2 | centre of pressure, row and column, 1/256 taxel |
//! | 1, 1, 2 | direction of the long axis, degrees; elongation, 1/256; unused |
//! | 32 | log-mel power of the 16 bins, natural log of LSB², 1/256 nat |
//! | 2048 | counts of the 32 × 32 taxels, row by row |
//!
//! `page/source.js` reads it.

use slipsense::features::{LN_FRAC_BITS, LogMel};
use slipsense::health;
use slipsense::params::{CLASSES, MEL_BINS};
use slipsense::sensor::PiezoFrame;
use slipsense::wire::{SensorContact, SlipMessage};

/// Bytes before the sensors.
pub const HEADER_BYTES: usize = 40;
pub const SENSOR_BYTES: usize = 16 + 2 * MEL_BINS + 2 * 1024;

pub const fn bytes(sensors: usize) -> usize {
    HEADER_BYTES + sensors * SENSOR_BYTES
}

const SLIP: u8 = 1;
const MAY_BEGIN: u8 = 2;
const TRUTH_KNOWN: u8 = 4;
const TRUE_SLIP: u8 = 8;
/// Of a mark only: a sensor or the way to here has a fault.
const FAULT: u8 = 64;
/// Of a mark only: slip must not be believed.
const INVALID: u8 = 128;
/// What belongs to a pad for good, or to its start.
pub const NO_FAULT: u8 = health::TAXELS_MASKED | health::XL_WARMING_UP;
const TAXELS_PRESENT: u8 = 1;
const LOG_MEL_PRESENT: u8 = 2;

#[derive(Clone, Debug)]
pub struct Record {
    pub slip: SlipMessage,
    /// 1/1024 nat.
    pub logits: [i32; CLASSES],
    pub lost: u32,
    /// Does it slip in truth? `None`: unknown.
    pub truth: Option<bool>,
    pub sensors: Vec<SensorRecord>,
}

#[derive(Clone, Debug, Default)]
pub struct SensorRecord {
    /// `None`: the raw message did not arrive.
    pub piezo: Option<PiezoFrame>,
    /// `None`: no samples arrived.
    pub log_mel: Option<LogMel>,
}

impl Record {
    /// What a module says of a frame; nothing is known of its truth, and nothing of the sensors has come yet.
    pub fn of_message(slip: SlipMessage) -> Self {
        let logits = slip.logits.map(|logit| i32::from(logit.to_bits()) << 2);
        let sensors = vec![SensorRecord::default(); slip.sensors.into()];
        Self { slip, logits, lost: 0, truth: None, sensors }
    }

    /// The byte that the page's timelines and events show: the flags, the class above them, 64 a fault, 128 a slip
    /// that must not be believed.
    pub fn mark(&self) -> u8 {
        let contacts = self.slip.contact.iter().take(self.slip.sensors.into());
        let fault = self.lost > 0 || contacts.fold(0, |all, contact| all | contact.health) & !NO_FAULT != 0;
        self.flags() | self.slip.class << 4 | bit(fault, FAULT) | bit(self.slip.invalid != 0, INVALID)
    }

    fn flags(&self) -> u8 {
        let truth = bit(self.truth.is_some(), TRUTH_KNOWN) | bit(self.truth == Some(true), TRUE_SLIP);
        bit(self.slip.slip, SLIP) | bit(self.slip.may_begin, MAY_BEGIN) | truth
    }

    /// Appends the bytes, [`bytes`] of the session's `sensors`; a frame of fewer has the others empty.
    pub fn encode(&self, sensors: usize, out: &mut Vec<u8>) {
        let (slip, start) = (&self.slip, out.len());
        out.reserve(bytes(sensors));
        out.extend(slip.sequence.to_le_bytes());
        out.extend(self.lost.to_le_bytes());
        out.extend((slip.timestamp_us as f64).to_le_bytes());
        out.extend([slip.class, self.flags(), slip.sensors, slip.invalid]);
        out.extend(self.logits.iter().flat_map(|logit| logit.to_le_bytes()));
        out.extend([slip.late_frames, slip.degraded]);
        out.resize(start + HEADER_BYTES, 0);
        let none = SensorRecord::default();
        for (sensor, contact) in (0..sensors).zip(&slip.contact) {
            encode_sensor(self.sensors.get(sensor).unwrap_or(&none), contact, out);
        }
        debug_assert_eq!(out.len(), start + bytes(sensors));
    }
}

const fn bit(is_set: bool, bit: u8) -> u8 {
    if is_set { bit } else { 0 }
}

fn encode_sensor(sensor: &SensorRecord, contact: &SensorContact, out: &mut Vec<u8>) {
    let present =
        bit(sensor.piezo.is_some(), TAXELS_PRESENT) | bit(sensor.log_mel.is_some(), LOG_MEL_PRESENT);
    out.extend([contact.health, present]);
    out.extend(contact.area.to_le_bytes());
    out.extend(contact.sum.to_le_bytes());
    out.extend(contact.centroid_row.to_bits().to_le_bytes());
    out.extend(contact.centroid_col.to_bits().to_le_bytes());
    out.extend(contact.axis_deg.to_le_bytes());
    out.extend([contact.elongation.to_bits(), 0, 0]);
    let ln_power = sensor.log_mel.map_or([0; MEL_BINS], |log_mel| log_mel.ln_power);
    // Below 2^7 nat: fits.
    out.extend(ln_power.iter().flat_map(|ln| ((ln >> (LN_FRAC_BITS - 8)) as i16).to_le_bytes()));
    match &sensor.piezo {
        Some(piezo) => out.extend(piezo.counts().iter().flat_map(|count| count.to_le_bytes())),
        None => out.resize(out.len() + 2 * 1024, 0),
    }
}
