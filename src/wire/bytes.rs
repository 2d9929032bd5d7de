//! Fields in the order of a message's DSDL definition: whole bytes, low byte first, no gaps.

use core::fmt;

/// Why bytes are not the message they should be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the fields are named after what they are, and the text says it")]
pub enum DecodeError {
    /// The message ends too early: bytes needed and found. DSDL would read the missing bytes as zeros, and zeros in these
    /// messages mean "no slip", so that is refused.
    Truncated {
        message: &'static str,
        expected: usize,
        found: usize,
    },
    /// A field, named as in the DSDL definition, holds a value that has no meaning.
    OutOfRange {
        message: &'static str,
        field: &'static str,
        value: u32,
        max: u32,
    },
    Damaged {
        message: &'static str,
    },
}

impl fmt::Display for DecodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Truncated { message, expected, found } => {
                write!(f, "{message}: {found} bytes, need {expected}")
            }
            Self::OutOfRange { message, field, value, max } => {
                write!(f, "{message}: {field} is {value}, at most {max} allowed")
            }
            Self::Damaged { message } => write!(f, "{message}: damaged data"),
        }
    }
}

impl core::error::Error for DecodeError {}

/// Fills a buffer from its start. What does not fit is not written; a test asserts that the layouts fit exactly.
pub(crate) struct Writer<'a> {
    out: &'a mut [u8],
    at: usize,
}

impl<'a> Writer<'a> {
    pub(crate) fn new(out: &'a mut [u8]) -> Self {
        Self { out, at: 0 }
    }

    #[inline]
    pub(crate) fn put(&mut self, bytes: &[u8]) {
        for (out, &byte) in self.slot(bytes.len()).iter_mut().zip(bytes) {
            *out = byte;
        }
    }

    /// The next bytes, to be filled by the caller; none if they do not fit.
    #[inline]
    pub(crate) fn slot(&mut self, bytes: usize) -> &mut [u8] {
        let end = self.at + bytes;
        let Some(out) = self.out.get_mut(self.at..end) else { return &mut [] };
        self.at = end;
        out
    }

    /// The low `N` bytes of a value; a value that needs more is sent as the largest that fits.
    #[inline]
    pub(crate) fn put_saturated<const N: usize>(&mut self, value: u64) {
        let max = u64::MAX >> (64 - 8 * N as u32);
        self.put(value.min(max).to_le_bytes().get(..N).unwrap_or(&[]));
    }

    /// Bytes written.
    pub(crate) fn len(&self) -> usize {
        self.at
    }
}

/// Takes a message apart from its start.
pub(crate) struct Reader<'a> {
    message: &'static str,
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    pub(crate) fn new(message: &'static str, bytes: &'a [u8]) -> Self {
        Self { message, bytes, at: 0 }
    }

    pub(crate) fn slice(&mut self, length: usize) -> Result<&'a [u8], DecodeError> {
        let expected = self.at + length;
        let found = self.bytes.len();
        let slice = self.bytes.get(self.at..expected);
        self.at = expected;
        slice.ok_or(DecodeError::Truncated { message: self.message, expected, found })
    }

    pub(crate) fn take<const N: usize>(&mut self) -> Result<[u8; N], DecodeError> {
        let mut out = [0; N];
        out.copy_from_slice(self.slice(N)?);
        Ok(out)
    }

    /// An unsigned value of `N` bytes, at most 8.
    pub(crate) fn unsigned<const N: usize>(&mut self) -> Result<u64, DecodeError> {
        let bytes = self.take::<N>()?;
        Ok(bytes.iter().rev().fold(0, |value, &byte| value << 8 | u64::from(byte)))
    }

    /// The value, if it has a meaning.
    pub(crate) fn at_most(&self, field: &'static str, value: u8, max: usize) -> Result<u8, DecodeError> {
        if usize::from(value) <= max {
            return Ok(value);
        }
        let message = self.message;
        Err(DecodeError::OutOfRange { message, field, value: value.into(), max: max as u32 })
    }
}
