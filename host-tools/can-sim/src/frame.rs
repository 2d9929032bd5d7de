//! A frame as a node hands it to its controller.

use slipsense::wire::FD_LENGTHS;

pub const MAX_DATA: usize = 64;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Id {
    /// 11 bits.
    Standard(u16),
    /// 29 bits.
    Extended(u32),
}

impl Id {
    /// The 11 bits that every frame sends first.
    pub const fn base(self) -> u16 {
        match self {
            Self::Standard(id) => id,
            Self::Extended(id) => (id >> 18) as u16,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Classical CAN, up to 8 bytes.
    Classic,
    /// Classical CAN, a request: a length and no data field.
    Remote,
    /// CAN FD, up to 64 bytes.
    Fd {
        /// Data phase at its own bit rate (BRS)?
        bit_rate_switch: bool,
        /// Is the sender error passive (ESI)?
        error_passive: bool,
    },
}

impl Format {
    /// CAN FD with bit rate switching of an error-active node: what this project sends.
    pub const FD: Self = Self::Fd { bit_rate_switch: true, error_passive: false };

    pub const fn is_fd(self) -> bool {
        matches!(self, Self::Fd { .. })
    }

    /// Does the data phase have a bit rate of its own?
    pub const fn switches(self) -> bool {
        matches!(self, Self::Fd { bit_rate_switch: true, .. })
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameError {
    /// The identifier has more than 11 or 29 bits.
    Id,
    /// No data length code means this many bytes in this format.
    Length(usize),
}

/// A frame, at most 64 bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame {
    id: Id,
    format: Format,
    dlc: u8,
    data: [u8; MAX_DATA],
}

impl Frame {
    pub fn new(id: Id, format: Format, data: &[u8]) -> Result<Self, FrameError> {
        let dlc = dlc_of(data.len(), format.is_fd()).ok_or(FrameError::Length(data.len()))?;
        if format == Format::Remote && !data.is_empty() {
            return Err(FrameError::Length(data.len()));
        }
        let mut frame = Self::with_dlc(id, format, dlc)?;
        frame.data[..data.len()].copy_from_slice(data);
        Ok(frame)
    }

    /// A frame of zeros with this data length code, 0 to 15. In a remote frame it is the length asked for; in a
    /// classic one 9 to 15 mean 8 bytes.
    pub const fn with_dlc(id: Id, format: Format, dlc: u8) -> Result<Self, FrameError> {
        let fits = match id {
            Id::Standard(id) => id < 1 << 11,
            Id::Extended(id) => id < 1 << 29,
        };
        if !fits {
            return Err(FrameError::Id);
        }
        if dlc > 15 {
            return Err(FrameError::Length(dlc as usize));
        }
        Ok(Self { id, format, dlc, data: [0; MAX_DATA] })
    }

    pub const fn id(&self) -> Id {
        self.id
    }

    pub const fn format(&self) -> Format {
        self.format
    }

    /// Data length code, 0 to 15.
    pub const fn dlc(&self) -> u8 {
        self.dlc
    }

    pub fn data(&self) -> &[u8] {
        &self.data[..self.data_len()]
    }

    pub fn data_mut(&mut self) -> &mut [u8] {
        let len = self.data_len();
        &mut self.data[..len]
    }

    const fn data_len(&self) -> usize {
        match self.format {
            Format::Remote => 0,
            format => len_of(self.dlc, format.is_fd()),
        }
    }

    /// The arbitration field as a number: of two frames that start together the lower one goes on, because its
    /// first differing bit is dominant. Equal for frames that arbitration cannot tell apart.
    ///
    /// Base identifier, RTR/RRS or SRR, IDE, then for 29 bits the rest of the identifier and RTR/RRS.
    pub const fn arbitration_field(&self) -> u32 {
        let remote = matches!(self.format, Format::Remote) as u32;
        let base = (self.id.base() as u32) << 21;
        match self.id {
            Id::Standard(_) => base | remote << 20,
            Id::Extended(id) => base | 0b11 << 19 | (id & 0x3_FFFF) << 1 | remote,
        }
    }
}

/// Bytes that a data length code (0 to 15) means.
pub const fn len_of(dlc: u8, fd: bool) -> usize {
    let len = FD_LENGTHS[dlc as usize % FD_LENGTHS.len()] as usize;
    if fd || len < 8 { len } else { 8 }
}

/// The data length code that means exactly `len` bytes.
pub fn dlc_of(len: usize, fd: bool) -> Option<u8> {
    (0..if fd { 16 } else { 9 }).find(|&dlc| len_of(dlc, fd) == len)
}
