//! candump logs: what is written is read back, and damage is named with its line.

use slipsense::wire::{CanFrame, FD_LENGTHS};
use slipsense_recording::candump::{CandumpReader, CandumpWriter, LogEntry};

/// Frames of every length with every byte value.
#[test]
fn written_logs_read_back() {
    let mut byte = 0u8;
    let mut data = move |_| {
        byte = byte.wrapping_mul(5).wrapping_add(17);
        byte
    };
    let entries: Vec<_> = (0..64u32)
        .map(|index| {
            let length = FD_LENGTHS[index as usize % 16];
            let bytes: Vec<u8> = (0..length).map(&mut data).collect();
            let frame = CanFrame::new(0x1FFF_FFFF - index * 7_919_311, &bytes).unwrap();
            let timestamp_us = 1_700_000_000_000_000 + u64::from(index) * 104;
            LogEntry { timestamp_us, interface: "can0".to_owned(), frame }
        })
        .collect();
    let mut writer = CandumpWriter::new(Vec::new(), "can0").unwrap();
    entries.iter().for_each(|entry| writer.write(entry.timestamp_us, &entry.frame).unwrap());
    let text = writer.finish().unwrap();
    let read: Vec<_> = CandumpReader::new(text.as_slice()).map(Result::unwrap).collect();
    assert_eq!(read, entries);
}

/// Time and data of a line in the documentation of pycyphal's `CandumpMedia`, as CAN FD.
#[test]
fn the_line_is_candumps() {
    let mut writer = CandumpWriter::new(Vec::new(), "vcan-1_a").unwrap();
    writer.write(1_234, &CanFrame::new(0x0C60_647D, &[2, 0, 0, 0xFB]).unwrap()).unwrap();
    assert_eq!(writer.finish().unwrap(), b"(0000000000.001234) vcan-1_a 0C60647D##1020000FB\n");
}

#[test]
fn damage_is_named_with_its_line() {
    let cases = [
        ("hello", "need '(TIME)"),
        ("(1.0) can0", "need '(TIME)"),
        ("(1.0) can0 12345678", "need '(TIME)"),
        ("(1.0) can0 12345678##1 00 11", "need '(TIME)"),
        ("1.0 can0 12345678##100", "time \"1.0\""),
        ("(1) can0 12345678##100", "time"),
        ("(1.x) can0 12345678##100", "time"),
        ("(x.1) can0 12345678##100", "time"),
        ("(99999999999999999999.0) can0 12345678##100", "time"),
        ("(1.0) can0 12345678#00", "not a CAN FD frame"),
        ("(1.0) can0 12345678#R", "not a CAN FD frame"),
        ("(1.0) can0 123##100", "not a CAN FD frame"),
        ("(1.0) can0 1234567##100", "identifier \"1234567\""),
        ("(1.0) can0 1234567G##100", "identifier"),
        ("(1.0) can0 20000000##100", "identifier \"20000000\""),
        ("(1.0) can0 12345678##", "flags"),
        ("(1.0) can0 12345678##x00", "flags"),
        ("(1.0) can0 12345678##100F", "data"),
        ("(1.0) can0 12345678##10G", "data"),
        ("(1.0) can0 12345678##1000102030405060708", "no data length of 9"),
        ("(1.0) can0 \u{e9}##1", "identifier"),
    ];
    for (line, rule) in cases {
        let text = format!("(1.0) can0 12345678##100\n\n{line}\n(2.5) can1 12345678##501\n");
        let mut reader = CandumpReader::new(text.as_bytes());
        assert!(reader.next().unwrap().is_ok());
        let error = reader.next().unwrap().expect_err(line).to_string();
        assert!(error.starts_with("line 3: ") && error.contains(rule), "{line:?} gave {error:?}");
        let after = reader.next().unwrap().unwrap();
        assert_eq!((after.timestamp_us, after.interface.as_str()), (2_500_000, "can1"));
        assert!(reader.next().is_none());
    }
    let long = format!("(1.0) can0 12345678##1{}", "00".repeat(65));
    let error = CandumpReader::new(long.as_bytes()).next().unwrap().unwrap_err().to_string();
    assert_eq!(error, "line 1: CAN FD has no data length of 65 bytes");
}

#[test]
fn a_direction_and_finer_time_are_accepted() {
    let text = b"  (1700000000.1234567) can0 1234567a##3FF R\r\n";
    let entry = CandumpReader::new(text.as_slice()).next().unwrap().unwrap();
    assert_eq!(entry.timestamp_us, 1_700_000_000_123_456);
    assert_eq!((entry.frame.id(), entry.frame.data()), (0x1234_567A, [0xFF].as_slice()));
}

#[test]
fn interface_names_that_break_columns_are_refused() {
    for name in ["", "can 0", "can0\n", "(can)", "sixteen-letters-"] {
        let error = CandumpWriter::new(Vec::new(), name).unwrap_err();
        assert_eq!(error.0, name);
    }
}

/// A disk that fills up is an error, not a shorter log.
#[test]
fn a_failing_writer_is_reported() {
    let mut short = [0u8; 100];
    let mut writer = CandumpWriter::new(short.as_mut_slice(), "can0").unwrap();
    let frame = CanFrame::new(1, &[0; 64]).unwrap();
    let written = writer.write(0, &frame).and_then(|()| writer.finish().map(|_| ()));
    assert!(written.is_err());
}

#[test]
fn a_line_without_end_is_not_read_to_its_end() {
    let line = "(1.0) can0 12345678##100\n";
    let text = [line.as_bytes(), &[b' '; 4096], b"\n", line.as_bytes()].concat();
    let mut reader = CandumpReader::new(text.as_slice());
    assert!(reader.next().unwrap().is_ok());
    assert_eq!(reader.next().unwrap().unwrap_err().to_string(), "line 2: longer than 4096 bytes");
    assert!(reader.next().is_none());
    let fits = [&[b' '; 4095 - 24], line.as_bytes()].concat();
    assert!(CandumpReader::new(fits.as_slice()).next().unwrap().is_ok());
}
