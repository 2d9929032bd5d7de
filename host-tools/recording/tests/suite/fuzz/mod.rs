//! Whatever reads bytes that others wrote, on mutated input. A panic, an input that takes seconds or an input that takes
//! much memory fails. Each test run takes the same 20,000 inputs; `cargo xtask fuzz` lets libFuzzer choose many more.

use std::cell::RefCell;
use std::collections::HashSet;
use std::io::{Cursor, Read, Write};
use std::mem::discriminant;
use std::path::Path;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use mcap::WriteOptions;
use mcap::records::MessageHeader;
use proptest::prelude::*;
use proptest::sample::Index;
use sha2::{Digest, Sha256};
use slipsense::board::crash_record::{CRASH_WORDS, CrashKind, CrashRecord, Fault};
use slipsense::calibration::{Calibration, GAIN_MAX, RECORD_BYTES, Trim};
use slipsense::net::format::{Dims, HASH_BYTES};
use slipsense::net::{Aligned, Model, ModelError};
use slipsense::node::UpdateTarget;
use slipsense::params::TAXELS;
use slipsense::sensor::{PiezoFrame, SensorInput};
use slipsense::settings::{Damage, Setting, Settings, TABLE, check};
use slipsense::update::partitions::{FLASH_BASE, NUCLEO_H743ZI2, TRAILER_BYTES};
use slipsense::update::{DEVELOPMENT_KEY, Header, ImageVersion, SIGNED_BYTES};
use slipsense::wire::{
    CanFrame, Detail, NodeId, RawBuffer, RawForm, RawFrame, RawMessage, Sessions, SlipMessage, TransferId,
    Transmitter, crc16,
};
use slipsense_recording::candump::{CandumpReader, CandumpWriter, LogEntry};
use slipsense_recording::decode::Decoder;
use slipsense_recording::firmware_elf::flatten;
use slipsense_recording::label::StandLog;
use slipsense_recording::mcap_file::McapSink;
use slipsense_recording::model_file::random_model;
use slipsense_recording::{Episode, Meta, slcan};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

use super::killed::parse;
use harness::{MEMORY_MAX, fuzz, fuzz_within, mutated};

#[cfg(feature = "fuzz")]
mod guided;
mod harness;

/// The same of MCAP: the crate reserves, but does not touch, what the 32 bits of a string's length say.
const MCAP_MEMORY_MAX: usize = MEMORY_MAX + (4 << 30);
/// Bytes of the transfers that a node takes part in.
const TRANSFER_MAX: usize = 600;

fn assert_one_line(error: &str) {
    assert!(!error.is_empty() && !error.contains('\n'), "{error:?}");
}

/// A slip message and one raw message in each form. Few frames, so that inputs are many.
fn traffic() -> Vec<Vec<CanFrame>> {
    let mut transmitter = Transmitter::new(NodeId::DEFAULT);
    let piezo = PiezoFrame::from_scan(std::array::from_fn(|i| (i % 37 * 90) as u16));
    let xl = [[-3, 1, 2047]; 33];
    let forms = [RawForm::Compressed(Detail::All), RawForm::Compressed(Detail::Contact), RawForm::Plain];
    let mut frames = |(sequence, form)| {
        let mut frames =
            vec![transmitter.slip(&SlipMessage { sequence, sensors: 2, ..SlipMessage::default() })];
        let input = SensorInput { piezo: Some(&piezo), xl: Some(&xl), xl_end: 33 };
        let raw = RawFrame { timestamp_us: 5, sequence, sensor: 1, health: 0, input };
        frames.extend(transmitter.raw_as(form, &raw, &mut RawBuffer::new()));
        frames
    };
    (0..).zip([forms, forms].concat()).map(&mut frames).collect()
}

/// Of each frame the identifier, low byte first, its length, its data. A length that CAN FD does not have is cut down.
fn frames(mut bytes: &[u8]) -> Vec<CanFrame> {
    let mut frames = Vec::new();
    while let Some((&[a, b, c, d, length], rest)) = bytes.split_first_chunk() {
        let (id, length) =
            (u32::from_le_bytes([a, b, c, d]) & 0x1FFF_FFFF, usize::from(length).min(rest.len()));
        frames.extend((0..=length).rev().find_map(|length| CanFrame::new(id, &rest[..length]).ok()));
        bytes = &rest[length..];
    }
    frames
}

