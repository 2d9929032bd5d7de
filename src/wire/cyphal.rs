//! The transport: Cyphal/CAN version 1.0 (OpenCyphal specification, section 4.2) on CAN FD with
//! extended identifiers. A message is one transfer; a transfer is one frame, or several closed by a
//! CRC. The last byte of each frame, the tail byte, has the transfer identifier and the frame's position.

use core::fmt;

use super::id::{CAN_ID_MAX, MessageId, TransferId};
use crate::health::bits_if;

/// Data lengths that a CAN FD frame can have, bytes, by data length code.
pub const FD_LENGTHS: [u8; 16] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64];
/// Bytes of a full frame.
pub(super) const MTU: usize = 64;
/// Bytes of transfer that a full frame carries: all but the tail byte.
pub const FRAME_PAYLOAD: usize = MTU - 1;
/// Largest transfer identifier, 5 bits; also its mask.
pub(super) const TRANSFER_ID_MAX: u8 = 31;
/// Bytes of the CRC that closes a transfer of several frames.
pub(super) const CRC_BYTES: usize = 2;

/// Tail byte: this frame is the first of its transfer.
pub(super) const TAIL_START: u8 = 0x80;
/// Tail byte: this frame is the last of its transfer.
pub(super) const TAIL_END: u8 = 0x40;
/// Tail byte: 1 in the first frame, then alternating.
pub(super) const TAIL_TOGGLE: u8 = 0x20;

/// The shortest CAN FD data length that holds `bytes`, or `None` above 64.
pub fn fd_length(bytes: usize) -> Option<usize> {
    FD_LENGTHS.iter().map(|&length| length as usize).find(|&length| length >= bytes)
}

/// Start value of [`crc16`].
pub(super) const CRC_START: u16 = 0xFFFF;

/// CRC-16/CCITT-FALSE: polynomial 0x1021, start value 0xFFFF, no reflection, no final XOR. A transfer
/// followed by its CRC, high byte first, gives 0.
pub fn crc16(bytes: &[u8]) -> u16 {
    crc16_update(CRC_START, bytes)
}

/// [`crc16`] continued from `crc`.
pub(super) fn crc16_update(crc: u16, bytes: &[u8]) -> u16 {
    let [at_end, before_1, before_2, before_3] = &CRC_TABLES;
    let (fours, rest) = bytes.as_chunks::<4>();
    // Swapped, the register meets the first two of four bytes where they lie in their word.
    let crc = fours.iter().fold(crc.swap_bytes(), |crc, &four| {
        let word = u32::from_le_bytes(four) ^ u32::from(crc);
        let [a, b, c, d] = [0, 8, 16, 24].map(|shift| (word >> shift & 0xFF) as usize);
        before_3[a] ^ before_2[b] ^ before_1[c] ^ at_end[d]
    });
    let crc = rest.iter().fold(crc, |crc, &byte| (crc >> 8) ^ at_end[(crc as u8 ^ byte) as usize]);
    crc.swap_bytes()
}

/// What a byte with 0, 1, 2 and 3 bytes behind it does to a CRC, its bytes swapped. 2 KB: bit by bit, the CRC of one raw
/// frame costs 150,000 instructions, byte by byte with the first table 10,600.
static CRC_TABLES: [[u16; 256]; 4] = {
    let mut tables = [[0u16; 256]; 4];
    let mut index = 0;
    while index < 256 {
        let mut crc = (index as u16) << 8;
        let mut behind = 0;
        while behind < 4 {
            let mut bit = 0;
            while bit < 8 {
                crc = if crc & 0x8000 != 0 { (crc << 1) ^ 0x1021 } else { crc << 1 };
                bit += 1;
            }
            tables[behind][index] = crc.swap_bytes();
            behind += 1;
        }
        index += 1;
    }
    tables
};

