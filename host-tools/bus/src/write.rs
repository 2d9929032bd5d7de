//! Frames to a candump log.

use std::io::{self, BufWriter, Write};

use slipsense::wire::CanFrame;
use thiserror::Error;

// Hand-made digits: with `write!` a log takes three times as long, and one second of two sensors is 2 MB.
const DIGITS: &[u8; 16] = b"0123456789ABCDEF";
// 64 bytes of data as digits, and everything before them with the longest interface name.
const LINE_MAX: usize = 256;
const BUFFER: usize = 1 << 16;

/// A name that would break the log's columns.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("CAN interface name {0:?}: need 1 to 15 letters, digits, '-' or '_'")]
pub struct InterfaceError(pub String);

/// Writes frames of one interface. Buffered: call [`CandumpWriter::finish`] at the end.
#[derive(Debug)]
pub struct CandumpWriter<W: Write> {
    out: BufWriter<W>,
    interface: String,
    line: Vec<u8>,
}

impl<W: Write> CandumpWriter<W> {
    /// A log on `out` of the interface of this name, for example `can0`.
    pub fn new(out: W, interface: &str) -> Result<Self, InterfaceError> {
        let legal = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        if !(1..=15).contains(&interface.len()) || !interface.chars().all(legal) {
            return Err(InterfaceError(interface.to_owned()));
        }
        Ok(Self {
            out: BufWriter::with_capacity(BUFFER, out),
            interface: interface.to_owned(),
            line: Vec::with_capacity(LINE_MAX),
        })
    }

    /// Append one frame, sent at `timestamp_us` microseconds since 1970.
    pub fn write(&mut self, timestamp_us: u64, frame: &CanFrame) -> io::Result<()> {
        let line = &mut self.line;
        line.clear();
        write!(
            line,
            "({:010}.{:06}) {} ",
            timestamp_us / 1_000_000,
            timestamp_us % 1_000_000,
            self.interface
        )?;
        frame.id().to_be_bytes().iter().for_each(|&byte| push_hex(line, byte));
        line.extend_from_slice(b"##1");
        frame.data().iter().for_each(|&byte| push_hex(line, byte));
        line.push(b'\n');
        self.out.write_all(line)
    }

    /// Write out what is buffered and return the writer below.
    pub fn finish(self) -> io::Result<W> {
        self.out.into_inner().map_err(io::IntoInnerError::into_error)
    }
}

fn push_hex(line: &mut Vec<u8>, byte: u8) {
    line.push(DIGITS[usize::from(byte >> 4)]);
    line.push(DIGITS[usize::from(byte & 15)]);
}
