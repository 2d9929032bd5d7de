//! The input file: a header, the model file, then one record of fixed size per frame.

use slipsense::board::SensedPart;
use slipsense::params::{MAX_SENSORS, TAXELS, XL_AXES, XL_BATCH_MAX};
use slipsense::pipeline::FrameStamp;
use slipsense::sensor::PiezoFrame;
use slipsense::wire::NodeId;

use crate::bytes::Reader;

const MAGIC: [u8; 8] = *b"SLIPQEMU";
/// Bytes of a [`Header`].
pub const HEADER_BYTES: usize = 8 + 5 * 4;
const STAMP_BYTES: usize = 4 + 8;
const PART_BYTES: usize = 2 + 2 + 4 + 2 * TAXELS + 2 * XL_AXES * XL_BATCH_MAX;
/// Bytes of the largest frame record.
pub const FRAME_BYTES_MAX: usize = frame_bytes(MAX_SENSORS);
/// Bytes that a model file may have here.
pub const MODEL_BYTES_MAX: usize = 1 << 20;

const PIEZO_ARRIVED: u16 = 1;
const XL_ARRIVED: u16 = 2;

/// Bytes of one frame record.
pub const fn frame_bytes(sensors: usize) -> usize {
    STAMP_BYTES + sensors * PART_BYTES
}

/// What the file holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// Length of the model file that follows, bytes.
    pub model_bytes: u32,
    /// Sensors, 1 to [`MAX_SENSORS`].
    pub sensors: u32,
    /// Frame records.
    pub frames: u32,
    /// Address on the bus.
    pub node: NodeId,
    /// Do raw messages go compressed?
    pub compress_raw: bool,
}

impl Header {
    /// As written to the file.
    pub fn encode(&self) -> [u8; HEADER_BYTES] {
        let mut out = [0; HEADER_BYTES];
        let node = u32::from(self.node.get());
        let numbers = [self.model_bytes, self.sensors, self.frames, node, u32::from(self.compress_raw)];
        let bytes = MAGIC.into_iter().chain(numbers.into_iter().flat_map(u32::to_le_bytes));
        out.iter_mut().zip(bytes).for_each(|(out, byte)| *out = byte);
        out
    }

    /// `None` if these bytes are no header or ask for more than the emulated board has.
    pub fn decode(bytes: &[u8; HEADER_BYTES]) -> Option<Self> {
        let mut reader = Reader(bytes);
        if reader.array()? != MAGIC {
            return None;
        }
        let (model_bytes, sensors, frames) = (reader.u32()?, reader.u32()?, reader.u32()?);
        let node = NodeId::new(u8::try_from(reader.u32()?).ok()?)?;
        let compress_raw = reader.u32()? != 0;
        let fits = model_bytes as usize <= MODEL_BYTES_MAX && (1..=MAX_SENSORS as u32).contains(&sensors);
        fits.then_some(Self { model_bytes, sensors, frames, node, compress_raw })
    }
}

/// Write one frame record through `put`.
pub fn encode_frame(stamp: FrameStamp, parts: &[SensedPart], mut put: impl FnMut(&[u8])) {
    put(&stamp.sequence.to_le_bytes());
    put(&stamp.timestamp_us.to_le_bytes());
    for part in parts {
        let piezo = if part.piezo_arrived { PIEZO_ARRIVED } else { 0 };
        let xl = if part.xl_arrived { XL_ARRIVED } else { 0 };
        put(&(piezo | xl).to_le_bytes());
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

/// The stamp at the start of a frame record.
pub fn decode_stamp(record: &[u8]) -> Option<FrameStamp> {
    let mut reader = Reader(record);
    Some(FrameStamp { sequence: reader.u32()?, timestamp_us: reader.u64()? })
}

/// Read a frame record into `parts`, one per sensor. `None` if the record is too short or breaks a rule.
pub fn decode_parts(record: &[u8], parts: &mut [SensedPart]) -> Option<()> {
    let mut reader = Reader(record.get(STAMP_BYTES..)?);
    for part in parts {
        let arrived = reader.u16()?;
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
