//! A frame as the levels on the bus, in order, stuff bits included.

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
    /// Is it a stuff bit, dynamic or fixed?
    pub stuff: bool,
}

/// How many bits of each kind. The intermission after the frame is not among them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameBits {
    pub nominal: u32,
    pub data: u32,
    /// Was the rate switched? Then two more bits, BRS and CRC delimiter, are each split at their sample point.
    pub switched: bool,
    pub dynamic_stuff: u32,
    pub fixed_stuff: u32,
}

impl FrameBits {
    /// Bits from start of frame to end of frame.
    pub const fn total(&self) -> u32 {
        self.nominal + self.data + 2 * self.switched as u32
    }

    pub(crate) const fn count(&mut self, rate: Rate) {
        match rate {
            Rate::Nominal => self.nominal += 1,
            Rate::Data => self.data += 1,
            Rate::ToData => self.switched = true,
            Rate::ToNominal => {}
        }
    }

    pub fn of(frame: &Frame) -> Self {
        let mut bits = Self::default();
        for bit in WireBits::new(frame) {
            bits.count(bit.rate);
            bits.dynamic_stuff += (bit.stuff && bit.field != Field::Crc) as u32;
            bits.fixed_stuff += (bit.stuff && bit.field == Field::Crc) as u32;
        }
        if !frame.format().is_fd() {
            // A classic frame's checksum is stuffed like the rest.
            bits.dynamic_stuff += core::mem::take(&mut bits.fixed_stuff);
        }
        bits
    }
}