/// One CAN FD frame with extended identifier and bit rate switching. Its data length is always one
/// that CAN FD can send.
#[derive(Clone, Copy, PartialEq, Eq)]
// In this order, so that the data lie on a word boundary and are copied by words.
#[repr(C)]
pub struct CanFrame {
    id: u32,
    // Zero beyond `length`, so that equal frames compare equal.
    data: [u8; MTU],
    length: u8,
}

/// Why a [`CanFrame`] cannot be made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the fields are named after what they are, and the text says it")]
pub enum LengthError {
    Id { id: u32 },
    Length { length: usize },
}

impl CanFrame {
    /// A frame as received. The length must be one of [`FD_LENGTHS`].
    pub fn new(id: u32, bytes: &[u8]) -> Result<Self, LengthError> {
        if id > CAN_ID_MAX {
            return Err(LengthError::Id { id });
        }
        let length = bytes.len();
        let mut data = [0; MTU];
        match (fd_length(length), data.get_mut(..length)) {
            (Some(valid), Some(out)) if valid == length => out.copy_from_slice(bytes),
            _ => return Err(LengthError::Length { length }),
        }
        Ok(Self { id, length: length as u8, data })
    }

    /// A whole transfer in one frame, padded with zeros. It carries no CRC: CAN's own covers it.
    pub(crate) fn single<const N: usize>(id: MessageId, transfer: u8, payload: &[u8; N]) -> Self {
        let length = const {
            assert!(N <= FRAME_PAYLOAD, "the message must fit one frame");
            let mut dlc = 0;
            while (FD_LENGTHS[dlc] as usize) < N + 1 {
                dlc += 1;
            }
            FD_LENGTHS[dlc]
        };
        let mut data = [0; MTU];
        data[..N].copy_from_slice(payload);
        data[length as usize - 1] = TAIL_START | TAIL_END | TAIL_TOGGLE | (transfer & TRANSFER_ID_MAX);
        Self { id: id.to_can(), length, data }
    }

    /// The 29-bit identifier.
    pub const fn id(&self) -> u32 {
        self.id
    }

    /// Is this the last frame of a Cyphal transfer?
    pub fn ends_transfer(&self) -> bool {
        self.data().last().is_some_and(|tail| tail & TAIL_END != 0)
    }

    /// The data, tail byte included; 0 to 64 bytes.
    pub fn data(&self) -> &[u8] {
        self.data.get(..self.length as usize).unwrap_or(&self.data)
    }
}

impl fmt::Debug for CanFrame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:08X}##1", self.id)?;
        self.data().iter().try_for_each(|byte| write!(f, "{byte:02X}"))
    }
}

/// The 5-bit transfer identifier to use now; the counter moves on.
pub(crate) fn next_transfer(counter: &mut u8) -> u8 {
    let now = *counter;
    *counter = now.wrapping_add(1) & TRANSFER_ID_MAX;
    now
}

/// The frames of one transfer, in the order they must be sent.
#[derive(Clone, Debug)]
pub struct Frames<'a> {
    segmenter: Segmenter,
    payload: &'a [u8],
}

impl<'a> Frames<'a> {
    /// Segment `payload` into frames. `transfer` is the transfer identifier, of which 5 bits are used.
    pub fn new(id: impl Into<TransferId>, transfer: u8, payload: &'a [u8]) -> Self {
        Self::with_payload(id, transfer, payload, FRAME_PAYLOAD)
    }

    /// As [`new`](Self::new), with `payload_per_frame` bytes in each full frame: one less than a length of CAN FD.
    pub(super) fn with_payload(
        id: impl Into<TransferId>,
        transfer: u8,
        payload: &'a [u8],
        payload_per_frame: usize,
    ) -> Self {
        Self { segmenter: Segmenter::new(id, transfer, payload, payload_per_frame), payload }
    }
}

impl Iterator for Frames<'_> {
    type Item = CanFrame;

    fn next(&mut self) -> Option<CanFrame> {
        self.segmenter.next(self.payload)
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        (self.segmenter.left, Some(self.segmenter.left))
    }
}

