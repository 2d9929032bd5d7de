//! The slip message: the decision of one frame and the contact on each pad, in one CAN FD frame, protected from the task
//! that decides to the receiver's. Layout: `dsdl/slipsense/6203.Slip.2.0.dsdl`; recordings may hold version 1.0.

use crc::{CRC_32_AUTOSAR, Crc, Table};

use super::bytes::{DecodeError, Reader, Writer};
use super::cyphal::FRAME_PAYLOAD;
use super::id::{NodeId, Priority};
use crate::fixed::{Logit, Q, round_shift, saturate_i16};
use crate::health::{self, MEMORY_CHECKS, Status, bits_if};
use crate::params::{CLASSES, MAX_SENSORS};

/// Subject identifier of [`SlipMessage`]: `slipsense.Slip.2.0`. 6144 to 7167 is the range that Cyphal
/// reserves for fixed identifiers of vendors.
pub const SLIP_PORT: u16 = 6203;
/// Of `slipsense.Slip.1.0`, in old recordings.
pub const SLIP_1_PORT: u16 = 6200;
/// Ahead of a robot's control traffic (Fast and below), so that the slip message waits for at most the one frame on the
/// wire. Exceptional stays free for the emergency stop.
pub const SLIP_PRIORITY: Priority = Priority::Immediate;

/// Bytes of an encoded [`SlipMessage`].
pub const SLIP_BYTES: usize = CHECKED_BYTES + 4;
const CHECKED_BYTES: usize = 7 + 4 + 3 + 1 + 2 + 1 + 2 * CLASSES + 2 + MAX_SENSORS * CONTACT_BYTES;
const CONTACT_BYTES: usize = 1 + 4 + 2 + 2 + 1 + 1;
const _: () = assert!(SLIP_BYTES == FRAME_PAYLOAD, "one CAN FD frame");
const SLIP_1_BYTES: usize = 7 + 4 + 1 + 2 + 4 * CLASSES + MAX_SENSORS * 12;

/// What the CRC covers before the node's address and the message: a message of another kind is no slip message.
pub const SLIP_DATA_ID: u32 = u32::from_le_bytes(*b"slip");
/// Of AUTOSAR's end-to-end profile 4: up to 5 flipped bits of a message never go unseen.
pub(crate) static CRC_32: Crc<u32, Table<1>> = Crc::<u32, Table<1>>::new(&CRC_32_AUTOSAR);

/// The flag means nothing: there is no readable model.
pub const INVALID_NO_MODEL: u8 = 1;
/// The flag means little: the network has not yet seen as many frames as it looks back.
pub const INVALID_STARTING: u8 = 2;
/// The flag means nothing: no sensor delivers anything that changes.
pub const INVALID_NO_SENSOR: u8 = 4;
/// Code or model are not what they were at start.
pub const INVALID_MEMORY: u8 = 8;
/// The network does not give the outputs of its golden inference.
pub const INVALID_NETWORK: u8 = 16;
/// The model is not the one that the settings expect.
pub const INVALID_OTHER_MODEL: u8 = 32;

/// An array or an accelerometer delivered nothing.
pub const DEGRADED_MISSING: u8 = 1;
/// The samples of an accelerometer do not change.
pub const DEGRADED_FROZEN: u8 = 2;
/// An array is not calibrated.
pub const DEGRADED_NOT_CALIBRATED: u8 = 4;
/// The operating point is a setting's, not the model's.
pub const DEGRADED_POINT: u8 = 8;
/// This decision came after the next tick.
pub const DEGRADED_LATE: u8 = 16;
/// A self test has failed since start.
pub const DEGRADED_SELF_TEST: u8 = 32;

const NAME: &str = "slipsense.Slip";
// The byte that holds class, flags, sensor count and lock.
const CLASS_MASK: u8 = 3;
const SLIP_BIT: u8 = 4;
const MAY_BEGIN_BIT: u8 = 8;
const SENSORS_SHIFT: u32 = 4;
const SENSORS_MASK: u8 = 3;
const LOCKED_BIT: u8 = 64;
// The word that holds sum and area.
const SUM_BITS: u32 = 22;

/// A logit on the wire, nat.
pub type WireLogit = Q<i16, 8>;

/// A logit with fewer bits, saturated.
pub fn wire_logit(logit: Logit) -> WireLogit {
    // 30 bits are left: fits.
    Q::from_bits(saturate_i16(round_shift(logit.to_bits().into(), 2) as i32))
}

