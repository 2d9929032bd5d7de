//! The message around the coded bytes.

use heapless::Vec;

use super::range::{Decoder, Encoder};
use super::{taxels, xl};
use crate::params::{ACTIVE_TAXELS, MAX_SENSORS, TAXEL_COLS, TAXELS, XL_AXES};
use crate::sensor::{PiezoFrame, XlSample};
use crate::wire::bytes::{DecodeError, Reader, Writer};
use crate::wire::cyphal::{crc16, crc16_update};
use crate::wire::raw::{
    RAW_BUFFER_BYTES, RAW_XL_MAX, RawBuffer, RawFrame, RawMessage, pack12, read_samples, unpack_taxels,
    write_samples,
};
use crate::wire::region::Region;

/// Subject identifier of a [`RawFrame`] compressed: `slipsense.RawCompressed.1.0`, all sensors.
pub const COMPRESSED_PORT: u16 = 6202;

/// Bytes of a full CAN frame of a compressed raw message. Not 64: a slip message waits for the frame on the wire, and at
/// 1/8 Mbit/s both together may take a quarter of a millisecond. That takes a seventh more of the bus.
pub const COMPRESSED_FRAME_BYTES: usize = 48;
/// Bytes of the longest compressed message: that of a frame which compressing would make longer.
pub const COMPRESSED_BYTES_MAX: usize =
    HEADER_BYTES + (ACTIVE_TAXELS * 3).div_ceil(2) + RAW_XL_MAX * XL_AXES * 2;
const _: () = assert!(COMPRESSED_BYTES_MAX == RAW_BUFFER_BYTES, "a buffer has room for either form");
/// Header bytes before the check.
const CHECK_AT: usize = 7 + 4 + 1 + 1 + 4 + 1 + 1 + 1;
const CHECK_BYTES: usize = 2;
/// Bytes before the data: also their length.
const HEADER_BYTES: usize = CHECK_AT + CHECK_BYTES + 2;

const NAME: &str = "slipsense.RawCompressed";

/// `form` bit: the data are coded; else they are packed, samples of 16 bits and then counts of 12.
const FORM_CODED: u8 = 1;
/// `form` bit: of the taxels only a region, which the first bytes of the data give.
const FORM_REGION: u8 = 2;
/// `form` bit: no taxels.
const FORM_NO_TAXELS: u8 = 4;
const FORM_ALL: u8 = FORM_CODED | FORM_REGION | FORM_NO_TAXELS;
/// First row, rows, first column, columns.
const REGION_BYTES: usize = 4;

/// Coding is given up when it is this many bytes longer than packing so far.
const SLACK_BYTES: usize = 32;

/// How much of a frame a message carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Detail {
    /// The accelerometer alone.
    Accelerometer,
    /// Also the taxels of the rectangle around the contact.
    Contact,
    /// Everything.
    All,
}

impl RawFrame<'_> {
    /// As [`encode`](Self::encode), compressed: see [`compress`](crate::wire::compress).
    pub fn compress<'b>(&self, detail: Detail, buffer: &'b mut RawBuffer) -> &'b [u8] {
        let (newest, dropped) = self.newest_samples();
        let region = match (self.input.piezo, detail) {
            (None, _) | (_, Detail::Accelerometer) => Region::NONE,
            (Some(piezo), Detail::Contact) => Region::around_contact(piezo),
            (Some(_), Detail::All) => Region::ALL,
        };
        let mut form = match region {
            Region::ALL => 0,
            Region::NONE => FORM_NO_TAXELS,
            _ => FORM_REGION,
        };
        let masked;
        let counts = match self.input.piezo {
            Some(piezo) if region == Region::ALL => piezo.counts(),
            piezo => {
                masked = counts_in(piezo, &region);
                &masked
            }
        };

        let (header, data) = buffer.0.split_at_mut(HEADER_BYTES);
        let start = if form == FORM_REGION { REGION_BYTES } else { 0 };
        let (region_bytes, body) = data.split_at_mut(start);
        for (out, byte) in region_bytes.iter_mut().zip(region.to_bytes()) {
            *out = byte;
        }
        let length = match code(newest, &region, counts, body) {
            Some(length) => {
                form |= FORM_CODED;
                length
            }
            None => pack(newest, &region, counts, body),
        };
        let length = start + length;

        let mut writer = Writer::new(header);
        writer.put_saturated::<7>(self.timestamp_us);
        writer.put(&self.sequence.to_le_bytes());
        writer.put(&[self.sensor, self.full_health()]);
        writer.put(&self.input.xl_end.to_le_bytes());
        writer.put(&[dropped.min(255) as u8, newest.len() as u8, form]);
        writer.put(&[0; CHECK_BYTES]);
        writer.put(&(length as u16).to_le_bytes());
        let check = check(buffer.bytes(HEADER_BYTES + length));
        let mut writer = Writer::new(buffer.0.get_mut(CHECK_AT..).unwrap_or_default());
        writer.put(&check.to_le_bytes());
        buffer.bytes(HEADER_BYTES + length)
    }
}

