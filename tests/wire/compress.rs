//! The compressed raw frame: what goes in comes out, whatever it is; no frame becomes longer than plain by more than 5
//! bytes. That no bytes make the decoder fail is shown in `host-tools/recording`, that a second decoder reads the same in
//! Python (`tests/python/check_can_log.py`).

use proptest::prelude::*;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slipsense::health;
use slipsense::params::{ACTIVE_TAXELS, TAXEL_COLS, TAXEL_TOUCH_MIN, TAXELS};
use slipsense::sensor::{PiezoFrame, SensorInput, XlSample};
use slipsense::wire::{
    COMPRESSED_BYTES_MAX, COMPRESSED_FRAME_BYTES, COMPRESSED_PORT, DecodeError, Detail, MessageId,
    RAW_BYTES_MAX, RAW_XL_MAX, RawBuffer, RawForm, RawFrame, RawMessage, ReceiveError, Received, Receiver,
    Region, Transmitter, crc16,
};

use super::{NODE, RawParts, expected, frame, raw};
use crate::tasks::world::assert_taxels;

/// The check in a message, and the data behind it and their length: `6202.RawCompressed.1.0.dsdl`.
const CHECK_AT: usize = 20;
const DATA_AT: usize = CHECK_AT + 4;
/// Form, check and length, which a plain message does not have.
const LONGER_MAX: usize = 1 + 2 + 2;

fn compressed(frame: &RawFrame<'_>, detail: Detail) -> Vec<u8> {
    frame.compress(detail, &mut RawBuffer::new()).to_vec()
}

/// At most 5 bytes more than plain, which is less than 2 %, come back as what they were; how many bytes.
fn assert_round_trip(parts: &RawParts) -> usize {
    let frame = frame(parts);
    let message = compressed(&frame, Detail::All);
    let (bytes, plain) = (message.len(), frame.encode(&mut RawBuffer::new()).len());
    let mut want = expected(parts);
    if parts.4.is_none() {
        want.region = Region::NONE;
    }
    assert_eq!(RawMessage::decompress(&message), Ok(want));
    assert!(bytes <= plain + LONGER_MAX && bytes * 100 <= plain * 102, "{bytes} bytes of {plain}");
    assert!(bytes <= COMPRESSED_BYTES_MAX);
    bytes
}

/// A pad with a smooth contact under noise of this many counts, and a vibration of this many LSB.
fn contact(seed: u64, noise: i32, vibration: i32) -> RawParts {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (row, col, height) = (rng.random_range(4..28), rng.random_range(4..28), rng.random_range(0..4_500));
    let mut counts = [0u16; TAXELS];
    for (index, count) in counts.iter_mut().enumerate() {
        let (r, c) = ((index / TAXEL_COLS) as i32 - row, (index % TAXEL_COLS) as i32 - col);
        let pressed = height * (64 - r * r - c * c).max(0) / 64;
        *count = (pressed + rng.random_range(-noise..=noise)).clamp(0, 4_095) as u16;
    }
    let mut xl = vec![];
    let mut at: [i16; 3] = rng.random();
    for _ in 0..rng.random_range(30..36) {
        at = at.map(|at| at.wrapping_add(rng.random_range(-vibration..=vibration) as i16));
        xl.push(at);
    }
    let (timestamp_us, sequence, sensor) =
        (rng.random_range(0..1 << 56), rng.random(), rng.random_range(0..3));
    (timestamp_us, sequence, sensor, 0, Some(PiezoFrame::from_scan(counts)), Some(xl), rng.random())
}

fn all_of(count: u16, sample: XlSample, samples: usize) -> RawParts {
    let scan = PiezoFrame::from_scan([count; TAXELS]);
    (0, 0, 0, 0, Some(scan), Some(vec![sample; samples]), 0)
}

