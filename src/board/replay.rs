//! A frame of a recording as bytes, for boards that are given their frames instead of sensing them: the emulated one
//! reads them from a file, a flashed one from its RAM ([`mailbox`](super::mailbox)).
//!
//! Encode and decode stand side by side. All numbers are little-endian. Both take whole frames of a given number of sensors; a
//! frame's bytes are a multiple of four, whatever the number of sensors.

use super::SensorReadings;
use crate::health::bits_if;
use crate::params::{MAX_SENSORS, TAXELS, XL_AXES, XL_BATCH_MAX};
use crate::pipeline::FrameStamp;
use crate::sensor::PiezoFrame;
use crate::wire::{COMPRESSED_BYTES_MAX, COMPRESSED_FRAME_BYTES};

const STAMP_BYTES: usize = 4 + 8;
const PART_BYTES: usize = 2 + 2 + 4 + 2 * TAXELS + 2 * XL_AXES * XL_BATCH_MAX;
/// Bytes of the largest frame.
pub const FRAME_BYTES_MAX: usize = frame_bytes(MAX_SENSORS);
/// CAN frames of one frame period, at most: the slip message and the compressed raw message of every sensor, with two
/// bytes of CRC at the end. Plain ones have fewer.
pub const CAN_FRAMES_MAX: usize =
    1 + MAX_SENSORS * (COMPRESSED_BYTES_MAX + 2).div_ceil(COMPRESSED_FRAME_BYTES - 1);

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
    let mut reader = Reader(frame);
    Some(FrameStamp { sequence: reader.u32()?, timestamp_us: reader.u64()? })
}

/// Read a frame into `parts`, one per sensor. `None` if it is too short or breaks a rule.
pub fn decode_parts(frame: &[u8], parts: &mut [SensorReadings]) -> Option<()> {
    let mut reader = Reader(frame.get(STAMP_BYTES..)?);
    for part in parts {
        let [arrived, _] = reader.array()?;
        part.piezo_arrived = arrived & PIEZO_ARRIVED != 0;
        part.xl_arrived = arrived & XL_ARRIVED != 0;
        let samples = usize::from(reader.u16()?);
        part.xl_end = reader.u32()?;
        let mut counts = [0; TAXELS];
        for count in &mut counts {
            *count = reader.u16()?;
        }
        part.piezo = PiezoFrame::from_counts(counts).ok()?;
        part.xl.clear();
        for i in 0..XL_BATCH_MAX {
            let sample = [reader.i16()?, reader.i16()?, reader.i16()?];
            if i < samples {
                part.xl.push(sample).ok()?;
            }
        }
        if part.xl.len() != samples {
            return None;
        }
    }
    Some(())
}

/// Takes numbers off the front of a slice; `None` at its end.
struct Reader<'a>(&'a [u8]);

impl Reader<'_> {
    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (taken, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(*taken)
    }

    fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    fn i16(&mut self) -> Option<i16> {
        self.array().map(i16::from_le_bytes)
    }
}
