//! A frame of a recording as bytes, for boards that are given their frames instead of sensing them: the emulated one
//! reads them from a file, a flashed one from its RAM ([`mailbox`](super::mailbox)).
//!
//! All numbers are little-endian. A frame's bytes are a multiple of four, whatever the number of sensors.

use super::SensorReadings;
use crate::health::bits_if;
use crate::params::{MAX_SENSORS, TAXELS, XL_AXES, XL_BATCH_MAX};
use crate::pipeline::FrameStamp;
use crate::sensor::PiezoFrame;
use crate::wire::bytes::Reader;
use crate::wire::{COMPRESSED_BYTES_MAX, COMPRESSED_FRAME_BYTES};

const STAMP_BYTES: usize = 4 + 8;
const PART_BYTES: usize = 2 + 2 + 4 + 2 * TAXELS + 2 * XL_AXES * XL_BATCH_MAX;
/// Bytes of the largest frame.
pub const FRAME_BYTES_MAX: usize = frame_bytes(MAX_SENSORS);
/// CAN frames of one frame period, at most: the slip message and the compressed raw message of every sensor, with two
/// bytes of CRC at the end. Plain ones have fewer.
pub const CAN_FRAMES_MAX: usize =
    1 + MAX_SENSORS * (COMPRESSED_BYTES_MAX + 2).div_ceil(COMPRESSED_FRAME_BYTES - 1);

const NAME: &str = "replayed frame";
const PIEZO_ARRIVED: u8 = 1;
const XL_ARRIVED: u8 = 2;

/// Bytes of a frame of this number of sensors.
pub const fn frame_bytes(sensors: usize) -> usize {
    STAMP_BYTES + sensors * PART_BYTES
}

/// Write a frame through `put`.
pub fn encode_frame(stamp: FrameStamp, parts: &[SensorReadings], mut put: impl FnMut(&[u8])) {
    put(&stamp.sequence.to_le_bytes());
    put(&stamp.timestamp_us.to_le_bytes());
    for part in parts {
        let arrived = bits_if(part.piezo_arrived, PIEZO_ARRIVED) | bits_if(part.xl_arrived, XL_ARRIVED);
        put(&u16::from(arrived).to_le_bytes());
        put(&(part.xl.len() as u16).to_le_bytes());
        put(&part.xl_end.to_le_bytes());
        for count in part.piezo.counts() {
            put(&count.to_le_bytes());
        }
        let padding = core::iter::repeat_n([0; XL_AXES], XL_BATCH_MAX - part.xl.len());
        for sample in part.xl.iter().copied().chain(padding).flatten() {
            put(&sample.to_le_bytes());
        }
    }
}

/// The stamp at the start of a frame.
pub fn decode_stamp(frame: &[u8]) -> Option<FrameStamp> {
    let mut reader = Reader::new(NAME, frame);
    let sequence = u32::from_le_bytes(reader.take().ok()?);
    Some(FrameStamp { sequence, timestamp_us: reader.unsigned::<8>().ok()? })
}

/// Read a frame into `parts`, one per sensor. `None` if it is too short or breaks a rule.
pub fn decode_parts(frame: &[u8], parts: &mut [SensorReadings]) -> Option<()> {
    let mut reader = Reader::new(NAME, frame.get(STAMP_BYTES..)?);
    for part in parts {
        let [arrived, _] = reader.take().ok()?;
        part.piezo_arrived = arrived & PIEZO_ARRIVED != 0;
        part.xl_arrived = arrived & XL_ARRIVED != 0;
        let samples = u16::from_le_bytes(reader.take().ok()?);
        part.xl_end = u32::from_le_bytes(reader.take().ok()?);
        let mut counts = [0; TAXELS];
        for count in &mut counts {
            *count = u16::from_le_bytes(reader.take().ok()?);
        }
        part.piezo = PiezoFrame::from_counts(counts).ok()?;
        part.xl.resize_default(samples.into()).ok()?;
        let all = reader.slice(2 * XL_AXES * XL_BATCH_MAX).ok()?;
        for (axis, bytes) in part.xl.as_flattened_mut().iter_mut().zip(all.as_chunks().0) {
            *axis = i16::from_le_bytes(*bytes);
        }
    }
    Some(())
}