/// Equal bits in a row after which a stuff bit follows.
pub(crate) const RUN: u8 = 5;
/// Bits between two fixed stuff bits.
const FIXED_DISTANCE: u32 = 4;
/// CRC delimiter, ACK slot, ACK delimiter, end of frame: never stuffed.
const TAIL: [Field; 10] = {
    let mut tail = [Field::End; 10];
    tail[0] = Field::CrcDelimiter;
    tail[1] = Field::AckSlot;
    tail[2] = Field::AckDelimiter;
    tail
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

    pub fn field(&self, index: u32) -> Field {
        match index {
            0 => Field::Start,
            _ if index < self.arbitration => Field::Arbitration,
            _ => Field::Control,
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

#[derive(Clone, Copy, Debug)]
enum Stage {
    /// Header and data; next of them.
    Stuffed(u32),
    /// Checksum field without its stuff bits; next of them.
    Checksum(u32),
    Tail(usize),
}

/// Iterator over the bits of a frame, from start of frame to the last bit of end of frame.
#[derive(Clone, Debug)]
pub struct WireBits<'a> {
    frame: &'a Frame,
    header: Header,
    crc: Crc,
    register: u32,
    stage: Stage,
    /// Level of the last bit and how many like it came in a row.
    last: bool,
    run: u8,
    dynamic_stuff: u32,
    /// The checksum field, once known.
    checksum: u32,
    checksum_len: u32,
    /// Was the fixed stuff bit before the next checksum bit sent?
    fixed_sent: bool,
}

impl<'a> WireBits<'a> {
    pub fn new(frame: &'a Frame) -> Self {
        let crc = crc_of(frame.format(), frame.data().len());
        Self {
            frame,
            header: Header::of(frame),
            crc,
            register: crc.start,
            stage: Stage::Stuffed(0),
            last: true,
            run: 0,
            dynamic_stuff: 0,
            checksum: 0,
            checksum_len: 0,
            fixed_sent: false,
        }
    }

    fn is_fd(&self) -> bool {
        self.frame.format().is_fd()
    }

    fn stuffed_len(&self) -> u32 {
        self.header.len + 8 * self.frame.data().len() as u32
    }

    fn rate_after_brs(&self) -> Rate {
        if self.frame.format().switches() { Rate::Data } else { Rate::Nominal }
    }

    /// Rate of header and data bit `index`; `stuff`: of the stuff bit after it.
    fn rate(&self, index: u32, stuff: bool) -> Rate {
        if !self.is_fd() || index < self.header.brs() {
            Rate::Nominal
        } else if index == self.header.brs() && !stuff && self.frame.format().switches() {
            Rate::ToData
        } else {
            self.rate_after_brs()
        }
    }

    fn send(&mut self, level: bool) -> bool {
        self.run = if level == self.last { self.run + 1 } else { 1 };
        self.last = level;
        level
    }

    fn stuffed_field(&self, index: u32) -> Field {
        if index < self.header.len { self.header.field(index) } else { Field::Data }
    }

    fn stuffed(&mut self, index: u32) -> WireBit {
        // Not after the last bit of a CAN FD data field: the fixed stuff bit stands there.
        if self.run == RUN && index > 0 {
            let level = self.send(!self.last);
            self.dynamic_stuff += 1;
            if self.is_fd() {
                self.register = self.crc.next(self.register, level);
            }
            let before = index - 1;
            let (field, rate) = (self.stuffed_field(before), self.rate(before, true));
            return WireBit { level, field, rate, stuff: true };
        }
        let level = if index < self.header.len {
            self.header.level(index)
        } else {
            let bit = (index - self.header.len) as usize;
            self.frame.data()[bit / 8] >> (7 - bit % 8) & 1 != 0
        };
        self.register = self.crc.next(self.register, level);
        self.stage = Stage::Stuffed(index + 1);
        WireBit {
            level: self.send(level),
            field: self.stuffed_field(index),
            rate: self.rate(index, false),
            stuff: false,
        }
    }

    fn seal(&mut self) {
        self.checksum_len = self.crc.width;
        if self.is_fd() {
            let count = stuff_count_field(self.dynamic_stuff);
            for bit in (0..4).rev() {
                self.register = self.crc.next(self.register, count >> bit & 1 != 0);
            }
            self.checksum = count << self.crc.width | self.register;
            self.checksum_len += 4;
        } else {
            self.checksum = self.register;
        }
        self.stage = Stage::Checksum(0);
    }

    fn checksum(&mut self, index: u32) -> WireBit {
        let rate = if self.is_fd() { self.rate_after_brs() } else { Rate::Nominal };
        let stuff = if self.is_fd() {
            index.is_multiple_of(FIXED_DISTANCE) && !core::mem::replace(&mut self.fixed_sent, true)
        } else {
            self.run == RUN
        };
        if stuff {
            let level = self.send(!self.last);
            let field = if index == 0 && !self.is_fd() {
                self.stuffed_field(self.stuffed_len() - 1)
            } else {
                Field::Crc
            };
            return WireBit { level, field, rate, stuff };
        }
        self.fixed_sent = false;
        let level = self.send(self.checksum >> (self.checksum_len - 1 - index) & 1 != 0);
        self.stage = Stage::Checksum(index + 1);
        WireBit { level, field: Field::Crc, rate, stuff: false }
    }
}

impl Iterator for WireBits<'_> {
    type Item = WireBit;

    fn next(&mut self) -> Option<WireBit> {
        if let Stage::Stuffed(index) = self.stage {
            if index < self.stuffed_len() {
                return Some(self.stuffed(index));
            }
            self.seal();
        }
        if let Stage::Checksum(index) = self.stage {
            if index < self.checksum_len || !self.is_fd() && self.run == RUN {
                return Some(self.checksum(index));
            }
            self.stage = Stage::Tail(0);
        }
        let Stage::Tail(index) = self.stage else { return None };
        let field = *TAIL.get(index)?;
        self.stage = Stage::Tail(index + 1);
        let back = field == Field::CrcDelimiter && self.frame.format().switches();
        let rate = if back { Rate::ToNominal } else { Rate::Nominal };
        Some(WireBit { level: field != Field::AckSlot, field, rate, stuff: false })
    }
}
