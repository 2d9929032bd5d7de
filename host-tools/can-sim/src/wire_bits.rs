//! A frame as the levels on the bus, in order, stuff bits included.

use core::cmp::Ordering;

use crate::crc::{CRC_15, CRC_17, CRC_21, Crc};
use crate::frame::{Format, Frame, Id};

/// Which part of the frame a bit belongs to; a stuff bit belongs to the bit before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Field {
    Start,
    /// Identifier, RTR/SRR/RRS and IDE: what arbitration compares.
    Arbitration,
    /// From FDF to the data length code.
    Control,
    Data,
    /// CAN FD's count of stuff bits, its parity, checksum and fixed stuff bits; in a classic frame the checksum.
    Crc,
    CrcDelimiter,
    /// Where receivers answer.
    AckSlot,
    AckDelimiter,
    End,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rate {
    /// Arbitration's.
    Nominal,
    /// BRS: nominal up to its sample point, then data.
    ToData,
    Data,
    /// CRC delimiter after a switch: data up to its sample point, then nominal.
    ToNominal,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WireBit {
    /// `true`: recessive.
    pub level: bool,
    pub field: Field,
    pub rate: Rate,
    /// A stuff bit after a run of equal bits; not a fixed one of CAN FD's checksum field.
    pub dynamic_stuff: bool,
}

/// How many bits of each kind. The intermission after the frame is not among them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameBits {
    pub nominal: u32,
    pub data: u32,
    /// Was the rate switched? Then two more bits, BRS and CRC delimiter, are each split at their sample point.
    pub switched: bool,
    pub dynamic_stuff: u32,
}

impl FrameBits {
    /// Bits from start of frame to end of frame.
    pub const fn total(&self) -> u32 {
        self.nominal + self.data + 2 * self.switched as u32
    }

    pub(crate) const fn count(&mut self, bit: WireBit) {
        match bit.rate {
            Rate::Nominal => self.nominal += 1,
            Rate::Data => self.data += 1,
            Rate::ToData => self.switched = true,
            Rate::ToNominal => {}
        }
        self.dynamic_stuff += bit.dynamic_stuff as u32;
    }

    pub fn of(frame: &Frame) -> Self {
        let mut bits = Self::default();
        wire_bits(frame, |bit| bits.count(bit));
        bits
    }
}

/// Equal bits in a row after which a stuff bit follows.
pub(crate) const RUN: u8 = 5;
/// Bits between two fixed stuff bits.
const FIXED_DISTANCE: u32 = 4;
/// CRC delimiter, ACK slot, ACK delimiter, end of frame: never stuffed.
const TAIL: [Field; 10] = {
    use Field::{AckDelimiter, AckSlot, CrcDelimiter, End};
    [CrcDelimiter, AckSlot, AckDelimiter, End, End, End, End, End, End, End]
};

/// The bits before the data field, unstuffed: at most 41, the first in the highest place of `len`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Header {
    bits: u64,
    pub len: u32,
    /// Length of start and arbitration field.
    arbitration: u32,
}

impl Header {
    pub fn of(frame: &Frame) -> Self {
        let mut header = Self { bits: 0, len: 0, arbitration: 0 };
        let remote = frame.format() == Format::Remote;
        header.push(0, 1);
        header.push(frame.id().base().into(), 11);
        if let Id::Extended(id) = frame.id() {
            // SRR and IDE.
            header.push(0b11, 2);
            header.push((id & 0x3_FFFF).into(), 18);
            header.push(remote.into(), 1);
        } else {
            header.push(remote.into(), 1);
            // IDE.
            header.push(0, 1);
        }
        header.arbitration = header.len;
        match frame.format() {
            Format::Fd { bit_rate_switch, error_passive } => {
                // FDF, res, BRS, ESI.
                header.push(0b10, 2);
                header.push(bit_rate_switch.into(), 1);
                header.push(error_passive.into(), 1);
            }
            // FDF and r0.
            _ if matches!(frame.id(), Id::Extended(_)) => header.push(0, 2),
            _ => header.push(0, 1),
        }
        header.push(frame.dlc().into(), 4);
        header
    }

