//! CAN FD traffic as a candump log, the text format of Linux' can-utils, which python-can, pycyphal and
//! SavvyCAN read too. One frame a line:
//!
//! ```text
//! (1700000000.004167) can0 0478382A##1002D3104...
//! ```
//!
//! Seconds since 1970 with microseconds, interface, identifier in hexadecimal (8 digits: 29 bits), two
//! number signs for CAN FD, one digit of flags (1: bit rate switching), data in hexadecimal.

use std::collections::BTreeMap;
use std::io::{self, BufRead, BufWriter, Read, Write};

use slipsense::wire::{COMPRESSED_PORT, CanFrame, LengthError, MessageId, RAW_PORT, SLIP_1_PORT, SLIP_PORT};
use thiserror::Error;

use crate::unhex;

/// Most digits of a fraction that count: microseconds.
const FRACTION_DIGITS: usize = 6;

/// A frame that no fingertip module sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Foreign {
    /// Classic CAN, or a line of a log that is one.
    Classic,
    /// CAN FD with an identifier of 11 bits.
    Standard,
    /// An error frame of the kernel: the controller's state, or what went wrong on the bus.
    Error,
    /// A line of an slcan adapter that makes no sense: bytes were lost.
    Unreadable,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogEntry {
    /// Microseconds since 1970; finer digits are dropped.
    pub timestamp_us: u64,
    pub interface: String,
    pub frame: CanFrame,
}

/// A line that cannot be used.
#[derive(Debug, Error)]
#[error("line {line}: {rule}")]
pub struct CandumpError {
    /// Number of the line, from 1.
    pub line: usize,
    pub rule: Rule,
}

/// What a line of a log must be.
#[derive(Debug, Error)]
pub enum Rule {
    #[error("cannot be read: {0}")]
    Io(#[from] io::Error),
    /// Classic CAN, remote or 11-bit frames are legal on a bus and in a log, but none of ours.
    #[error("not a CAN FD frame with a 29-bit identifier")]
    NotOurs,
    #[error("longer than {LINE_BYTES_MAX} bytes")]
    TooLong,
    #[error("node {node} speaks on {first} and on {second}: two modules, of which a recording may hold one")]
    SecondInterface { node: u8, first: String, second: String },
    /// What a part of the line must be.
    #[error("{0}")]
    Format(String),
}

/// With its end; candump's have less than 200.
const LINE_BYTES_MAX: usize = 4096;
const COLUMNS: &str = "need '(TIME) INTERFACE ID##FLAGS DATA' in three columns";
const FLAGS: &str = "need one hexadecimal digit of flags after '##'";
const DATA: &str = "data: need pairs of hexadecimal digits";

fn malformed(need: impl ToString) -> Rule {
    Rule::Format(need.to_string())
}

/// The identifier of a slip or raw message.
pub(crate) fn message_id(frame: &CanFrame) -> Option<MessageId> {
    let ours = |id: &MessageId| matches!(id.port, SLIP_PORT | SLIP_1_PORT | RAW_PORT | COMPRESSED_PORT);
    MessageId::from_can(frame.id()).ok().filter(ours)
}

/// On which interface each module speaks. Whoever puts messages together tells modules apart by their nodes.
#[derive(Debug, Default)]
pub(crate) struct Interfaces(BTreeMap<u8, String>);

impl Interfaces {
    pub(crate) fn check(&mut self, LogEntry { interface, frame, .. }: &LogEntry) -> Result<(), Rule> {
        let Some(id) = message_id(frame) else { return Ok(()) };
        let node = id.node.get();
        let first = self.0.entry(node).or_insert_with(|| interface.clone());
        if first == interface {
            return Ok(());
        }
        Err(Rule::SecondInterface { node, first: first.clone(), second: interface.clone() })
    }
}

/// Reads a log line by line. Empty lines are passed over. After an error the next call goes on with
/// the next line, so traffic of others ([`Rule::NotOurs`]) can be skipped; an unreadable file ends it, and so does a line
/// without end.
#[derive(Debug)]
pub struct CandumpReader<R> {
    input: R,
    line: usize,
    buffer: Vec<u8>,
    interfaces: Interfaces,
    broken: bool,
}

impl<R: BufRead> CandumpReader<R> {
    pub fn new(input: R) -> Self {
        let (buffer, interfaces) = (Vec::new(), Interfaces::default());
        Self { input, line: 0, buffer, interfaces, broken: false }
    }
}

impl<R: BufRead> Iterator for CandumpReader<R> {
    type Item = Result<LogEntry, CandumpError>;

