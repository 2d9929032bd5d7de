//! slcan, the text protocol of USB adapters, with the CAN FD commands of CANable 2.0 as python-can has them: `B` and
//! `D` are FD frames with a 29-bit identifier, with and without bit rate switching.

use slipsense::wire::{CanFrame, FD_LENGTHS};

/// Close, set the bit rates, open. Arbitration is 1 Mbit/s.
pub(crate) fn open_commands(data_mbit: u8) -> String {
    format!("C\rS8\rY{data_mbit}\rO\r")
}

pub(crate) const CLOSE: &str = "C\r";

pub(crate) fn command(frame: &CanFrame) -> String {
    let dlc = FD_LENGTHS.iter().position(|&length| usize::from(length) == frame.data().len()).unwrap_or(0);
    let mut line = format!("B{:08X}{dlc:X}", frame.id());
    frame.data().iter().for_each(|byte| line += &format!("{byte:02X}"));
    line.push('\r');
    line
}

/// What a line says; `None`: no FD frame with a 29-bit identifier (an answer, other traffic). Digits after the data
/// are the adapter's own clock, milliseconds modulo a minute, which is not used.
pub(crate) fn parse(line: &str) -> Option<CanFrame> {
    let rest = line.strip_prefix(['B', 'D'])?;
    let id = u32::from_str_radix(rest.get(..8)?, 16).ok()?;
    let dlc = usize::from_str_radix(rest.get(8..9)?, 16).ok()?;
    let digits = rest.get(9..9 + 2 * usize::from(*FD_LENGTHS.get(dlc)?))?;
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
            assert_eq!(parse(line.trim_end()), Some(frame));
            assert_eq!(parse(&format!("{}12AB", line.trim_end())), Some(frame), "with a time stamp");
        }
        for line in
            ["", "B", "T0478382A80011223344556677", "B0478382A9001122", "z", "B2478382A0", "Bü478382A0é"]
        {
            assert_eq!(parse(line), None, "{line}");
        }
    }
}