#[test]
fn bus() {
    let bytes = |frame: &CanFrame| {
        [&frame.id().to_le_bytes()[..], &[frame.data().len() as u8], frame.data()].concat()
    };
    let corpus = traffic().iter().map(|frames| frames.iter().flat_map(bytes).collect()).collect();
    fuzz(mutated(corpus), 50, |bytes| {
        let (mut decoder, mut messages) = (Decoder::new(), 0);
        let mut sessions = Sessions::<4, TRANSFER_MAX>::new();
        for (index, frame) in frames(bytes).iter().enumerate() {
            match (decoder.accept(frame), TransferId::from_can(frame.id())) {
                (Some(_), _) => messages += 1,
                // As a node does with what it has subscribed to.
                (None, Ok(id)) => drop(sessions.accept(id, frame, index as u64 * 1000).map(|_| ())),
                (None, Err(_)) => {}
            }
        }
        messages > 0
    });
}

#[test]
fn candump() {
    let mut log = CandumpWriter::new(Vec::new(), "can0").unwrap();
    traffic().concat().iter().take(8).zip(0..).for_each(|(frame, us)| log.write(us * 4_167, frame).unwrap());
    let mut log = log.finish().unwrap();
    log.extend_from_slice(b"(1700000000.000001) vcan1 123#0102\n(1.5) can0 1F334455#R\n\n# a comment\n");
    fuzz(mutated(vec![log]), 50, |bytes| {
        let mut entries = 0;
        for line in CandumpReader::new(bytes) {
            line.map_or_else(|error| assert_one_line(&error.to_string()), |_| entries += 1);
        }
        entries > 0
    });
}

/// Make the check of a compressed raw message right, else nothing changed would get as far as the coded bytes.
fn with_check(mut bytes: Vec<u8>) -> Vec<u8> {
    // The check, and the length of the data behind it: `6202.RawCompressed.1.0.dsdl`.
    const CHECK_AT: usize = 20;
    const DATA_AT: usize = CHECK_AT + 4;
    if let Some(&[_, _, low, high]) = bytes.get(CHECK_AT..DATA_AT) {
        let end = bytes.len().min(DATA_AT + usize::from(u16::from_le_bytes([low, high])));
        let checked = [&bytes[..CHECK_AT], &bytes[CHECK_AT + 2..end]].concat();
        bytes[CHECK_AT..CHECK_AT + 2].copy_from_slice(&crc16(&checked).to_le_bytes());
    }
    bytes
}

/// The decoder ends with a message or an error, and what it takes for a message can be sent again.
#[test]
fn compressed() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/wire/corpus");
    let files = std::fs::read_dir(folder).unwrap();
    let mut corpus: Vec<_> = files.map(|file| std::fs::read(file.unwrap().path()).unwrap()).collect();
    corpus.sort();
    let inputs = (mutated(corpus), any::<bool>());
    let inputs = inputs.prop_map(|(bytes, right)| if right { with_check(bytes) } else { bytes });
    fuzz(inputs, 1, |bytes| {
        let Ok(message) = RawMessage::decompress(bytes) else { return false };
        let RawMessage { timestamp_us, sequence, sensor, health, xl_end, .. } = message;
        let input = SensorInput { piezo: Some(&message.piezo), xl: Some(&message.xl), xl_end };
        let again = RawFrame { timestamp_us, sequence, sensor, health, input };
        let mut buffer = RawBuffer::new();
        let again = RawMessage::decompress(again.compress(Detail::All, &mut buffer)).unwrap();
        assert_eq!((&again.piezo, &again.xl), (&message.piezo, &message.xl));
        true
    });
}