    fn next(&mut self) -> Option<Self::Item> {
        while !self.broken {
            self.buffer.clear();
            self.line += 1;
            let mut line = (&mut self.input).take(LINE_BYTES_MAX as u64 + 1);
            let parsed = match line.read_until(b'\n', &mut self.buffer) {
                Ok(0) => return None,
                Ok(length) if length > LINE_BYTES_MAX => {
                    self.broken = true;
                    Err(Rule::TooLong)
                }
                Ok(_) if self.buffer.trim_ascii().is_empty() => continue,
                Ok(_) => parse(self.buffer.trim_ascii())
                    .and_then(|entry| self.interfaces.check(&entry).map(|()| entry)),
                Err(error) => {
                    self.broken = true;
                    Err(error.into())
                }
            };
            return Some(parsed.map_err(|rule| CandumpError { line: self.line, rule }));
        }
        None
    }
}

fn parse(line: &[u8]) -> Result<LogEntry, Rule> {
    let mut columns = line.split(u8::is_ascii_whitespace).filter(|column| !column.is_empty());
    let (Some(time), Some(interface), Some(frame)) = (columns.next(), columns.next(), columns.next()) else {
        return Err(malformed(COLUMNS));
    };
    // candump's option -x appends the direction, R or T; anything else is damage.
    if columns.next().is_some_and(|direction| !matches!(direction, b"R" | b"T")) || columns.next().is_some() {
        return Err(malformed(COLUMNS));
    }
    let timestamp_us = parse_time(time)
        .ok_or_else(|| malformed(format!("time {:?}: need '(SECONDS.FRACTION)'", text(time))))?;
    let mut parts = frame.splitn(3, |&byte| byte == b'#');
    let (Some(id), Some(first)) = (parts.next(), parts.next()) else {
        return Err(malformed(COLUMNS));
    };
    let ours = parts.next().filter(|_| first.is_empty() && id.len() != 3);
    let rest = ours.ok_or(Rule::NotOurs)?;
    let bad_id =
        || malformed(format!("identifier {:?}: need 8 hexadecimal digits, at most 1FFFFFFF", text(id)));
    let mut number = [0; 4];
    unhex(id, &mut number).ok_or_else(bad_id)?;
    let (_, digits) =
        rest.split_first().filter(|(flags, _)| flags.is_ascii_hexdigit()).ok_or_else(|| malformed(FLAGS))?;
    if !digits.len().is_multiple_of(2) {
        return Err(malformed(DATA));
    }
    let mut data = [0; 64];
    let length = digits.len() / 2;
    let bytes = data.get_mut(..length).ok_or_else(|| malformed(LengthError::Length { length }))?;
    unhex(digits, bytes).ok_or_else(|| malformed(DATA))?;
    let frame = CanFrame::new(u32::from_be_bytes(number), bytes).map_err(|error| match error {
        LengthError::Id { .. } => bad_id(),
        other => malformed(other),
    })?;
    Ok(LogEntry { timestamp_us, interface: text(interface), frame })
}

/// `(SECONDS.FRACTION)` to microseconds.
fn parse_time(column: &[u8]) -> Option<u64> {
    let inner = column.strip_prefix(b"(")?.strip_suffix(b")")?;
    let dot = inner.iter().position(|&byte| byte == b'.')?;
    let (seconds, fraction) = (&inner[..dot], &inner[dot + 1..]);
    if seconds.is_empty() || fraction.is_empty() || !fraction.iter().all(u8::is_ascii_digit) {
        return None;
    }
    let digits = fraction.iter().copied().chain(std::iter::repeat(b'0')).take(FRACTION_DIGITS);
    seconds.iter().copied().chain(digits).try_fold(0u64, |value, digit| {
        let digit = digit.is_ascii_digit().then(|| u64::from(digit - b'0'))?;
        value.checked_mul(10)?.checked_add(digit)
    })
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

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
        let (interface, line) = (checked(interface)?, Vec::with_capacity(LINE_MAX));
        Ok(Self { out: BufWriter::with_capacity(BUFFER, out), interface, line })
    }

    /// Append an entry under its own interface, which the following frames have too.
    pub fn write_entry(&mut self, entry: &LogEntry) -> io::Result<()> {
        if self.interface != entry.interface {
            self.interface = checked(&entry.interface).map_err(io::Error::other)?;
        }
        self.write(entry.timestamp_us, &entry.frame)
    }

    /// Append one frame, sent at `timestamp_us` microseconds since 1970.
    pub fn write(&mut self, timestamp_us: u64, frame: &CanFrame) -> io::Result<()> {
        let line = &mut self.line;
        line.clear();
        let (seconds, us) = (timestamp_us / 1_000_000, timestamp_us % 1_000_000);
        write!(line, "({seconds:010}.{us:06}) {} ", self.interface)?;
        frame.id().to_be_bytes().iter().for_each(|&byte| push_hex(line, byte));
        line.extend_from_slice(b"##1");
        frame.data().iter().for_each(|&byte| push_hex(line, byte));
        line.push(b'\n');
        self.out.write_all(line)
    }

    /// The writer below, after what is buffered has been written to it.
    pub fn flushed(&mut self) -> io::Result<&mut W> {
        self.out.flush()?;
        Ok(self.out.get_mut())
    }

    /// Write out what is buffered and return the writer below.
    pub fn finish(self) -> io::Result<W> {
        self.out.into_inner().map_err(io::IntoInnerError::into_error)
    }
}

fn checked(interface: &str) -> Result<String, InterfaceError> {
    let legal = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    if !(1..=15).contains(&interface.len()) || !interface.chars().all(legal) {
        return Err(InterfaceError(interface.to_owned()));
    }
    Ok(interface.to_owned())
}

fn push_hex(line: &mut Vec<u8>, byte: u8) {
    line.push(DIGITS[usize::from(byte >> 4)]);
    line.push(DIGITS[usize::from(byte & 15)]);
}
