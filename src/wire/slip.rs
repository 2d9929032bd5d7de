//! The slip message: the decision of one frame and the contact on each pad, in one CAN FD frame.
//! Layout: `dsdl/slipsense/6200.Slip.1.0.dsdl`.

use super::bytes::{DecodeError, Reader, Writer};
use super::id::Priority;
use crate::fixed::{Logit, Q};
use crate::params::{CLASSES, MAX_SENSORS};

/// Subject identifier of [`SlipMessage`]: `slipsense.Slip.1.0`. 6144 to 7167 is the range that Cyphal
/// reserves for fixed identifiers of vendors.
pub const SLIP_PORT: u16 = 6200;
/// Ahead of all control traffic of a robot (Fast and below), so that the slip message waits for at
/// most the one frame already on the wire. Exceptional stays free for the emergency stop of whoever
/// builds the robot.
pub const SLIP_PRIORITY: Priority = Priority::Immediate;

/// Bytes of an encoded [`SlipMessage`]; one frame carries 63.
pub const SLIP_BYTES: usize = 7 + 4 + 1 + 2 + 4 * CLASSES + MAX_SENSORS * CONTACT_BYTES;
const CONTACT_BYTES: usize = 1 + 3 + 2 + 2 + 2 + 1 + 1;

const NAME: &str = "slipsense.Slip";
// The byte that holds class, slip flag, sensor count and alarm.
const CLASS_MASK: u8 = 3;
const SLIP_BIT: u8 = 4;
const SENSORS_SHIFT: u32 = 3;
const SENSORS_MASK: u8 = 3;
const ALARM_BIT: u8 = 32;

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
    /// The class is slip.
    pub slip: bool,
    /// The flag to act on: slip by the operating point of the sender's model.
    pub alarm: bool,
    /// Outputs of the network per class.
    pub logits: [Logit; CLASSES],
    /// Frames whose decision came after the next tick, since start; stays at 65,535.
    pub late_frames: u16,
    /// Sensors in use, 1 to 3; entries of `contact` beyond are zero.
    pub sensors: u8,
    /// The contact on each pad.
    pub contact: [SensorContact; MAX_SENSORS],
}

/// The contact on one pad, as sent. Rows and columns count taxels from the pad's corner (0, 0).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SensorContact {
    /// Bits of [`crate::health`].
    pub health: u8,
    /// Sum of the pad's counts, at most 942 · 4095, below 2^24.
    pub sum: u32,
    /// Taxels in contact, 0 to 942.
    pub area: u16,
    /// Centre of pressure, row.
    pub centroid_row: Q<u16, 8>,
    /// Centre of pressure, column.
    pub centroid_col: Q<u16, 8>,
    /// Direction of the long axis, −90 to 89 degrees: 0 runs along a row, positive turns from growing
    /// columns towards growing rows.
    pub axis_deg: i8,
    /// 1 − (short axis / long axis): 0 is round, 255/256 a line.
    pub elongation: Q<u8, 8>,
}

impl SlipMessage {
    /// The bytes of the message.
    pub fn encode(&self) -> [u8; SLIP_BYTES] {
        let mut out = [0; SLIP_BYTES];
        let mut writer = Writer::new(&mut out);
        writer.put_saturated::<7>(self.timestamp_us);
        writer.put(&self.sequence.to_le_bytes());
        let slip = if self.slip { SLIP_BIT } else { 0 };
        let sensors = self.sensors.min(SENSORS_MASK) << SENSORS_SHIFT;
        let alarm = if self.alarm { ALARM_BIT } else { 0 };
        writer.put(&[self.class.min(CLASS_MASK) | slip | sensors | alarm]);
        writer.put(&self.late_frames.to_le_bytes());
        for logit in self.logits {
            writer.put(&logit.to_bits().to_le_bytes());
        }
        for contact in &self.contact {
            writer.put(&[contact.health]);
            writer.put_saturated::<3>(contact.sum.into());
            writer.put(&contact.area.to_le_bytes());
            writer.put(&contact.centroid_row.to_bits().to_le_bytes());
            writer.put(&contact.centroid_col.to_bits().to_le_bytes());
            writer.put(&contact.axis_deg.to_le_bytes());
            writer.put(&[contact.elongation.to_bits()]);
        }
        out
    }

    /// Read a message; bytes after it are padding and ignored.
    pub fn decode(bytes: &[u8]) -> Result<Self, DecodeError> {
        let mut reader = Reader::new(NAME, bytes.get(..SLIP_BYTES).unwrap_or(bytes));
        let timestamp_us = reader.unsigned::<7>()?;
        let sequence = u32::from_le_bytes(reader.take()?);
        let [flags] = reader.take()?;
        let class = reader.at_most("class_index", flags & CLASS_MASK, CLASSES - 1)?;
        let sensors = flags >> SENSORS_SHIFT & SENSORS_MASK;
        let late_frames = u16::from_le_bytes(reader.take()?);
        let mut logits = [Logit::default(); CLASSES];
        for logit in &mut logits {
            *logit = Q::from_bits(i32::from_le_bytes(reader.take()?));
        }
        let mut contact = [SensorContact::default(); MAX_SENSORS];
        for contact in &mut contact {
            *contact = SensorContact {
                health: u8::from_le_bytes(reader.take()?),
                sum: reader.unsigned::<3>()? as u32,
                area: u16::from_le_bytes(reader.take()?),
                centroid_row: Q::from_bits(u16::from_le_bytes(reader.take()?)),
                centroid_col: Q::from_bits(u16::from_le_bytes(reader.take()?)),
                axis_deg: i8::from_le_bytes(reader.take()?),
                elongation: Q::from_bits(u8::from_le_bytes(reader.take()?)),
            };
        }
        let (slip, alarm) = (flags & SLIP_BIT != 0, flags & ALARM_BIT != 0);
        Ok(Self { timestamp_us, sequence, class, slip, alarm, logits, late_frames, sensors, contact })
    }
}