/// The decision of one frame. A field outside its range is sent as the largest value that its bits
/// hold; for `class` that is 3, which every receiver refuses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SlipMessage {
    /// Time of the tick that closed the frame, microseconds of the sender's clock, below 2^56.
    pub timestamp_us: u64,
    /// Number of the frame, wraps.
    pub sequence: u32,
    /// 0 no contact, 1 contact without slip, 2 slip.
    pub class: u8,
    /// The flag to act on: slip by the sender's operating point.
    pub slip: bool,
    /// Slip may begin: the class is slip. For controllers that can afford to grip firmer.
    pub may_begin: bool,
    /// Sensors in use, 1 to 3; entries of `contact` beyond are zero.
    pub sensors: u8,
    /// The node refuses settings, commands and updates.
    pub locked: bool,
    /// Why the flag must not be believed: bits such as [`INVALID_STARTING`]; 0: believe it.
    pub invalid: u8,
    /// What makes the flag worse than it could be: bits such as [`DEGRADED_MISSING`].
    pub degraded: u8,
    /// Starts of the sender since its supply came, wraps.
    pub starts: u8,
    /// Hash of model, operating point, masks, orientation and calibrations: changes when one of them does.
    pub configuration: u16,
    /// Frames whose decision came after the next tick, since start; wraps.
    pub late_frames: u8,
    /// Outputs of the network per class.
    pub logits: [WireLogit; CLASSES],
    /// Log-odds of slip, as the decision compares them with its threshold; −128 where no pad is touched.
    pub log_odds: WireLogit,
    /// The contact on each pad.
    pub contact: [SensorContact; MAX_SENSORS],
}

/// Health and [contact](crate::contact::ContactSummary) of one pad, as sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[expect(missing_docs, reason = "as in a [`ContactSummary`](crate::contact::ContactSummary)")]
pub struct SensorContact {
    /// Bits of [`crate::health`].
    pub health: u8,
    /// Sum of the pad's counts, at most 942 · 4095, below 2^22.
    pub sum: u32,
    /// Taxels in contact, 0 to 942.
    pub area: u16,
    pub centroid_row: Q<u16, 8>,
    pub centroid_col: Q<u16, 8>,
    pub axis_deg: i8,
    pub elongation: Q<u8, 8>,
}

/// What a slip message says of its sender, beside the decision. The default is a simulator's: uncalibrated, never late.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[expect(missing_docs, reason = "as in a [`SlipMessage`]")]
pub struct Origin {
    pub starts: u8,
    pub late_frames: u8,
    pub late: bool,
    /// A self test has failed.
    pub self_test_failed: bool,
    /// What the sender's checks of itself say against the flag: bits such as [`INVALID_MEMORY`].
    pub invalid: u8,
    pub locked: bool,
    /// Name of each array's calibration; 0: none.
    pub calibrations: [u32; MAX_SENSORS],
}

impl Origin {
    /// A node with this status, whose `late_frames` the caller has counted.
    pub fn new(status: &Status, late_frames: u32, late: bool, locked: bool) -> Self {
        Self {
            starts: status.starts,
            late_frames: late_frames as u8,
            late,
            self_test_failed: status.failed_self_tests > 0,
            invalid: match status.self_checks.failed {
                0 => 0,
                1..=MEMORY_CHECKS => INVALID_MEMORY,
                failed if failed & MEMORY_CHECKS == 0 => INVALID_NETWORK,
                _ => INVALID_MEMORY | INVALID_NETWORK,
            },
            locked,
            calibrations: status.calibrations.each_ref().map(|of| if of.version > 0 { of.id } else { 0 }),
        }
    }

    /// A message without a decision. `configuration`: the hash of model, operating point, masks and mountings.
    pub fn message(&self, sensors: usize, configuration: u16) -> SlipMessage {
        let used = self.calibrations.iter().take(sensors);
        let missing = used.clone().any(|&name| name == 0);
        let named = used.fold(0u32, |hash, &name| hash.rotate_left(9) ^ name);
        SlipMessage {
            sensors: sensors as u8,
            locked: self.locked,
            invalid: self.invalid,
            degraded: bits_if(missing, DEGRADED_NOT_CALIBRATED)
                | bits_if(self.late, DEGRADED_LATE)
                | bits_if(self.self_test_failed, DEGRADED_SELF_TEST),
            starts: self.starts,
            configuration: configuration ^ fold(named),
            late_frames: self.late_frames,
            ..SlipMessage::default()
        }
    }
}

/// A hash in 16 bits.
pub(crate) const fn fold(hash: u32) -> u16 {
    (hash ^ hash >> 16) as u16
}

/// Of the encoded fields, sent by this node.
fn checksum(node: NodeId, fields: &[u8]) -> u32 {
    let mut digest = CRC_32.digest();
    digest.update(&SLIP_DATA_ID.to_le_bytes());
    digest.update(&[node.get()]);
    digest.update(fields);
    digest.finalize()
}

impl SlipMessage {
    /// The bytes of the message, as this node sends it.
    pub fn encode(&self, node: NodeId) -> [u8; SLIP_BYTES] {
        let mut out = [0; SLIP_BYTES];
        let mut writer = Writer::new(&mut out);
        writer.put_saturated::<7>(self.timestamp_us);
        writer.put(&self.sequence.to_le_bytes());
        let flags = bits_if(self.slip, SLIP_BIT)
            | bits_if(self.may_begin, MAY_BEGIN_BIT)
            | bits_if(self.locked, LOCKED_BIT)
            | self.sensors.min(SENSORS_MASK) << SENSORS_SHIFT;
        writer.put(&[self.class.min(CLASS_MASK) | flags, self.invalid, self.degraded, self.starts]);
        writer.put(&self.configuration.to_le_bytes());
        writer.put(&[self.late_frames]);
        for logit in self.logits.iter().chain([&self.log_odds]) {
            writer.put(&logit.to_bits().to_le_bytes());
        }
        for contact in &self.contact {
            let area = u32::from(contact.area).min(u32::MAX >> SUM_BITS);
            let sum = contact.sum.min((1 << SUM_BITS) - 1);
            writer.put(&[contact.health]);
            writer.put(&(sum | area << SUM_BITS).to_le_bytes());
            writer.put(&contact.centroid_row.to_bits().to_le_bytes());
            writer.put(&contact.centroid_col.to_bits().to_le_bytes());
            writer.put(&contact.axis_deg.to_le_bytes());
            writer.put(&[contact.elongation.to_bits()]);
        }
        if let Some((fields, check)) = out.split_last_chunk_mut() {
            *check = checksum(node, fields).to_le_bytes();
        }
        out
    }

