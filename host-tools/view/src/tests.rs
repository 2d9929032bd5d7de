//! Frames on their way to the page: the record's bytes, what the store keeps, a log put together again.

use std::io::Cursor;

use slipsense::features::{LN_FRAC_BITS, XlFrontEnd};
use slipsense::fixed::Q;
use slipsense::net::Model;
use slipsense::net::format::Dims;
use slipsense::pipeline::{FrameStamp, Pipeline};
use slipsense::sensor::{PiezoFrame, SensorInput, XlSample};
use slipsense::wire::{Detail, NodeId, Origin, RAW_XL_MAX, RawBuffer, RawForm, SlipMessage, Transmitter};
use slipsense_recording::candump::CandumpWriter;
use slipsense_recording::model_file::random_model;

use super::frames::{CHUNK, Frames, Session};
use super::record::{HEADER_BYTES, Record, SENSOR_BYTES, SensorRecord, bytes};
use super::source;

const FRAMES: u32 = 20;
/// Frame whose slip message is lost, and frame of which one raw CAN frame is.
const LOST: u32 = 7;
const BROKEN: u32 = 12;
/// Frame with more samples than a message holds, and frame that the bus has no room for but its samples.
const LONG: u32 = 15;
const NO_TAXELS: u32 = 17;

fn frames(sensors: usize, capacity: usize) -> Frames {
    Frames::new(Session { sensors, ..Session::of_log("test".into(), false) }, capacity)
}

fn numbered(sequence: u32) -> Record {
    Record::of_message(SlipMessage { sequence, sensors: 1, ..SlipMessage::default() })
}

#[test]
fn a_record_is_laid_out_as_its_table_says() {
    let mut counts = [0; 1024];
    counts[16 * 32 + 5] = 0x0abc;
    let mut slip = SlipMessage {
        timestamp_us: 1_500_000,
        sequence: 0x0102_0304,
        class: 2,
        slip: true,
        logits: [-1, 2, 1024].map(Q::from_bits),
        late_frames: 7,
        invalid: 4,
        degraded: 16,
        sensors: 2,
        ..SlipMessage::default()
    };
    slip.contact[1].health = 3;
    slip.contact[1].sum = 70_000;
    slip.contact[1].axis_deg = -90;
    let piezo = Some(PiezoFrame::from_counts(counts).unwrap());
    let sensors = vec![SensorRecord::default(), SensorRecord { piezo, log_mel: None }];
    let record = Record { lost: 9, truth: Some(true), sensors, ..Record::of_message(slip) };
    assert_eq!(record.mark(), 1 | 4 | 8 | 2 << 4 | 64 | 128);

    let mut out = Vec::new();
    record.encode(3, &mut out);
    assert_eq!(out.len(), bytes(3));
    assert_eq!(out[20..24], (-4i32).to_le_bytes());
    assert_eq!(out[..8], [4, 3, 2, 1, 9, 0, 0, 0]);
    assert_eq!(f64::from_le_bytes(out[8..16].try_into().unwrap()), 1_500_000.0);
    assert_eq!(out[16..20], [2, 1 | 4 | 8, 2, 4]);
    assert_eq!(out[28..34], [0, 16, 0, 0, 7, 16]);
    let second = &out[HEADER_BYTES + SENSOR_BYTES..];
    assert_eq!((second[0], second[1]), (3, 1));
    assert_eq!(u32::from_le_bytes(second[4..8].try_into().unwrap()), 70_000);
    assert_eq!(second[12] as i8, -90);
    let taxel = 16 + 32 + 2 * (16 * 32 + 5);
    assert_eq!(second[taxel..taxel + 2], [0xbc, 0x0a]);
    assert!(out[HEADER_BYTES + 2 * SENSOR_BYTES..].iter().all(|&byte| byte == 0), "no third sensor");
}

#[test]
fn the_last_seconds_are_kept_packed_and_said_from_where() {
    let mut frames = frames(1, 2 * CHUNK);
    let end = 3 * CHUNK + 5;
    (0..end).for_each(|sequence| frames.push(&numbered(sequence as u32)));
    let (state, first) = (frames.state(), CHUNK as u64);
    assert_eq!((state.first, state.end, state.ended), (first, end as u64, false));
    let records = |request: &str| {
        let answer = frames.answer(request).unwrap();
        let sequences =
            answer.body.chunks_exact(bytes(1)).map(|one| u32::from_le_bytes(one[..4].try_into().unwrap()));
        (answer.first.unwrap(), sequences.collect::<Vec<_>>())
    };
    let numbers = |range: std::ops::Range<usize>| range.map(|number| number as u32).collect::<Vec<_>>();
    assert_eq!(records("records?from=0"), (first, numbers(CHUNK..2 * CHUNK)));
    assert_eq!(records("records?from=250"), (250, numbers(250..2 * CHUNK)));
    assert_eq!(records("records?from=722"), (722, numbers(722..end)));
    assert_eq!(records("records?from=9999"), (end as u64, vec![]));
    let marks = frames.answer("marks?from=724").unwrap();
    assert_eq!((marks.first, marks.body), (Some(724), vec![0]));
    for request in ["", "records", "records?from=", "records?from=-1", "other?from=0"] {
        assert!(frames.answer(request).is_none(), "{request}");
    }
    let kpa = frames.answer("kpa").unwrap().body;
    assert_eq!((kpa.len(), &kpa[..4]), (4 * 4096, &[0; 4][..]));
}