/// Segments a transfer into frames; its payload is passed again at every call.
#[derive(Clone, Debug)]
pub(super) struct Segmenter {
    id: u32,
    transfer: u8,
    crc: [u8; CRC_BYTES],
    /// Bytes of transfer in a full frame.
    payload_per_frame: usize,
    /// Bytes of the transfer without tail bytes: payload, padding and, in several frames, the CRC.
    total: usize,
    /// Bytes sent so far.
    at: usize,
    left: usize,
    toggle: bool,
}

impl Segmenter {
    pub(super) fn new(
        id: impl Into<TransferId>,
        transfer: u8,
        payload: &[u8],
        payload_per_frame: usize,
    ) -> Self {
        let per_frame = payload_per_frame.clamp(1, FRAME_PAYLOAD);
        let single = payload.len() <= per_frame;
        let bytes = payload.len() + if single { 0 } else { CRC_BYTES };
        let before_last = bytes.saturating_sub(1) / per_frame;
        let full = before_last * per_frame;
        // The last frame is padded to a length that CAN FD has, before the CRC, which covers the padding.
        let total = full + fd_length(bytes - full + 1).unwrap_or(MTU) - 1;
        let mut crc = 0;
        if !single {
            crc = (bytes..total).fold(crc16(payload), |crc, _| crc16_update(crc, &[0]));
        }
        Self {
            id: id.into().to_can(),
            transfer: transfer & TRANSFER_ID_MAX,
            crc: crc.to_be_bytes(),
            payload_per_frame: per_frame,
            total,
            at: 0,
            left: before_last + 1,
            toggle: true,
        }
    }

    /// The next frame; `None` after the last.
    pub(super) fn next(&mut self, payload: &[u8]) -> Option<CanFrame> {
        self.left = self.left.checked_sub(1)?;
        let bytes = self.payload_per_frame.min(self.total - self.at);
        let rest = payload.get(self.at..).unwrap_or(&[]);
        let mut data = match rest.first_chunk::<MTU>() {
            Some(full) => {
                let mut data = copied(full);
                // In a full frame the one byte too many is where the tail byte goes.
                if bytes < FRAME_PAYLOAD {
                    data.get_mut(bytes..).unwrap_or_default().fill(0);
                }
                data
            }
            None => {
                let mut data = [0; MTU];
                for (out, &byte) in data.iter_mut().zip(rest.iter().take(bytes)) {
                    *out = byte;
                }
                data
            }
        };
        // The last frame or the last two.
        if self.total > self.payload_per_frame && self.left < 2 {
            for (index, &byte) in (self.total - CRC_BYTES..).zip(&self.crc) {
                let slot = index.checked_sub(self.at).filter(|&slot| slot < bytes);
                if let Some(out) = slot.and_then(|slot| data.get_mut(slot)) {
                    *out = byte;
                }
            }
        }
        if let Some(tail) = data.get_mut(bytes) {
            *tail = self.transfer
                | bits_if(self.at == 0, TAIL_START)
                | bits_if(self.left == 0, TAIL_END)
                | bits_if(self.toggle, TAIL_TOGGLE);
        }
        self.toggle = !self.toggle;
        self.at += bytes;
        Some(CanFrame { id: self.id, length: bytes as u8 + 1, data })
    }
}

/// Sixteen bytes at a time, which are copied by words: a payload begins at any byte, and from there a copy of all of it
/// by the library takes three times the instructions.
#[inline]
fn copied(bytes: &[u8; MTU]) -> [u8; MTU] {
    let [a, b, c, d]: &[[u8; MTU / 4]; 4] = bytemuck::must_cast_ref(bytes);
    bytemuck::must_cast([*a, *b, *c, *d])
}

impl ExactSizeIterator for Frames<'_> {}

impl fmt::Display for LengthError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Id { id } => write!(f, "identifier {id:X} has more than 29 bits"),
            Self::Length { length } => write!(f, "CAN FD has no data length of {length} bytes"),
        }
    }
}

impl core::error::Error for LengthError {}
