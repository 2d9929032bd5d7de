//! The raw frame: everything one sensor delivered for one frame, lossless, so that an episode can be
//! rebuilt from the bus. Layout: `dsdl/slipsense/6201.Raw.1.0.dsdl`.

use heapless::Vec;

use super::bytes::{DecodeError, Reader, Writer};
use super::id::Priority;
use super::region::Region;
use crate::health::{self, bits_if};
use crate::params::{ACTIVE_TAXELS, COUNT_MAX, MAX_SENSORS, TAXEL_COLS, TAXELS, XL_AXES};
use crate::sensor::{PiezoFrame, SensorInput, XlSample};

/// Subject identifier of [`RawFrame`]: `slipsense.Raw.1.0`, all sensors.
pub const RAW_PORT: u16 = 6201;
/// Raw frames fill most of the bus, so they give way to everything but optional traffic.
pub const RAW_PRIORITY: Priority = Priority::Slow;

/// Accelerometer samples that one raw frame carries, at most: nearly two nominal frames of 33.3.
pub const RAW_XL_MAX: usize = 64;
/// Bytes of the longest encoded raw frame.
pub const RAW_BYTES_MAX: usize = HEADER_BYTES + TAXEL_BYTES + XL_HEADER_BYTES + RAW_XL_MAX * XL_BYTES;
const HEADER_BYTES: usize = 7 + 4 + 1 + 1;
// Two 12-bit counts in three bytes.
const TAXEL_BYTES: usize = ACTIVE_TAXELS / 2 * 3;
const XL_HEADER_BYTES: usize = 4 + 1 + 1;
const XL_BYTES: usize = XL_AXES * 2;

/// Room for either form: the header of a compressed message has five bytes more.
pub(super) const RAW_BUFFER_BYTES: usize = RAW_BYTES_MAX + 5;

const NAME: &str = "slipsense.Raw";

const _: () = assert!(ACTIVE_TAXELS.is_multiple_of(2), "the taxels end on a byte");
const _: () = assert!(COUNT_MAX == (1 << 12) - 1, "12 bits a count");

/// What one sensor delivered for one frame.
#[derive(Clone, Copy, Debug)]
pub struct RawFrame<'a> {
    /// Time of the tick that closed the frame, microseconds of the sender's clock, below 2^56.
    pub timestamp_us: u64,
    /// Number of the frame, wraps; the same as in the slip message.
    pub sequence: u32,
    /// Which sensor, from 0.
    pub sensor: u8,
    /// Bits of [`health`]; [`health::PIEZO_MISSING`] and [`health::XL_MISSING`] are set by `encode`
    /// where `input` lacks that part.
    pub health: u8,
    /// The readings. Of more than [`RAW_XL_MAX`] samples the newest are sent.
    pub input: SensorInput<'a>,
}

/// A [`RawFrame`] as received.
#[derive(Clone, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "as in a [`RawFrame`]")]
pub struct RawMessage {
    pub timestamp_us: u64,
    pub sequence: u32,
    pub sensor: u8,
    pub health: u8,
    /// The array scan; all zero if [`health::PIEZO_MISSING`] is set.
    pub piezo: PiezoFrame,
    /// The taxels of `piezo` that were sent; the others read 0 and are not known. All but where the bus was too full.
    pub region: Region,
    /// The samples before `xl_end`, oldest first.
    pub xl: Vec<XlSample, RAW_XL_MAX>,
    /// Index of the sample after the last of `xl`, counted since start.
    pub xl_end: u32,
    /// Samples of this frame, older than `xl`, that did not fit; stays at 255.
    pub xl_dropped: u8,
}

/// Room for one encoded raw frame, plain or compressed, while its CAN frames are taken from it.
#[derive(Clone, Debug)]
pub struct RawBuffer(pub(super) [u8; RAW_BUFFER_BYTES]);

impl RawBuffer {
    /// An empty buffer.
    pub const fn new() -> Self {
        Self([0; RAW_BUFFER_BYTES])
    }

    /// The first bytes, as many as were encoded.
    pub(super) fn bytes(&self, length: usize) -> &[u8] {
        self.0.get(..length).unwrap_or(&self.0)
    }
}

impl RawFrame<'_> {
    /// Is there anything to send?
    pub const fn delivers(&self) -> bool {
        self.input.piezo.is_some() || self.input.xl.is_some()
    }

    /// The health bits, with those of the parts that are not there.
    pub(super) const fn full_health(&self) -> u8 {
        self.health
            | bits_if(self.input.piezo.is_none(), health::PIEZO_MISSING)
            | bits_if(self.input.xl.is_none(), health::XL_MISSING)
    }

    /// The samples that a message takes, and how many older ones it does not.
    pub(super) fn newest_samples(&self) -> (&[XlSample], usize) {
        let samples = self.input.xl.unwrap_or(&[]);
        let dropped = samples.len().saturating_sub(RAW_XL_MAX);
        (samples.get(dropped..).unwrap_or(&[]), dropped)
    }

    /// Write the message into `buffer` and return its bytes.
    pub fn encode<'b>(&self, buffer: &'b mut RawBuffer) -> &'b [u8] {
        let health = self.full_health();
        let (newest, dropped) = self.newest_samples();
        let mut writer = Writer::new(&mut buffer.0);
        writer.put_saturated::<7>(self.timestamp_us);
        writer.put(&self.sequence.to_le_bytes());
        writer.put(&[self.sensor, health]);
        match self.input.piezo {
            Some(piezo) => pack(piezo, writer.slot(TAXEL_BYTES)),
            None => writer.slot(TAXEL_BYTES).fill(0),
        }
        writer.put(&self.input.xl_end.to_le_bytes());
        writer.put(&[dropped.min(255) as u8, newest.len() as u8]);
        write_samples(newest, writer.slot(newest.len() * XL_BYTES));
        let length = writer.len();
        buffer.0.get(..length).unwrap_or(&[])
    }
}