impl RawMessage {
    /// Read a compressed message; bytes after it are padding and ignored.
    pub fn decompress(bytes: &[u8]) -> Result<Self, DecodeError> {
        let mut reader = Reader::new(NAME, bytes);
        let timestamp_us = reader.unsigned::<7>()?;
        let sequence = u32::from_le_bytes(reader.take()?);
        let [sensor, health] = reader.take()?;
        reader.at_most("sensor", sensor, MAX_SENSORS - 1)?;
        let xl_end = u32::from_le_bytes(reader.take()?);
        let [xl_dropped, count, form] = reader.take()?;
        reader.at_most("xl_count", count, RAW_XL_MAX)?;
        reader.at_most("form", form, FORM_ALL.into())?;
        let expected = u16::from_le_bytes(reader.take()?);
        let length = u16::from_le_bytes(reader.take()?);
        let mut data = reader.slice(length.into())?;

        let damaged = DecodeError::Damaged { message: NAME };
        if check(bytes.get(..HEADER_BYTES + data.len()).unwrap_or_default()) != expected {
            return Err(damaged);
        }
        let region = match form & (FORM_REGION | FORM_NO_TAXELS) {
            0 => Region::ALL,
            FORM_REGION => {
                let (region, rest) = data.split_first_chunk::<REGION_BYTES>().ok_or(damaged)?;
                data = rest;
                Region::from_bytes(*region).ok_or(damaged)?
            }
            FORM_NO_TAXELS => Region::NONE,
            _ => return Err(damaged),
        };
        let mut counts = [0; TAXELS];
        let mut xl: Vec<XlSample, RAW_XL_MAX> = Vec::new();
        // There is room: `count` is at most the capacity.
        let _ = xl.resize_default(count.into());
        let whole = match form & FORM_CODED {
            0 => unpack(data, &mut xl, &region, &mut counts),
            _ => {
                let mut decoder = Decoder::new(data);
                xl::decode(&mut decoder, &mut xl);
                taxels::decode(&mut decoder, &region, &mut counts) && decoder.is_at_end()
            }
        };
        if !whole {
            return Err(damaged);
        }
        let piezo = PiezoFrame::from_scan(counts);
        Ok(Self { timestamp_us, sequence, sensor, health, piezo, region, xl, xl_end, xl_dropped })
    }
}

/// The counts in the region, 0 elsewhere.
fn counts_in(piezo: Option<&PiezoFrame>, region: &Region) -> [u16; TAXELS] {
    let mut counts = [0; TAXELS];
    let scan = piezo.map_or(&[][..], |piezo| piezo.counts().as_chunks::<TAXEL_COLS>().0);
    for (row, (to, from)) in counts.as_chunks_mut::<TAXEL_COLS>().0.iter_mut().zip(scan).enumerate() {
        let cols = region.cols(row);
        if let (Some(to), Some(from)) = (to.get_mut(cols.clone()), from.get(cols)) {
            to.copy_from_slice(from);
        }
    }
    counts
}

/// Code into `body`; the bytes used, `None` where packing takes fewer.
fn code(samples: &[XlSample], region: &Region, counts: &[u16; TAXELS], body: &mut [u8]) -> Option<usize> {
    let packed = packed_bytes(samples.len(), region.taxels());
    let mut encoder = Encoder::new(body.get_mut(..packed.checked_sub(1)?)?);
    xl::encode(&mut encoder, samples);
    let samples = samples.len();
    let is_shorter = |encoder: &Encoder<'_>, taxels| {
        encoder.len().is_some_and(|length| length <= packed_bytes(samples, taxels) + SLACK_BYTES)
    };
    if taxels::encode(&mut encoder, region, counts, is_shorter) { encoder.finish() } else { None }
}

fn packed_bytes(samples: usize, taxels: usize) -> usize {
    samples * XL_AXES * 2 + (taxels * 3).div_ceil(2)
}

/// Samples of 16 bits, then counts of 12, low bits first; the bytes used.
fn pack(samples: &[XlSample], region: &Region, counts: &[u16; TAXELS], body: &mut [u8]) -> usize {
    let length = packed_bytes(samples.len(), region.taxels());
    let (xl, taxels) = body.split_at_mut_checked(samples.len() * XL_AXES * 2).unwrap_or_default();
    write_samples(samples, xl);
    let mut counts = cells(region, counts);
    for out in taxels.chunks_mut(3) {
        let Some(low) = counts.next() else { break };
        let pair = pack12([low, counts.next().unwrap_or(0)]);
        for (out, byte) in out.iter_mut().zip(pair.to_le_bytes()) {
            *out = byte;
        }
    }
    length
}

/// The reverse of [`pack`]. `false`: not the right number of bytes.
fn unpack(data: &[u8], xl: &mut [XlSample], region: &Region, counts: &mut [u16; TAXELS]) -> bool {
    if data.len() != packed_bytes(xl.len(), region.taxels()) {
        return false;
    }
    let (samples, taxels) = data.split_at_checked(xl.len() * XL_AXES * 2).unwrap_or_default();
    read_samples(samples, xl);
    unpack_taxels(taxels, region, counts);
    true
}

/// The counts of a region, row by row.
fn cells<'a>(region: &Region, counts: &'a [u16; TAXELS]) -> impl Iterator<Item = u16> + 'a {
    let region = *region;
    let rows = counts.as_chunks::<TAXEL_COLS>().0.iter().enumerate();
    rows.flat_map(move |(row, cells)| cells.get(region.cols(row)).unwrap_or_default()).copied()
}

/// CRC of all bytes of a message but the check itself, because the transfer's CRC is not stored with a message. Detects
/// any change of one byte.
fn check(message: &[u8]) -> u16 {
    let header = crc16(message.get(..CHECK_AT).unwrap_or_default());
    crc16_update(header, message.get(CHECK_AT + CHECK_BYTES..).unwrap_or_default())
}
