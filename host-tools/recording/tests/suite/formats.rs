//! A recording through every format and back: every frame, every microsecond.

use std::collections::BTreeMap;
use std::fs;
use std::io::Cursor;

use slipsense::node::RECORD_PORT;
use slipsense::sensor::{PiezoFrame, SensorInput};
use slipsense::wire::{
    Detail, Frames, MessageId, NodeId, Priority, RawBuffer, RawForm, RawFrame, SlipMessage, Transmitter,
};
use slipsense_recording::candump::LogEntry;
use slipsense_recording::log_file::{Format, Record, Recording, open, read, write};
use slipsense_recording::mcap_file::McapSink;
use slipsense_recording::rebuild::{Rebuilder, Rebuilt};

const FRAMES: u32 = 40;

/// The samples that come with a frame.
fn xl(sequence: u32) -> Vec<[i16; 3]> {
    (0..33 + i16::from(sequence % 3 == 2)).map(|i| [i, -300 * i, 32767 - i]).collect()
}

fn scan(sequence: u32, sensor: u8) -> PiezoFrame {
    let taxel = |i| ((i as u32 * 31 + sequence * 7 + u32::from(sensor)) % 4096) as u16;
    // Rows 4 to 27 are touched.
    PiezoFrame::from_scan(std::array::from_fn(|i| if (128..896).contains(&i) { taxel(i) } else { 0 }))
}

fn recording(skip: impl Fn(u32) -> bool) -> Recording {
    recording_as(|_| RawForm::Plain, skip)
}

/// Two sensors, with times that no millisecond and no float divides evenly.
fn recording_as(form: impl Fn(u32) -> RawForm, skip: impl Fn(u32) -> bool) -> Recording {
    let mut transmitter = Transmitter::new(NodeId::DEFAULT);
    let mut entries = Vec::new();
    let mut xl_end = 0;
    for sequence in 0..FRAMES {
        let start_us = 1_700_000_000_004_167 + u64::from(sequence) * 12_501 / 3;
        let mut frames =
            vec![transmitter.slip(&SlipMessage { sequence, sensors: 2, ..SlipMessage::default() })];
        let xl = xl(sequence);
        xl_end += xl.len() as u32;
        for sensor in 0..2 {
            let piezo = scan(sequence, sensor);
            let input = SensorInput { piezo: Some(&piezo), xl: Some(&xl), xl_end };
            let raw = RawFrame { timestamp_us: start_us, sequence, sensor, health: 0, input };
            frames.extend(transmitter.raw_as(form(sequence), &raw, &mut RawBuffer::new()));
        }
        if !skip(sequence) {
            entries.extend((0..).zip(frames).map(|(i, frame)| LogEntry {
                timestamp_us: start_us + 127 * i,
                interface: "can1".to_owned(),
                frame,
            }));
        }
    }
    Recording { entries, displacement: vec![(1_700_000_000_004_168, 1.25)], notes: Vec::new() }
}

fn rebuilt(entries: &[LogEntry]) -> anyhow::Result<Rebuilt> {
    let mut rebuilder = Rebuilder::default();
    entries.iter().for_each(|entry| rebuilder.accept(entry));
    rebuilder.episode(None, 0.000_488)
}

fn records(recording: &Recording) -> impl Iterator<Item = Record> {
    let positions = recording.displacement.iter();
    let positions = positions.map(|&(timestamp_us, mm)| Record::Displacement { timestamp_us, mm });
    recording.entries.iter().cloned().map(Record::Frame).chain(positions)
}

#[test]
fn nothing_is_lost_on_the_way_and_back() {
    let dir = tempfile::tempdir().unwrap();
    let before = recording(|_| false);
    for (format, name) in [(Format::Candump, "r.log"), (Format::Mcap, "r.mcap")] {
        let path = dir.path().join(name);
        assert_eq!(Format::from_path(&path), Some(format));
        let notes =
            write(&path, format, |sink| records(&before).try_for_each(|record| sink.put(&record))).unwrap();
        let after = read(&path, format).unwrap();
        assert_eq!(after.entries, before.entries, "{format:?}");
        let keeps = format == Format::Mcap;
        assert_eq!(after.displacement == before.displacement, keeps, "{format:?}");
        assert_eq!(notes.is_empty(), keeps, "{format:?}: {notes:?}");
    }
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 2, "nothing else is left");
}