proptest! {
    #[test]
    fn any_frame_comes_back(parts in raw()) {
        assert_round_trip(&parts);
    }

    #[test]
    fn contacts_come_back_and_are_short(seed in any::<u64>(), noise in 0i32..4, vibration in 0i32..200) {
        let bytes = assert_round_trip(&contact(seed, noise, vibration));
        prop_assert!(bytes < RAW_BYTES_MAX / 2, "{bytes} bytes");
    }

    #[test]
    fn counts_of_two_levels_come_back(levels in any::<[u16; 2]>(), bits in proptest::collection::vec(any::<bool>(), TAXELS)) {
        let counts: Vec<u16> = bits.iter().map(|&bit| levels[usize::from(bit)]).collect();
        let scan = PiezoFrame::from_scan(counts.try_into().unwrap());
        assert_round_trip(&(0, 0, 0, 0, Some(scan), Some(vec![]), 0));
    }

    #[test]
    fn samples_at_the_edges_come_back(
        samples in proptest::collection::vec(proptest::array::uniform3(
            prop_oneof![Just(i16::MIN), Just(i16::MAX), Just(-1), Just(0), any::<i16>()]
        ), 0..=RAW_XL_MAX),
    ) {
        assert_round_trip(&(0, 0, 0, 0, None, Some(samples), 0));
    }

    #[test]
    fn the_contact_alone_comes_back(seed in any::<u64>(), noise in 0i32..4) {
        let parts = contact(seed, noise, 50);
        let message = RawMessage::decompress(&compressed(&frame(&parts), Detail::Contact)).unwrap();
        let scan = parts.4.as_ref().unwrap();
        assert_taxels(&message, scan);
        let mut counts = scan.counts().iter().zip(message.piezo.counts());
        prop_assert!(counts.all(|(&count, &got)| got == count || count < TAXEL_TOUCH_MIN));
        prop_assert_eq!(message.xl, expected(&parts).xl);
    }

    #[test]
    fn a_changed_byte_is_noticed(seed in any::<u64>(), flip in 1u8..) {
        assert_changes_are_noticed(&compressed(&frame(&contact(seed, 1, 50)), Detail::All), [flip]);
    }

    #[test]
    fn a_message_cut_short_is_noticed(seed in any::<u64>(), at in any::<prop::sample::Index>()) {
        let bytes = compressed(&frame(&contact(seed, 1, 50)), Detail::All);
        let error = RawMessage::decompress(&bytes[..at.index(bytes.len())]).unwrap_err();
        let truncated = matches!(error, DecodeError::Truncated { .. });
        prop_assert!(truncated, "{}", error);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]
    /// For certain, not only because a CRC rarely fits by chance: here it is made to fit.
    #[test]
    fn a_wrong_length_is_noticed(seed in any::<u64>(), behind in proptest::collection::vec(any::<u8>(), 300)) {
        let bytes = compressed(&frame(&contact(seed, 1, 50)), Detail::All);
        let length = bytes.len() - DATA_AT;
        let padded = [&bytes[..], &behind].concat();
        for wrong in (0..length + behind.len()).filter(|&wrong| wrong != length) {
            let mut bytes = padded.clone();
            bytes[DATA_AT - 2..DATA_AT].copy_from_slice(&(wrong as u16).to_le_bytes());
            let checked = [&bytes[..CHECK_AT], &bytes[CHECK_AT + 2..DATA_AT + wrong]].concat();
            bytes[CHECK_AT..CHECK_AT + 2].copy_from_slice(&crc16(&checked).to_le_bytes());
            prop_assert!(RawMessage::decompress(&bytes).is_err(), "{} bytes of {}", wrong, length);
        }
    }
}

/// No byte of these may be another by one of the flips.
fn assert_changes_are_noticed(bytes: &[u8], flips: impl IntoIterator<Item = u8> + Clone) {
    let mut changed = bytes.to_vec();
    for at in 0..bytes.len() {
        for flip in flips.clone() {
            changed[at] ^= flip;
            assert!(RawMessage::decompress(&changed).is_err(), "byte {at} of {}, flip {flip}", bytes.len());
            changed[at] ^= flip;
        }
    }
}

#[test]
fn every_change_of_a_byte_of_the_corpus_is_noticed() {
    for bytes in corpus() {
        assert_changes_are_noticed(&bytes, 1..=255);
    }
    // The last byte of this one, flipped by 16, once made no difference.
    let bytes = compressed(&frame(&contact(4_772_567_262_682_789_587, 1, 50)), Detail::All);
    assert_changes_are_noticed(&bytes, 1..=255);
}