    /// Read a message of this node.
    pub fn decode(node: NodeId, bytes: &[u8]) -> Result<Self, DecodeError> {
        let mut reader = Reader::new(NAME, bytes);
        let fields = reader.slice(CHECKED_BYTES)?;
        if reader.take()? != checksum(node, fields).to_le_bytes() {
            return Err(DecodeError::Damaged { message: NAME });
        }
        let mut reader = Reader::new(NAME, fields);
        let timestamp_us = reader.unsigned::<7>()?;
        let sequence = u32::from_le_bytes(reader.take()?);
        let [flags, invalid, degraded, starts] = reader.take()?;
        let class = reader.at_most("class_index", flags & CLASS_MASK, CLASSES - 1)?;
        let configuration = u16::from_le_bytes(reader.take()?);
        let [late_frames] = reader.take()?;
        let mut logits = [WireLogit::default(); CLASSES];
        for logit in &mut logits {
            *logit = Q::from_bits(i16::from_le_bytes(reader.take()?));
        }
        let log_odds = Q::from_bits(i16::from_le_bytes(reader.take()?));
        let mut contact = [SensorContact::default(); MAX_SENSORS];
        for contact in &mut contact {
            let [health] = reader.take()?;
            let word = u32::from_le_bytes(reader.take()?);
            let (sum, area) = (word & ((1 << SUM_BITS) - 1), (word >> SUM_BITS) as u16);
            *contact = SensorContact::rest(health, sum, area, &mut reader)?;
        }
        Ok(Self {
            timestamp_us,
            sequence,
            class,
            slip: flags & SLIP_BIT != 0,
            may_begin: flags & MAY_BEGIN_BIT != 0,
            sensors: flags >> SENSORS_SHIFT & SENSORS_MASK,
            locked: flags & LOCKED_BIT != 0,
            invalid,
            degraded,
            starts,
            configuration,
            late_frames,
            logits,
            log_odds,
            contact,
        })
    }

    /// Read a message of version 1.0, which has no check, no reasons and no log-odds; bytes after it are ignored. It does
    /// not say whether its arrays are calibrated: they count as not, and its log-odds as the lowest.
    pub fn decode_1(bytes: &[u8]) -> Result<Self, DecodeError> {
        let mut reader = Reader::new(NAME, bytes.get(..SLIP_1_BYTES).unwrap_or(bytes));
        let timestamp_us = reader.unsigned::<7>()?;
        let sequence = u32::from_le_bytes(reader.take()?);
        let [flags] = reader.take()?;
        let class = reader.at_most("class_index", flags & CLASS_MASK, CLASSES - 1)?;
        let late_frames = u16::from_le_bytes(reader.take()?) as u8;
        let mut logits = [WireLogit::default(); CLASSES];
        for logit in &mut logits {
            *logit = wire_logit(Q::from_bits(i32::from_le_bytes(reader.take()?)));
        }
        let mut contact = [SensorContact::default(); MAX_SENSORS];
        for contact in &mut contact {
            let [health] = reader.take()?;
            let sum = reader.unsigned::<3>()? as u32;
            let area = u16::from_le_bytes(reader.take()?);
            *contact = SensorContact::rest(health, sum, area, &mut reader)?;
        }
        let no_model = contact.iter().any(|contact| contact.health & health::NO_MODEL != 0);
        Ok(Self {
            timestamp_us,
            sequence,
            class,
            // `alarm` and `slip` of that version.
            slip: flags & 32 != 0,
            may_begin: flags & 4 != 0,
            sensors: flags >> 3 & SENSORS_MASK,
            invalid: bits_if(no_model, INVALID_NO_MODEL),
            degraded: DEGRADED_NOT_CALIBRATED,
            late_frames,
            logits,
            log_odds: Q::from_bits(i16::MIN),
            contact,
            ..Self::default()
        })
    }
}

impl SensorContact {
    fn rest(health: u8, sum: u32, area: u16, reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(Self {
            health,
            sum,
            area,
            centroid_row: Q::from_bits(u16::from_le_bytes(reader.take()?)),
            centroid_col: Q::from_bits(u16::from_le_bytes(reader.take()?)),
            axis_deg: i8::from_le_bytes(reader.take()?),
            elongation: Q::from_bits(u8::from_le_bytes(reader.take()?)),
        })
    }
}