/// A candump log of a module with one sensor, and of each frame the pad that was felt and the samples that were sent.
fn log() -> (Vec<u8>, Vec<(PiezoFrame, Vec<XlSample>)>) {
    let file = random_model(Dims::from_fields([4, 8, 16, 32, 5, 32, 4, 60]).unwrap(), 3);
    let model = file.to_bytes().unwrap();
    let mut pipeline = Pipeline::new(Model::parse(&model).unwrap(), 1).unwrap();
    let mut transmitter = Transmitter::new(NodeId::DEFAULT);
    let (mut raw_buffer, mut felt, mut xl_end) = (RawBuffer::new(), Vec::new(), 0);
    let mut out = CandumpWriter::new(Vec::new(), "can0").unwrap();
    for sequence in 0..FRAMES {
        let mut counts = [0; 1024];
        counts[16 * 32 + 8..16 * 32 + 20].fill(100 + sequence as u16);
        let pad = PiezoFrame::from_counts(counts).unwrap();
        let samples = if sequence == LONG { 70 } else { 33 };
        let xl: Vec<XlSample> = (0..samples).map(|i| [i * 100, sequence as i16, -i]).collect();
        xl_end += xl.len() as u32;
        let inputs = [SensorInput { piezo: Some(&pad), xl: Some(&xl), xl_end }];
        let output = pipeline.step(&inputs);
        let stamp = FrameStamp::of_recording(sequence);
        let slip = transmitter.slip(&output.slip_message(stamp, &Origin::default()));
        if sequence != LOST {
            out.write(stamp.timestamp_us, &slip).unwrap();
        }
        let raw = output.raw_frame(stamp, 0, inputs[0]);
        let form =
            if sequence == NO_TAXELS { RawForm::Compressed(Detail::Accelerometer) } else { RawForm::Plain };
        for (index, frame) in transmitter.raw_as(form, &raw, &mut raw_buffer).enumerate() {
            if sequence != BROKEN || index != 4 {
                out.write(stamp.timestamp_us, &frame).unwrap();
            }
        }
        felt.push((pad, xl[xl.len().saturating_sub(RAW_XL_MAX)..].to_vec()));
    }
    (out.finish().unwrap(), felt)
}

#[test]
fn a_log_becomes_frames_again_and_damage_costs_its_frame_only() {
    let (mut log, felt) = log();
    // Traffic of others is passed over.
    log.extend(b"(1.000000) can0 123#DEADBEEF\n");
    let mut frames = frames(3, 1000);
    source::log(Cursor::new(log), NodeId::DEFAULT).for_each(|record| frames.push(&record.unwrap()));
    let state = frames.state();
    assert_eq!((state.end, state.lost), (u64::from(FRAMES) - 1, 1));
    let mut front_end = XlFrontEnd::new();
    for record in frames.answer("records?from=0").unwrap().body.chunks_exact(bytes(3)) {
        let sequence = u32::from_le_bytes(record[..4].try_into().unwrap());
        assert_eq!(record[4], u8::from(sequence == LOST + 1), "lost before frame {sequence}");
        let sensor = &record[HEADER_BYTES..][..SENSOR_BYTES];
        let present = match sequence {
            BROKEN => 0,
            NO_TAXELS => 2,
            _ => 3,
        };
        assert_eq!(sensor[1], present, "frame {sequence}");
        let (pad, xl) = &felt[sequence as usize];
        let words = |bytes: &[u8]| -> Vec<u16> {
            bytes.chunks_exact(2).map(|two| u16::from_le_bytes([two[0], two[1]])).collect()
        };
        if present == 3 {
            assert_eq!(words(&sensor[16 + 32..]), pad.counts(), "frame {sequence}");
        }
        if sequence == LOST + 1 {
            front_end.push(&felt[LOST as usize].1);
        }
        if present > 0 {
            // As the module's, the window starts anew where samples are missing.
            if sequence == BROKEN + 1 || sequence == LONG {
                front_end.restart();
            }
            front_end.push(xl);
            let ln = front_end.log_mel().ln_power.map(|ln| (ln >> (LN_FRAC_BITS - 8)) as u16);
            assert_eq!(words(&sensor[16..16 + 32]), ln, "frame {sequence}");
        }
    }
}

#[test]
fn a_line_that_is_none_ends_the_log_with_its_number() {
    let (mut log, _) = log();
    let lines = log.iter().filter(|&&byte| byte == b'\n').count();
    log.extend(b"what is this\n");
    let mut records: Vec<_> = source::log(Cursor::new(log), NodeId::DEFAULT).collect();
    let error = records.pop().unwrap().unwrap_err();
    assert!(error.to_string().starts_with(&format!("line {}: ", lines + 1)), "{error}");
    assert_eq!(records.len(), FRAMES as usize - 1, "what came before is there");
    let mut empty = frames(1, 1);
    empty.end(None);
    assert!(empty.state().problem.as_ref().unwrap().contains("no frame"));
}
