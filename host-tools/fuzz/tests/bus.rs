//! The bus: CAN frames to messages, and candump logs to frames.

use slipsense::params::TAXELS;
use slipsense::sensor::{PiezoFrame, SensorInput};
use slipsense::wire::{
    CanFrame, Detail, MessageId, NodeId, RawBuffer, RawForm, RawFrame, Received, Sessions, SlipMessage,
    TransferId, Transmitter,
};
use slipsense_fuzz::{corpus, mutate, run};
use slipsense_recording::candump::{CandumpReader, CandumpWriter};
use slipsense_recording::decode::Decoder;

/// Traffic as this test stores it: of each frame the identifier, low byte first, its length, its data.
const TRAFFIC: &str = "host-tools/fuzz/corpus/bus";
const LOGS: &str = "host-tools/fuzz/corpus/candump";
/// Bytes of the transfers that a node takes part in.
const TRANSFER_MAX: usize = 600;

/// A length that CAN FD does not have is cut down to one.
fn frames(mut bytes: &[u8]) -> Vec<CanFrame> {
    let mut frames = Vec::new();
    while let Some((&[a, b, c, d, length], rest)) = bytes.split_first_chunk() {
        let (id, length) =
            (u32::from_le_bytes([a, b, c, d]) & 0x1FFF_FFFF, usize::from(length).min(rest.len()));
        let frame = (0..=length).rev().find_map(|length| CanFrame::new(id, &rest[..length]).ok());
        frames.extend(frame);
        bytes = &rest[length..];
    }
    frames
}

/// What one input is made of: a slip message and one raw message, in each form. Few frames, so that inputs are many.
fn traffic() -> Vec<Vec<CanFrame>> {
    let mut transmitter = Transmitter::new(NodeId::DEFAULT);
    let mut buffer = RawBuffer::new();
    let piezo = PiezoFrame::from_scan(std::array::from_fn::<u16, TAXELS, _>(|i| (i % 37 * 90) as u16));
    let xl = [[-3, 1, 2047]; 33];
    let forms = [RawForm::Compressed(Detail::All), RawForm::Compressed(Detail::Contact), RawForm::Plain];
    let mut messages = |(sequence, form)| {
        let mut frames =
            vec![transmitter.slip(&SlipMessage { sequence, sensors: 2, ..SlipMessage::default() })];
        let input = SensorInput { piezo: Some(&piezo), xl: Some(&xl), xl_end: 33 };
        let raw = RawFrame { timestamp_us: 5, sequence, sensor: 1, health: 0, input };
        frames.extend(transmitter.raw_as(form, &raw, &mut buffer));
        frames
    };
    (0..).zip([forms, forms].concat()).map(&mut messages).collect()
}

#[test]
fn bus() {
    let corpus = corpus(TRAFFIC);
    let ran = run(
        "bus",
        |rng| mutate(&corpus, rng),
        |bytes| {
            let (mut decoder, mut messages) = (Decoder::new(), 0);
            let mut sessions = Sessions::<4, TRANSFER_MAX>::new();
            for (index, frame) in frames(bytes).iter().enumerate() {
                match decoder.accept(frame) {
                    Some(decoded) => {
                        messages += 1;
                        let slip = matches!(decoded.message, Received::Slip(_));
                        assert!(slip || MessageId::from_can(frame.id()).is_ok());
                    }
                    None => {
                        // As a node does with what it has subscribed to.
                        let id = TransferId::from_can(frame.id());
                        _ = id.map(|id| {
                            sessions.accept(id, frame, index as u64 * 1000).map(|whole| whole.is_some())
                        });
                    }
                }
            }
            messages > 0
        },
    );
    assert!(ran.accepted * 2 > ran.inputs, "almost nothing gets through: {ran:?}");
}

#[test]
fn candump() {
    let corpus = corpus(LOGS);
    let ran = run(
        "candump",
        |rng| mutate(&corpus, rng),
        |bytes| {
            let mut entries = 0;
            for line in CandumpReader::new(bytes) {
                match line {
                    Ok(_) => entries += 1,
                    Err(error) => assert_one_line(&error.to_string()),
                }
            }
            entries > 0
        },
    );
    assert!(ran.accepted * 2 > ran.inputs, "almost nothing gets through: {ran:?}");
}

fn assert_one_line(error: &str) {
    assert!(!error.is_empty() && !error.contains('\n'), "{error:?}");
}

#[test]
fn the_corpus_is_what_the_transmitter_sends() {
    let stored: Vec<Vec<CanFrame>> = corpus(TRAFFIC).iter().map(|bytes| frames(bytes)).collect();
    assert_eq!(stored, traffic());
}

/// Writes the corpus, where the messages were meant to change.
#[test]
#[ignore = "writes files"]
fn write_corpus() {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../../");
    std::fs::create_dir_all(format!("{root}{TRAFFIC}")).unwrap();
    std::fs::create_dir_all(format!("{root}{LOGS}")).unwrap();
    let traffic = traffic();
    for (index, frames) in traffic.iter().enumerate() {
        let bytes: Vec<u8> = frames
            .iter()
            .flat_map(|frame| {
                [&frame.id().to_le_bytes()[..], &[frame.data().len() as u8], frame.data()].concat()
            })
            .collect();
        std::fs::write(format!("{root}{TRAFFIC}/{index}.bin"), bytes).unwrap();
    }
    let mut log = CandumpWriter::new(Vec::new(), "can0").unwrap();
    traffic.concat().iter().take(8).zip(0..).for_each(|(frame, us)| log.write(us * 4_167, frame).unwrap());
    let mut log = log.finish().unwrap();
    log.extend_from_slice(b"(1700000000.000001) vcan1 123#0102\n(1.5) can0 1F334455#R\n\n# a comment\n");
    std::fs::write(format!("{root}{LOGS}/log.txt"), log).unwrap();
}