/// Without chunks and checksums, so that changes get further.
fn plain_mcap(topic: &str, frames: &[CanFrame], time_ns: u64) -> Vec<u8> {
    let options = WriteOptions::new().compression(None).use_chunks(false).calculate_data_section_crc(false);
    let mut writer = options.calculate_summary_section_crc(false).create(Cursor::new(Vec::new())).unwrap();
    let schema = writer.add_schema("slipsense.CanFrame", "jsonschema", b"{}").unwrap();
    let channel_id = writer.add_channel(schema, topic, "json", &Default::default()).unwrap();
    for (frame, sequence) in frames.iter().zip(0..) {
        let text = format!("{{\"id\":{},\"data\":\"{}\"}}", frame.id(), STANDARD.encode(frame.data()));
        let header = MessageHeader { channel_id, sequence, log_time: time_ns, publish_time: time_ns };
        writer.write_to_known_channel(&header, text.as_bytes()).unwrap();
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

#[test]
fn mcap_files() {
    let frames: Vec<_> = traffic().iter().take(3).map(|frames| frames[0]).collect();
    let mut sink = McapSink::new(Cursor::new(Vec::new())).unwrap();
    for (&frame, timestamp_us) in frames.iter().zip(1_000..) {
        sink.write(&LogEntry { timestamp_us, interface: "can0".to_owned(), frame }).unwrap();
    }
    sink.displacement(2_000, 1.5).unwrap();
    let whole = sink.finish().unwrap().into_inner();
    let corpus = vec![whole[..whole.len() * 2 / 5].to_vec(), whole, plain_mcap("/can/can0", &frames, 1_000)];
    assert!(corpus.iter().all(|bytes| !parse(bytes).unwrap().is_empty()));
    fuzz_within(MCAP_MEMORY_MAX, mutated(corpus), 1, |bytes| {
        parse(bytes).map_err(|error| assert_one_line(&format!("{error:#}"))).is_ok()
    });
}

/// Found by 42,955 inputs, and what it led to: a name that a log could not hold.
#[test]
fn a_topic_of_two_lines_is_refused_in_one() {
    let frame = [CanFrame::new(1, &[2]).unwrap()];
    assert_eq!(parse(&plain_mcap("/can/can0", &frame, 1_000)).unwrap().len(), 1);
    for (topic, time_ns, rule) in [
        ("/can/c\n0", 1_000, "message 0 of /can/c\\n0: an interface needs a name without white space"),
        ("/can/", 1_000, "message 0 of /can/: an interface needs a name without white space"),
        ("/can/can0", 1, "message 0 of /can/can0: time is no whole microsecond"),
    ] {
        assert_eq!(format!("{:#}", parse(&plain_mcap(topic, &frame, time_ns)).unwrap_err()), rule);
    }
}

/// Files with what is required and with all arrays.
fn episodes() -> Vec<Vec<u8>> {
    let scan = |k: usize| PiezoFrame::from_scan(std::array::from_fn(|i| (i * k % 90) as u16));
    let plain = Episode {
        sensors: 1,
        piezo: vec![scan(0), scan(3)],
        xl: vec![(0..5).map(|i| [i, -i, 2_000]).collect()],
        xl_end: vec![2, 5],
        meta: Meta::nominal(0.000_5),
        ..Episode::default()
    };
    let floats = Some(vec![0.0, 0.5]);
    let labelled = Episode {
        label: Some(vec![1, 2]),
        slip_true_mm_s: floats.clone(),
        slip_fraction: floats.clone(),
        displacement_mm: floats,
        ..plain.clone()
    };
    let file = tempfile::NamedTempFile::new().unwrap();
    [plain, labelled]
        .map(|episode| episode.write(&file).map(|()| std::fs::read(&file).unwrap()).unwrap())
        .into()
}

fn is_read(bytes: &[u8]) -> bool {
    let read = Episode::from_bytes(bytes, "grasp.npz");
    read.map_err(|error| {
        let error = error.to_string();
        assert!(error.starts_with("grasp.npz"), "{error:?}");
        assert_one_line(&error);
    })
    .is_ok()
}

/// Changes anywhere: in the directory, in deflated bytes, of which the checksum is wrong afterwards.
#[test]
fn npz() {
    assert!(episodes().iter().all(|bytes| is_read(bytes)));
    fuzz(mutated(episodes()), 1, is_read);
}

/// Changes of an array, header or data, in an archive that is right about it.
#[test]
fn npz_arrays() {
    let files: Vec<Vec<(String, Vec<u8>)>> = episodes().iter().map(|bytes| arrays(bytes)).collect();
    let all: Vec<Vec<u8>> = files.iter().flatten().map(|(_, bytes)| bytes.clone()).collect();
    // Of thousands of bytes the first say what the others are.
    let headers: Vec<Vec<u8>> = all.iter().map(|bytes| bytes[..128].to_vec()).collect();
    let inputs = (any::<Index>(), any::<Index>(), any::<bool>(), mutated(all), mutated(headers));
    let inputs = inputs.prop_map(move |(file, array, of_header, whole, header)| {
        let mut arrays = file.get(&files).clone();
        let (_, bytes) = &mut arrays[array.index(file.get(&files).len())];
        *bytes = if of_header { [&header, &bytes[128..]].concat() } else { whole };
        archive(&arrays)
    });
    fuzz(inputs, 1, is_read);
}

fn arrays(bytes: &[u8]) -> Vec<(String, Vec<u8>)> {
    let mut zip = ZipArchive::new(Cursor::new(bytes)).unwrap();
    (0..zip.len())
        .map(|index| {
            let mut entry = zip.by_index(index).unwrap();
            let (name, mut bytes) = (entry.name().unwrap().into_owned(), Vec::new());
            entry.read_to_end(&mut bytes).unwrap();
            (name, bytes)
        })
        .collect()
}

fn archive(arrays: &[(String, Vec<u8>)]) -> Vec<u8> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    let stored = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
    for (name, bytes) in arrays {
        zip.start_file(name.as_str(), stored).unwrap();
        zip.write_all(bytes).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

/// Where the first bytes of the end of a file are a check of the rest: made right in every second input, else nothing
/// changed would get behind it.
fn checked<const N: usize>(
    corpus: Vec<Vec<u8>>,
    check: impl Fn(&[u8]) -> [u8; N],
) -> impl Strategy<Value = Vec<u8>> {
    (mutated(corpus), any::<bool>()).prop_map(move |(mut bytes, right)| {
        if let Some((checked, stored)) = bytes.split_last_chunk_mut::<N>().filter(|_| right) {
            *stored = check(checked);
        }
        bytes
    })
}

fn sha256<const N: usize>(bytes: &[u8]) -> [u8; N] {
    *Sha256::digest(bytes).first_chunk().unwrap()
}

#[test]
fn slcan_lines() {
    let lines: String = traffic().concat().iter().take(8).map(slcan::command).collect();
    fuzz(mutated(vec![lines.into_bytes()]), 50, |bytes| {
        let frames: Vec<_> =
            bytes.split(|&byte| byte == b'\r').filter_map(|line| slcan::parse(line)?.ok()).collect();
        for frame in &frames {
            let again = slcan::command(frame);
            assert_eq!(slcan::parse(again.trim_end().as_bytes()), Some(Ok(*frame)));
        }
        !frames.is_empty()
    });
}

/// A log that is read has a reading for each frame, and refuses in one line what it does not take.
#[test]
fn stand_logs() {
    let readings =
        (0..12).map(|n| format!("{}.{};{};{}\n", n / 10, n % 10, n * n, 5 - n)).collect::<String>();
    let log = |titles: &str| format!("made by hand\n{titles}\n{readings}").into_bytes();
    let corpus = vec![log("Time (s);Extension (mm);Load (N)"), log("time_s;travel_mm;note")];
    assert!(corpus.iter().all(|log| StandLog::parse(std::str::from_utf8(log).unwrap()).is_ok()));
    fuzz(mutated(corpus), 20, |bytes| match StandLog::parse(&String::from_utf8_lossy(bytes)) {
        Ok(log) => {
            if let Ok(at) = log.at_frames(24, 0.0) {
                assert_eq!(at.displacement_mm.len(), 24);
            }
            true
        }
        Err(error) => {
            assert_one_line(&error.to_string());
            false
        }
    });
}

/// One segment of eight bytes at the beginning of the slot, and one elsewhere.
fn elf_file() -> Vec<u8> {
    let numbers =
        |numbers: &[u32]| numbers.iter().flat_map(|number| number.to_le_bytes()).collect::<Vec<_>>();
    let slot = FLASH_BASE + NUCLEO_H743ZI2.active.start;
    // 32 bits, little-endian, an executable of ARM, two program headers of 32 bytes behind the 52 of this one.
    let header = [
        b"\x7fELF\x01\x01\x01\0\0\0\0\0\0\0\0\0".to_vec(),
        numbers(&[40 << 16 | 2, 1, slot, 52, 0, 0, 32 << 16 | 52, 2, 40 << 16]),
    ];
    let segment = |at, address| numbers(&[1, at, address, address, 8, 8, 5, 4]);
    [header.concat(), segment(116, slot), segment(124, FLASH_BASE), vec![7; 16]].concat()
}

/// What comes of a firmware's file fits its slot.
#[test]
fn elf_files() {
    assert_eq!(flatten(&elf_file(), "x", &NUCLEO_H743ZI2).unwrap(), [7; 8]);
    fuzz(mutated(vec![elf_file()]), 10, |bytes| match flatten(bytes, "x", &NUCLEO_H743ZI2) {
        Ok(payload) => {
            assert!((1..=NUCLEO_H743ZI2.active.bytes() - TRAILER_BYTES).contains(&(payload.len() as u32)));
            true
        }
        Err(error) => {
            let error = format!("{error:#}");
            assert_one_line(&error);
            assert!(error.starts_with("x: "), "{error}");
            false
        }
    });
}

/// A header is taken for what it says, and nothing without a signature is believed.
#[test]
fn image_headers() {
    let header = |target| {
        let version = ImageVersion { major: 1, minor: 2, patch: 3 };
        Header { target, board: 1, version, length: 5, sha256: [6; 32] }.encode(&[1; 64]).to_vec()
    };
    let corpus = [UpdateTarget::Firmware, UpdateTarget::Model].map(header).to_vec();
    fuzz(mutated(corpus), 30, |bytes| {
        let Some(bytes) = bytes.first_chunk() else { return false };
        assert!(Header::verify(bytes, &[DEVELOPMENT_KEY]).is_err());
        let header = Header::inspect(bytes);
        header.is_ok_and(|header| header.signed_bytes() == bytes[..SIGNED_BYTES])
    });
}

/// What is read is valid, whatever was stored, and is read again.
#[test]
fn settings() {
    let mut settings = Settings::new();
    settings.set(Setting::Sensors, &[3]).unwrap();
    let corpus = vec![Settings::new().encode().to_vec(), settings.encode().to_vec()];
    fuzz(mutated(corpus), 10, |bytes| {
        let (settings, damage) = Settings::decode(bytes);
        for definition in &TABLE {
            assert_eq!(check(definition.setting, settings.get(definition.setting)), Ok(()));
        }
        assert!(Settings::decode(&settings.encode()) == (settings, Damage::default()));
        damage == Damage::default()
    });
}

/// A calibration that is read has gains that the arithmetic is made for; one that is not is nominal.
#[test]
fn calibrations() {
    let mut good = Calibration::zeroed();
    good.set_nominal();
    let mut record = vec![0; RECORD_BYTES];
    good.encode(&mut record);
    fuzz(checked(vec![record], sha256::<4>), 10, |bytes| {
        let mut calibration = Calibration::zeroed();
        let taken = calibration.decode(bytes);
        assert!(calibration.trims.iter().all(|trim| (1..=GAIN_MAX).contains(&trim.gain)));
        assert!(taken || calibration.trims == [Trim::NOMINAL; TAXELS]);
        taken
    });
}

/// RAM that a reset left: a record that is believed is written as it was read, and can be told.
#[test]
fn crash_records() {
    let panic = CrashRecord::new(None, "a reason", "src/tasks/infer.rs", 7);
    let [fault, clock] = [CrashKind::Fault(Fault::default()), CrashKind::NoClock(8)];
    let records = [panic, CrashRecord::of(Some(panic), fault), CrashRecord::of(None, clock)];
    let corpus = records.map(|record| record.to_words().iter().flat_map(|word| word.to_le_bytes()).collect());
    // FNV-1a.
    let fnv = |bytes: &[u8]| {
        let add = |hash: u32, &byte: &u8| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193);
        bytes.iter().fold(0x811c_9dc5, add).to_le_bytes()
    };
    fuzz(checked(corpus.to_vec(), fnv), 10, |bytes| {
        let (words, rest) = bytes.as_chunks::<4>();
        let Ok(words) = <[u32; CRASH_WORDS]>::try_from(
            words.iter().map(|&word| u32::from_le_bytes(word)).collect::<Vec<_>>(),
        ) else {
            return false;
        };
        let Some(record) = CrashRecord::from_words(&words).filter(|_| rest.is_empty()) else { return false };
        assert_eq!(CrashRecord::from_words(&record.to_words()), Some(record));
        assert!(!record.to_string().is_empty());
        true
    });
}

#[test]
fn models() {
    let dims = Dims { conv_channels: [2; 3], embed: 4, xl_kernel: 2, xl_channels: 3, heads: 2, window: 3 };
    let good = random_model(dims, 1).to_bytes().unwrap();
    let refused = RefCell::new(HashSet::new());
    fuzz(checked(vec![good], sha256::<HASH_BYTES>), 10, |bytes| {
        // Where a microcontroller can read them.
        let mut place = Box::new(Aligned([0; 1 << 16]));
        place.0[..bytes.len()].copy_from_slice(bytes);
        let parsed = Model::parse(&place.0[..bytes.len()]);
        parsed.map_err(|error| refused.borrow_mut().insert(discriminant(&error))).is_ok()
    });
    for behind in [
        ModelError::BadKernel { layer: "", channel: 0 },
        ModelError::AccumulatorOverflow { layer: "", channel: 0, bound: 0 },
        ModelError::BadScale { layer: "", part: "", channel: 0, value: 0 },
        ModelError::BadPadding { layer: "" },
    ] {
        assert!(refused.borrow().contains(&discriminant(&behind)), "{behind:?} was never reached");
    }
}