    const fn push(&mut self, value: u64, len: u32) {
        self.bits = self.bits << len | value;
        self.len += len;
    }

    pub fn level(&self, index: u32) -> bool {
        self.bits >> (self.len - 1 - index) & 1 != 0
    }

    /// Of a bit of header or data field.
    pub fn field(&self, index: u32) -> Field {
        match index {
            0 => Field::Start,
            _ if index < self.arbitration => Field::Arbitration,
            _ if index < self.len => Field::Control,
            _ => Field::Data,
        }
    }

    /// Place of BRS.
    pub fn brs(&self) -> u32 {
        self.len - 6
    }
}

/// The checksum of a format with this many data bytes.
pub(crate) const fn crc_of(format: Format, len: usize) -> Crc {
    match format {
        Format::Fd { .. } if len > 16 => CRC_21,
        Format::Fd { .. } => CRC_17,
        _ => CRC_15,
    }
}

/// Stuff count field: dynamic stuff bits modulo 8 in Gray code, then even parity.
const fn stuff_count_field(dynamic_stuff: u32) -> u32 {
    let count = dynamic_stuff % 8;
    let gray = count ^ count >> 1;
    (gray << 1) | (gray.count_ones() % 2)
}

/// Hands every bit of a frame to `emit`, from start of frame to the last bit of end of frame.
pub fn wire_bits(frame: &Frame, mut emit: impl FnMut(WireBit)) {
    let (fd, switches, data) = (frame.format().is_fd(), frame.format().switches(), frame.data());
    let (header, crc) = (Header::of(frame), crc_of(frame.format(), data.len()));
    let (mut last, mut run) = (true, 0);
    // Is it the last of a full run of equal bits?
    let mut send = |level, field, rate, dynamic_stuff| {
        run = if level == last { run + 1 } else { 1 };
        last = level;
        emit(WireBit { level, field, rate, dynamic_stuff });
        run == RUN
    };

    let (mut register, mut dynamic_stuff, mut level) = (crc.start, 0, true);
    let stuffed_len = header.len + 8 * data.len() as u32;
    for index in 0..stuffed_len {
        let field = header.field(index);
        level = match index.checked_sub(header.len) {
            None => header.level(index),
            Some(bit) => data[bit as usize / 8] >> (7 - bit % 8) & 1 != 0,
        };
        register = crc.next(register, level);
        let (rate, rate_behind) = match index.cmp(&header.brs()) {
            Ordering::Equal if switches => (Rate::ToData, Rate::Data),
            Ordering::Greater if switches => (Rate::Data, Rate::Data),
            _ => (Rate::Nominal, Rate::Nominal),
        };
        let is_run = send(level, field, rate, false);
        // Not after the last bit of a CAN FD data field: the fixed stuff bit stands there.
        if is_run && !(fd && index + 1 == stuffed_len) {
            dynamic_stuff += 1;
            send(!level, field, rate_behind, true);
            if fd {
                register = crc.next(register, !level);
            }
        }
    }

    let (mut checksum, mut checksum_len) = (register, crc.width);
    if fd {
        let count = stuff_count_field(dynamic_stuff);
        let add = |register, bit: u32| crc.next(register, count >> bit & 1 != 0);
        checksum = count << crc.width | (0..4).rev().fold(register, add);
        checksum_len += 4;
    }
    let rate = if switches { Rate::Data } else { Rate::Nominal };
    for index in 0..checksum_len {
        if fd && index.is_multiple_of(FIXED_DISTANCE) {
            send(!level, Field::Crc, rate, false);
        }
        level = checksum >> (checksum_len - 1 - index) & 1 != 0;
        if send(level, Field::Crc, rate, false) && !fd {
            send(!level, Field::Crc, rate, true);
        }
    }

    for field in TAIL {
        let back = field == Field::CrcDelimiter && switches;
        let rate = if back { Rate::ToNominal } else { Rate::Nominal };
        send(field != Field::AckSlot, field, rate, false);
    }
}
