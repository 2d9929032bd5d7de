//! slcan, the text protocol of USB adapters, with the CAN FD commands of CANable 2.0 as python-can has them: `B` and
//! `D` are FD frames with a 29-bit identifier, with and without bit rate switching.

use slipsense::wire::{CanFrame, FD_LENGTHS};

use crate::candump::Foreign;

/// Close, set the bit rates, open. Arbitration is 1 Mbit/s.
pub fn open_commands(data_mbit: u8) -> String {
    format!("C\rS8\rY{data_mbit}\rO\r")
}

pub const CLOSE: &str = "C\r";

pub fn command(frame: &CanFrame) -> String {
    let dlc = FD_LENGTHS.iter().position(|&length| usize::from(length) == frame.data().len()).unwrap_or(0);
    let mut line = format!("B{:08X}{dlc:X}", frame.id());
    frame.data().iter().for_each(|byte| line += &format!("{byte:02X}"));
    line.push('\r');
    line
}

/// What a line says; `None`: it is an answer.
pub fn parse(line: &[u8]) -> Option<Result<CanFrame, Foreign>> {
    match line.first()? {
        b'z' | b'Z' => None,
        b't' | b'T' | b'r' | b'R' => Some(Err(Foreign::Classic)),
        b'b' | b'd' => Some(Err(Foreign::Standard)),
        _ => Some(frame(line).ok_or(Foreign::Unreadable)),
    }
}

/// An FD frame with a 29-bit identifier. Up to eight digits after the data are the adapter's own clock, which is not used;
/// more are another line whose beginning was lost.
fn frame(line: &[u8]) -> Option<CanFrame> {
    let rest = std::str::from_utf8(line).ok()?.strip_prefix(['B', 'D'])?;
    // A sign is a number's, too.
    rest.bytes().all(|digit| digit.is_ascii_hexdigit()).then_some(())?;
    let id = u32::from_str_radix(rest.get(..8)?, 16).ok()?;
    let dlc = usize::from_str_radix(rest.get(8..9)?, 16).ok()?;
    let (digits, clock) = rest.get(9..)?.split_at_checked(2 * usize::from(*FD_LENGTHS.get(dlc)?))?;
    (clock.len() <= 8).then_some(())?;
    let bytes = (0..digits.len() / 2).map(|i| u8::from_str_radix(digits.get(2 * i..2 * i + 2)?, 16).ok());
    CanFrame::new(id, &bytes.collect::<Option<Vec<u8>>>()?).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_sent_is_what_is_read() {
        for length in FD_LENGTHS {
            let data: Vec<u8> = (0..length).map(|i| i.wrapping_mul(37)).collect();
            let frame = CanFrame::new(0x0478_382A, &data).unwrap();
            let line = command(&frame);
            let line = line.trim_end();
            assert_eq!(parse(line.as_bytes()), Some(Ok(frame)));
            assert_eq!(parse(format!("{line}12AB").as_bytes()), Some(Ok(frame)), "with a time stamp");
            let merged = format!("{line}{line}");
            assert_eq!(parse(merged.as_bytes()), Some(Err(Foreign::Unreadable)), "an end was lost");
        }
        let frame = |data: &[u8]| CanFrame::new(0x0478_382A, data).unwrap();
        assert_eq!(command(&frame(&[1, 0xFE])), "B0478382A201FE\r");
        assert_eq!(command(&frame(&[0; 12])), format!("B0478382A9{}\r", "00".repeat(12)));
        assert_eq!((parse(b""), parse(b"z")), (None, None));
        for (line, foreign) in [
            ("T0478382A80011223344556677", Foreign::Classic),
            ("b7FF0", Foreign::Standard),
            ("B", Foreign::Unreadable),
            ("B+478382A0", Foreign::Unreadable),
            ("B0478382A9001122", Foreign::Unreadable),
            ("B2478382A0", Foreign::Unreadable),
            ("Bü478382A0é", Foreign::Unreadable),
            ("78382A0", Foreign::Unreadable),
        ] {
            assert_eq!(parse(line.as_bytes()), Some(Err(foreign)), "{line}");
        }
    }
}
