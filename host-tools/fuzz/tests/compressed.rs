//! Compressed raw messages: the decoder ends with a message or an error, and what it takes for a message can be sent
//! again.

use rand::Rng;
use slipsense::sensor::SensorInput;
use slipsense::wire::{Detail, RawBuffer, RawFrame, RawMessage, crc16};
use slipsense_fuzz::{corpus, mutate, run};

/// The check, and the length of the data behind it, in a message: `6202.RawCompressed.1.0.dsdl`.
const CHECK_AT: usize = 20;
const DATA_AT: usize = CHECK_AT + 4;

/// Make the check right, else nothing changed would get as far as the coded bytes.
fn with_check(mut bytes: Vec<u8>) -> Vec<u8> {
    if let Some(&[_, _, low, high]) = bytes.get(CHECK_AT..DATA_AT) {
        let end = bytes.len().min(DATA_AT + usize::from(u16::from_le_bytes([low, high])));
        let checked = [&bytes[..CHECK_AT], &bytes[CHECK_AT + 2..end]].concat();
        bytes[CHECK_AT..CHECK_AT + 2].copy_from_slice(&crc16(&checked).to_le_bytes());
    }
    bytes
}

#[test]
fn compressed() {
    let corpus = corpus("tests/wire/corpus");
    let ran = run(
        "compressed",
        |rng| {
            let bytes = mutate(&corpus, rng);
            if rng.random() { with_check(bytes) } else { bytes }
        },
        |bytes| {
            let Ok(message) = RawMessage::decompress(bytes) else { return false };
            let RawMessage { timestamp_us, sequence, sensor, health, xl_end, .. } = message;
            let input = SensorInput { piezo: Some(&message.piezo), xl: Some(&message.xl), xl_end };
            let again = RawFrame { timestamp_us, sequence, sensor, health, input };
            let mut buffer = RawBuffer::new();
            let again = RawMessage::decompress(again.compress(Detail::All, &mut buffer)).unwrap();
            assert_eq!((&again.piezo, &again.xl), (&message.piezo, &message.xl));
            true
        },
    );
    assert!(ran.accepted * 100 > ran.inputs, "almost nothing gets through: {ran:?}");
}
