//! MCAP recordings: read or refused in one line, whatever they hold.

use std::io::Cursor;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use mcap::WriteOptions;
use mcap::records::MessageHeader;
use slipsense::wire::{CanFrame, NodeId, SlipMessage, Transmitter};
use slipsense_fuzz::{corpus, mutate, run};
use slipsense_recording::candump::LogEntry;
use slipsense_recording::mcap_file::{McapSink, parse};

const CORPUS: &str = "host-tools/fuzz/corpus/mcap";

#[test]
fn mcap_files() {
    let corpus = corpus(CORPUS);
    let ran = run(
        "mcap",
        |rng| mutate(&corpus, rng),
        |bytes| match parse(bytes) {
            Ok(_) => true,
            Err(error) => {
                let error = format!("{error:#}");
                assert!(!error.is_empty() && !error.contains('\n'), "{error:?}");
                false
            }
        },
    );
    assert!(ran.accepted * 100 > ran.inputs, "almost nothing gets through: {ran:?}");
}

#[test]
fn the_corpus_is_read() {
    for bytes in corpus(CORPUS) {
        assert!(!parse(&bytes).unwrap().entries.is_empty());
    }
}

/// A recording as this project writes it, and one without chunks and checksums, in which changes get further.
#[test]
#[ignore = "writes files"]
fn write_corpus() {
    let folder = format!("{}/../../{CORPUS}", env!("CARGO_MANIFEST_DIR"));
    std::fs::create_dir_all(&folder).unwrap();
    let mut transmitter = Transmitter::new(NodeId::DEFAULT);
    let frames: Vec<_> = (0..3)
        .map(|sequence| transmitter.slip(&SlipMessage { sequence, sensors: 1, ..SlipMessage::default() }))
        .collect();

    let mut sink = McapSink::new(Cursor::new(Vec::new())).unwrap();
    for (&frame, timestamp_us) in frames.iter().zip(1_000..) {
        sink.write(&LogEntry { timestamp_us, interface: "can0".to_owned(), frame }).unwrap();
    }
    sink.displacement(2_000, 1.5).unwrap();
    let whole = sink.finish().unwrap().into_inner();
    std::fs::write(format!("{folder}/recording.mcap"), &whole).unwrap();
    std::fs::write(format!("{folder}/cut.mcap"), &whole[..whole.len() * 2 / 5]).unwrap();

    let plain = plain("/can/can0", &frames, 1_000);
    std::fs::write(format!("{folder}/plain.mcap"), plain).unwrap();
}

/// Without chunks and checksums.
fn plain(topic: &str, frames: &[CanFrame], time_ns: u64) -> Vec<u8> {
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

/// What the fuzz found after 42,955 inputs, and what it led to: a name that a log could not hold.
#[test]
fn a_topic_of_two_lines_is_refused_in_one() {
    let frame = [CanFrame::new(1, &[2]).unwrap()];
    assert_eq!(parse(&plain("/can/can0", &frame, 1_000)).unwrap().entries.len(), 1);
    for (topic, time_ns, rule) in [
        ("/can/c\n0", 1_000, "message 0 of /can/c\\n0: an interface needs a name without white space"),
        ("/can/", 1_000, "message 0 of /can/: an interface needs a name without white space"),
        ("/can/can0", 1, "message 0 of /can/can0: time is no whole microsecond"),
    ] {
        assert_eq!(format!("{:#}", parse(&plain(topic, &frame, time_ns)).unwrap_err()), rule);
    }
}