impl RawMessage {
    /// The taxels of `piezo` that are known: none where the array delivered nothing.
    pub const fn known(&self) -> Region {
        if self.health & health::PIEZO_MISSING == 0 { self.region } else { Region::NONE }
    }

    /// Was the bus too full for all that the array delivered?
    pub fn lacks_taxels(&self) -> bool {
        self.health & health::PIEZO_MISSING == 0 && self.region != Region::ALL
    }

    /// Read a message; bytes after it are padding and ignored.
    pub fn decode(bytes: &[u8]) -> Result<Self, DecodeError> {
        let mut reader = Reader::new(NAME, bytes);
        let timestamp_us = reader.unsigned::<7>()?;
        let sequence = u32::from_le_bytes(reader.take()?);
        let [sensor, health] = reader.take()?;
        reader.at_most("sensor", sensor, MAX_SENSORS - 1)?;
        let mut counts = [0; TAXELS];
        unpack_taxels(reader.slice(TAXEL_BYTES)?, &Region::ALL, &mut counts);
        let piezo = PiezoFrame::from_scan(counts);
        let xl_end = u32::from_le_bytes(reader.take()?);
        let [xl_dropped, samples] = reader.take()?;
        reader.at_most("xl", samples, RAW_XL_MAX)?;
        let mut xl = Vec::new();
        // There is room: `samples` is at most the capacity.
        let _ = xl.resize_default(samples.into());
        read_samples(reader.slice(usize::from(samples) * XL_BYTES)?, &mut xl);
        let region = Region::ALL;
        Ok(Self { timestamp_us, sequence, sensor, health, piezo, region, xl, xl_end, xl_dropped })
    }
}

/// 12-bit counts of the active taxels, two in three bytes.
fn pack(piezo: &PiezoFrame, bytes: &mut [u8]) {
    let mut triples = bytes.as_chunks_mut::<3>().0;
    for pairs in piezo.active_rows() {
        let Some((row, rest)) = triples.split_at_mut_checked(pairs.len()) else { return };
        triples = rest;
        // Four pairs are three words.
        let (fours, last) = row.as_chunks_mut::<4>();
        let (four_pairs, last_pairs) = pairs.as_chunks::<4>();
        for (four, pairs) in fours.iter_mut().zip(four_pairs) {
            let [a, b, c, d] = pairs.map(pack12);
            let words = [a | b << 24, b >> 8 | c << 16, c >> 16 | d << 8];
            for (to, word) in four.as_flattened_mut().as_chunks_mut().0.iter_mut().zip(words) {
                *to = word.to_le_bytes();
            }
        }
        for (triple, &pair) in last.iter_mut().zip(last_pairs) {
            let [low, middle, high, _] = pack12(pair).to_le_bytes();
            *triple = [low, middle, high];
        }
    }
}

/// Two 12-bit counts in 24 bits.
#[inline]
pub(super) fn pack12([left, right]: [u16; 2]) -> u32 {
    u32::from(left) | u32::from(right) << 12
}

/// 12-bit counts of the taxels in `region`, row by row, into `counts`.
pub(super) fn unpack_taxels(bytes: &[u8], region: &Region, counts: &mut [u16; TAXELS]) {
    let mut values = bytes.chunks(3).flat_map(|triple| {
        let pair = triple.iter().rev().fold(0, |value, &byte| value << 8 | u32::from(byte));
        [pair as u16 & COUNT_MAX, (pair >> 12) as u16]
    });
    for (row, cells) in counts.as_chunks_mut::<TAXEL_COLS>().0.iter_mut().enumerate() {
        let cells = cells.get_mut(region.cols(row)).unwrap_or_default();
        cells.iter_mut().zip(&mut values).for_each(|(cell, value)| *cell = value);
    }
}

pub(super) fn write_samples(samples: &[XlSample], out: &mut [u8]) {
    for (out, axis) in out.as_chunks_mut().0.iter_mut().zip(samples.as_flattened()) {
        *out = axis.to_le_bytes();
    }
}

pub(super) fn read_samples(bytes: &[u8], samples: &mut [XlSample]) {
    for (axis, bytes) in samples.as_flattened_mut().iter_mut().zip(bytes.as_chunks().0) {
        *axis = i16::from_le_bytes(*bytes);
    }
}
