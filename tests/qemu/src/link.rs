//! CAN frames over a stream of bytes that loses nothing: 4 bytes of identifier, 1 of length, the data. All
//! low byte first. `tests/python/can_link.py` is the other end.

use slipsense::wire::CanFrame;

/// Bytes before the data.
const HEADER: usize = 5;
/// Bytes of the longest frame.
pub const RECORD_MAX: usize = HEADER + 64;

/// A frame as bytes; their number.
pub fn encode(frame: &CanFrame, out: &mut [u8; RECORD_MAX]) -> usize {
    let length = HEADER + frame.data().len();
    out[..4].copy_from_slice(&frame.id().to_le_bytes());
    out[4] = frame.data().len() as u8;
    out[HEADER..length].copy_from_slice(frame.data());
    length
}

/// Gathers bytes to frames.
#[derive(Default)]
pub struct Decoder {
    bytes: heapless::Vec<u8, RECORD_MAX>,
}

impl Decoder {
    /// Take the next byte; `Some` when it completes a frame. A length or identifier that no frame has throws
    /// away what was gathered: the other end is not ours.
    pub fn accept(&mut self, byte: u8) -> Option<CanFrame> {
        if self.bytes.push(byte).is_err() {
            self.bytes.clear();
            return None;
        }
        let (header, data) = self.bytes.split_first_chunk::<HEADER>()?;
        let [a, b, c, d, length] = *header;
        if data.len() < usize::from(length) {
            return None;
        }
        let frame = CanFrame::new(u32::from_le_bytes([a, b, c, d]), data).ok();
        self.bytes.clear();
        frame
    }
}