#[test]
fn an_axis_that_has_stopped_costs_its_first_sample() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let mut xl: Vec<XlSample> = vec![[-7, 32_767, -32_768]; 33];
    let parts = |xl: &[XlSample]| (0, 0, 0, 0, None, Some(xl.to_vec()), 0);
    // 22 bits for each axis: 4 units of 16, of which 2 bits are still in the coder's last 2.
    assert_eq!(assert_round_trip(&parts(&xl)), DATA_AT + 12);
    xl.iter_mut().for_each(|sample| sample[1] = rng.random());
    assert_round_trip(&parts(&xl));
    xl[32][2] = 0;
    assert_round_trip(&parts(&xl));
}

#[test]
fn the_extremes_are_within_the_bound() {
    let nothing = assert_round_trip(&all_of(0, [0; 3], 33));
    assert!(nothing < 60, "an untouched pad takes {nothing} bytes");
    for count in [1, 2_047, 4_094, 4_095] {
        for sample in [[0; 3], [i16::MIN; 3], [i16::MAX; 3]] {
            assert_round_trip(&all_of(count, sample, RAW_XL_MAX));
        }
    }
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut longest = 0;
    for _ in 0..200 {
        let scan = PiezoFrame::from_scan(std::array::from_fn(|_| rng.random_range(0..4_096)));
        let xl = (0..RAW_XL_MAX).map(|_| rng.random()).collect();
        let parts = (u64::MAX >> 8, u32::MAX, 2, 255, Some(scan), Some(xl), u32::MAX);
        longest = longest.max(assert_round_trip(&parts));
    }
    assert_eq!(longest, COMPRESSED_BYTES_MAX, "random bits are packed, not coded");
}

#[test]
fn a_part_that_is_missing_is_told() {
    let parts = contact(3, 1, 50);
    let whole = frame(&parts);
    let sent =
        |input, detail| RawMessage::decompress(&compressed(&RawFrame { input, ..whole }, detail)).unwrap();
    let message = sent(SensorInput { xl: None, ..whole.input }, Detail::All);
    assert_eq!((message.health, message.xl.len()), (health::XL_MISSING, 0));
    let message = sent(SensorInput { piezo: None, ..whole.input }, Detail::All);
    assert_eq!((message.health, message.region), (health::PIEZO_MISSING, Region::NONE));
    // Left out because the bus is full is not missing.
    let message = sent(whole.input, Detail::Accelerometer);
    assert_eq!((message.health, message.region), (0, Region::NONE));
    assert_eq!(message.xl, expected(&parts).xl);
}

#[test]
fn less_detail_is_shorter() {
    let mut longer = [0; 3];
    for seed in 0..100 {
        let parts = contact(seed, 1, 50);
        let bytes = [Detail::Accelerometer, Detail::Contact, Detail::All]
            .map(|detail| compressed(&frame(&parts), detail).len());
        longer.iter_mut().zip(bytes).for_each(|(sum, bytes)| *sum += bytes);
    }
    assert!(longer.is_sorted() && longer[0] * 2 < longer[2], "{longer:?}");
}

#[test]
fn a_region_holds_the_contact_and_no_more() {
    let mut counts = [0; TAXELS];
    counts[7 * TAXEL_COLS + 9] = TAXEL_TOUCH_MIN;
    counts[12 * TAXEL_COLS + 11] = 4_095;
    counts[20 * TAXEL_COLS + 20] = TAXEL_TOUCH_MIN - 1;
    let region = Region::around_contact(&PiezoFrame::from_scan(counts));
    assert_eq!(region, Region { first_row: 7, rows: 6, first_col: 9, cols: 3 });
    assert_eq!(region.taxels(), 18);
    assert_eq!(Region::around_contact(&PiezoFrame::zeroed()), Region::NONE);
    assert_eq!(Region::ALL.taxels(), ACTIVE_TAXELS);
    assert_eq!((0..32).map(|row| Region::ALL.cols(row).len()).sum::<usize>(), ACTIVE_TAXELS);
}