#[test]
fn an_episode_comes_back_from_the_bus() {
    let rebuilt = rebuilt(&recording(|_| false).entries).unwrap();
    let episode = rebuilt.episode;
    assert_eq!((episode.frames(), episode.sensors, rebuilt.first), (FRAMES as usize, 2, 0));
    for sequence in 0..FRAMES {
        for sensor in 0..2 {
            let frame = sequence as usize;
            assert!(episode.piezo(frame, sensor) == &scan(sequence, sensor as u8));
            assert_eq!(episode.xl_batch(frame, sensor), xl(sequence));
        }
    }
}

#[test]
fn of_a_recording_with_gaps_the_longest_stretch_is_rebuilt_and_the_rest_named() {
    let rebuilt = rebuilt(&recording(|n| n == 12 || n == 35).entries).unwrap();
    assert_eq!((rebuilt.first, rebuilt.episode.frames()), (13, 22));
    assert!(rebuilt.notes[0].contains("32 of 76 raw messages are left out"), "{:?}", rebuilt.notes);
}

/// On a full bus a module leaves taxels out, all or those beside the contact, which nobody may take for zeros.
fn full_bus() -> Recording {
    let detail = |sequence| match sequence {
        12 => Detail::Contact,
        35 => Detail::Accelerometer,
        _ => Detail::All,
    };
    recording_as(|sequence| RawForm::Compressed(detail(sequence)), |_| false)
}

#[test]
fn taxels_that_were_not_sent_are_in_no_episode() {
    let recording = full_bus();
    let rebuilt = rebuilt(&recording.entries).unwrap();
    assert_eq!((rebuilt.first, rebuilt.episode.frames()), (13, 22));
    assert!(rebuilt.notes[0].contains("36 of 80 raw messages are left out"), "{:?}", rebuilt.notes);
    assert!(rebuilt.notes[1].contains("4 raw messages lack taxels"), "{:?}", rebuilt.notes);
}

#[test]
fn taxels_that_were_not_sent_are_in_no_picture() {
    let mut sink = McapSink::new(Cursor::new(Vec::new())).unwrap();
    full_bus().entries.iter().for_each(|entry| sink.write(entry).unwrap());
    let bytes = sink.finish().unwrap().into_inner();
    let of = |topic: &str| -> Vec<serde_json::Value> {
        let messages = mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap);
        let messages = messages.filter(|message| message.channel.topic == topic);
        messages.map(|message| serde_json::from_slice(&message.data).unwrap()).collect()
    };
    let (raw, pressure) = (of("/node42/sensor0/raw"), of("/node42/sensor0/pressure"));
    assert_eq!((raw.len(), pressure.len()), (FRAMES as usize, FRAMES as usize - 1));
    let region = |sequence: usize| raw[sequence]["region"].to_string();
    assert_eq!([11, 12, 35].map(region), ["[0,32,0,32]", "[4,24,0,32]", "[0,0,0,0]"]);
}

#[test]
fn pictures_of_others_are_named() {
    let image = mcap::Schema {
        id: 1,
        name: "foxglove.RawImage".to_owned(),
        encoding: "jsonschema".to_owned(),
        data: b"{}".into(),
    };
    let schema = Some(std::sync::Arc::new(image));
    let mut writer = mcap::Writer::new(Cursor::new(Vec::new())).unwrap();
    for (id, topic) in [(1, "/node42/sensor0/pressure"), (2, "/camera/pressure")] {
        let (schema, topic) = (schema.clone(), topic.to_owned());
        let channel = mcap::Channel {
            id,
            topic,
            schema,
            message_encoding: "json".to_owned(),
            metadata: BTreeMap::new(),
        };
        let data = b"{}".as_slice().into();
        let message =
            mcap::Message { channel: channel.into(), sequence: 0, log_time: 0, publish_time: 0, data };
        writer.write(&message).unwrap();
    }
    writer.finish().unwrap();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("r.mcap");
    fs::write(&path, writer.into_inner().into_inner()).unwrap();
    let mut reader = open(&path, Format::Mcap).unwrap();
    assert_eq!(reader.by_ref().count(), 1, "no frame in it");
    assert_eq!(reader.notes(), ["1 messages of /camera/pressure are left out"]);
}

