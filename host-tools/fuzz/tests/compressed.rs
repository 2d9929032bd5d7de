//! Compressed raw messages: the decoder ends with a message or an error, and what it takes for a message can be sent
//! again.

use slipsense::sensor::SensorInput;
use slipsense::wire::{Detail, RawBuffer, RawFrame, RawMessage};
use slipsense_fuzz::{corpus, mutate, run};

#[test]
fn compressed() {
    let corpus = corpus("tests/wire/corpus");
    let ran = run(
        "compressed",
        |rng| mutate(&corpus, rng),
        |bytes| {
            let Ok(message) = RawMessage::decompress(bytes) else { return false };
            let input = SensorInput { piezo: Some(&message.piezo), xl: Some(&message.xl) };
            let RawMessage { timestamp_us, sequence, sensor, health, xl_end, .. } = message;
            let again = RawFrame { timestamp_us, sequence, sensor, health, input, xl_end };
            let mut buffer = RawBuffer::new();
            let again = RawMessage::decompress(again.compress(Detail::All, &mut buffer)).unwrap();
            assert_eq!((&again.piezo, &again.xl), (&message.piezo, &message.xl));
            true
        },
    );
    assert!(ran.accepted * 100 > ran.inputs, "almost nothing gets through: {ran:?}");
}
