//! uavcan.diagnostic.Record, subject 8184: a line of text for whoever watches the bus.

use core::fmt::{self, Write};

use crate::wire::bytes::Writer;

/// Subject of uavcan.diagnostic.Record.1.1.
pub const RECORD_PORT: u16 = 8_184;
/// Bytes of text of one record; what is longer is cut.
pub const RECORD_TEXT_MAX: usize = 112;
/// Longest message.
pub const RECORD_BYTES: usize = 7 + 1 + 1 + RECORD_TEXT_MAX;

/// How the line begins by which a node says how a sensor's array is calibrated: `calibration 0: 3 1a2b3c4d`, version and
/// name of the contents, or `calibration 0: none`. One CAN frame.
pub const CALIBRATION_LINE: &str = "calibration";

/// How much a record matters (uavcan.diagnostic.Severity.1.0).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
#[expect(missing_docs, reason = "the names are those of the standard")]
pub enum Severity {
    Trace = 0,
    Debug = 1,
    Info = 2,
    Notice = 3,
    Warning = 4,
    Error = 5,
    Critical = 6,
    Alert = 7,
}

/// Text that takes what fits.
struct TruncatingWriter<'a, 'b>(&'a mut Writer<'b>, usize);

impl Write for TruncatingWriter<'_, '_> {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        let mut end = text.len().min(RECORD_TEXT_MAX - self.1);
        while !text.is_char_boundary(end) {
            end -= 1;
        }
        self.0.put(text.get(..end).unwrap_or("").as_bytes());
        self.1 += end;
        if end == text.len() { Ok(()) } else { Err(fmt::Error) }
    }
}

/// The message; its length. `bus_time_us` is 0 where the bus time is not known.
pub fn encode(
    bus_time_us: u64,
    severity: Severity,
    text: fmt::Arguments<'_>,
    out: &mut [u8; RECORD_BYTES],
) -> usize {
    let mut writer = Writer::new(out);
    writer.put_saturated::<7>(bus_time_us);
    writer.put(&[severity as u8, 0]);
    let mut text_writer = TruncatingWriter(&mut writer, 0);
    // An error only says that the text was cut.
    let _ = text_writer.write_fmt(text);
    let length = text_writer.1;
    let total = writer.len();
    if let Some(byte) = out.get_mut(8) {
        *byte = length as u8;
    }
    total
}