/// Two buses in one recording may have a module of the same address each.
#[test]
fn a_module_on_two_interfaces_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let mut two = recording(|_| false);
    let at = two.entries.len() - 1;
    two.entries[at].interface = "can7".to_owned();
    for (format, name, entry) in [
        (Format::Candump, "r.log", format!("line {}: ", at + 1)),
        (Format::Mcap, "r.mcap", "message ".to_owned()),
    ] {
        let path = dir.path().join(name);
        write(&path, format, |sink| records(&two).try_for_each(|record| sink.put(&record))).unwrap();
        let error = format!("{:#}", read(&path, format).unwrap_err());
        assert!(error.contains(&entry) && error.contains("node 42 speaks on can1 and on can7"), "{error}");
    }
}

/// Numbers begin anew with a start of the module.
#[test]
fn a_stretch_is_of_one_start_of_the_module() {
    let later = |mut entries: Vec<LogEntry>| {
        entries.iter_mut().for_each(|entry| entry.timestamp_us += 1_000_000);
        entries
    };
    let whole = recording(|_| false).entries;
    let start_us = rebuilt(&whole).unwrap().start_us;
    for (first, count) in [(recording(|n| n > 29).entries, 60), (recording(|n| n == 20).entries, 78)] {
        let rebuilt = rebuilt(&[first, later(whole.clone())].concat()).unwrap();
        assert_eq!((rebuilt.first, rebuilt.episode.frames()), (0, FRAMES as usize));
        assert_eq!(rebuilt.start_us, start_us + 1_000_000);
        let said = format!("{count} of {} raw messages are left out", count + 80);
        assert!(rebuilt.notes[0].contains(&said), "{:?}", rebuilt.notes);
    }
    let twice = rebuilt(&[whole.clone(), later(whole.clone())].concat()).unwrap();
    assert_eq!((twice.start_us, twice.episode.frames()), (start_us, FRAMES as usize));
    assert!(twice.notes[0].contains("80 of 160 raw messages are left out"), "{:?}", twice.notes);
}

#[test]
fn frames_that_came_in_another_order_are_rebuilt() {
    let mut entries = recording(|_| false).entries;
    let a_frame = entries.len() / FRAMES as usize;
    entries[9 * a_frame..14 * a_frame].rotate_left(a_frame);
    let rebuilt = rebuilt(&entries).unwrap();
    assert_eq!((rebuilt.first, rebuilt.episode.frames()), (0, FRAMES as usize));
}

#[test]
fn an_episode_names_the_calibrations_it_was_read_by() {
    let mut entries = recording(|_| false).entries;
    assert_eq!(rebuilt(&entries).unwrap().episode.meta.other.get("calibration"), None);
    let record = |node: u8, text: &str| {
        let id =
            MessageId { priority: Priority::Optional, port: RECORD_PORT, node: NodeId::new(node).unwrap() };
        let head = [0, 0, 0, 0, 0, 0, 0, 2, text.len() as u8];
        let frame = Frames::new(id, 0, &[&head[..], text.as_bytes()].concat()).next().unwrap();
        LogEntry { frame, ..entries[0].clone() }
    };
    let said =
        ["calibration 0: none", "calibration 1: 3 1a2b3c4d", "calibration 0: 1 00000007", "model: the one"];
    let said: Vec<_> = said.map(|text| record(entries[0].frame.id() as u8 & 127, text)).into();
    let other = record(99, "calibration 0: 9 99999999");
    entries.extend(said);
    entries.push(other);
    let episode = rebuilt(&entries).unwrap().episode;
    let expected = serde_json::json!({"0": "none, then 1 00000007", "1": "3 1a2b3c4d"});
    assert_eq!(episode.meta.other["calibration"], expected);
}