#[test]
fn a_lost_frame_costs_its_message_and_no_other() {
    let (mut transmitter, mut receiver) = (Transmitter::new(NODE), Receiver::new(NODE));
    let mut buffer = RawBuffer::new();
    let (mut received, mut errors) = (vec![], vec![]);
    for sequence in 0..20u32 {
        let mut parts = contact(sequence.into(), 1, 50);
        parts.1 = sequence;
        let frames: Vec<_> =
            transmitter.raw_as(RawForm::Compressed(Detail::All), &frame(&parts), &mut buffer).collect();
        assert_eq!(MessageId::from_can(frames[0].id()).unwrap().port, COMPRESSED_PORT);
        let (last, full) = frames.split_last().unwrap();
        assert!(full.iter().all(|frame| frame.data().len() == COMPRESSED_FRAME_BYTES));
        assert!(!full.is_empty() && last.data().len() <= COMPRESSED_FRAME_BYTES);
        let lost = (sequence == 7).then_some(1);
        for (index, can_frame) in frames.iter().enumerate().filter(|&(index, _)| Some(index) != lost) {
            match receiver.accept(can_frame) {
                Ok(Some(Received::Raw(message))) => {
                    assert_eq!(message, expected(&parts), "frame {index}");
                    received.push(sequence);
                }
                Ok(None) => {}
                Ok(Some(other)) => panic!("{other:?}"),
                Err(ReceiveError::Transfer { port: COMPRESSED_PORT, error }) => errors.push(error),
                Err(other) => panic!("{other}"),
            }
        }
    }
    assert_eq!(received, (0..20).filter(|&sequence| sequence != 7).collect::<Vec<_>>());
    assert_eq!(receiver.missed(), 1);
    assert!(!errors.is_empty());
}

const CORPUS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/wire/corpus");

/// The committed messages of `tests/wire/corpus`, which also pin the format: each decodes.
fn corpus() -> Vec<Vec<u8>> {
    let mut paths: Vec<_> = std::fs::read_dir(CORPUS).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    assert!(paths.len() >= 8, "{CORPUS}: the corpus is not there");
    paths.iter().map(|path| std::fs::read(path).unwrap()).collect()
}

/// Each message of the corpus still means the same: an older recording can be read. The frames are made anew here.
#[test]
fn the_corpus_is_what_the_encoder_writes() {
    let made = corpus_frames();
    for (parts, bytes) in made.iter().zip(corpus()) {
        assert_eq!(compressed(&frame(parts), Detail::All), bytes);
        assert!(RawMessage::decompress(&bytes).is_ok());
    }
    assert_eq!(made.len(), corpus().len());
}

fn corpus_frames() -> Vec<RawParts> {
    let mut frames: Vec<_> =
        [(0, 0), (1, 10), (2, 100), (3, 2_000)].map(|(noise, xl)| contact(9, noise, xl)).into();
    frames.extend([all_of(0, [0; 3], 33), all_of(4_095, [i16::MIN; 3], 1), all_of(0, [0; 3], 0)]);
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let scan = PiezoFrame::from_scan(std::array::from_fn(|_| rng.random_range(0..4_096)));
    frames.push((5, 6, 1, 0, Some(scan), Some((0..33).map(|_| rng.random()).collect()), 33));
    // Tones whose samples go on as the two before them, or back.
    let mut tone = contact(9, 1, 0);
    let samples = (0i16..33).map(|at| {
        let slope = 90 * ((at + 4) % 16 - 8).abs();
        [slope, -2 * slope, 900 * (at % 2) + 40 * (at % 5)]
    });
    tone.5 = Some(samples.collect());
    frames.push(tone);
    frames
}

/// Writes the corpus, where the format was meant to change.
#[test]
#[ignore = "writes files"]
fn write_corpus() {
    std::fs::create_dir_all(CORPUS).unwrap();
    for (index, parts) in corpus_frames().iter().enumerate() {
        std::fs::write(format!("{CORPUS}/{index}.bin"), compressed(&frame(parts), Detail::All)).unwrap();
    }
}
