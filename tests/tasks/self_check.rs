//! The node's checks of itself: what they find, when, and that the shipped model gives its golden number.

use std::cell::RefCell;

use slipsense::health::{SelfChecks, Status};
use slipsense::net::{Aligned, Model};
use slipsense::params::FRAME_RATE_HZ;
use slipsense::pipeline::{FrameStamp, Pipeline, State};
use slipsense::settings::{Setting, Settings, model_numbers};
use slipsense::tasks::{
    CheckedMemory, GOLDEN_FRAMES, RAM_SLICE_BYTES, RamPart, RuntimeConfig, SLICE_BYTES, SelfCheck, digest,
    known_golden,
};
use slipsense::wire::{
    INVALID_MEMORY, INVALID_NETWORK, INVALID_NO_SENSOR, INVALID_OTHER_MODEL, INVALID_STARTING, Origin,
    SlipMessage,
};

use super::world::{NODE, World, model_bytes};

static MODEL: &Aligned<[u8]> = &Aligned(*include_bytes!("../../model/weights/slipsense.slipnet"));

/// Model, loops, firmware; and whether the state of a golden inference keeps what it holds.
struct Memory<'a>(&'a RefCell<[Vec<u8>; 3]>, &'a RefCell<bool>);

impl CheckedMemory for Memory<'_> {
    fn read(&mut self, at: u32, out: &mut [u8]) {
        out.copy_from_slice(&self.0.borrow()[2][at as usize..][..out.len()]);
    }

    fn digest(&mut self, part: RamPart, at: u32, bytes: u32, before: u32) -> u32 {
        digest_of(&self.0.borrow()[part as usize][at as usize..][..bytes as usize], before)
    }

    fn clear(&mut self, state: &mut State) {
        if !*self.1.borrow() {
            *state = State::new();
        }
    }
}

fn digest_of(bytes: &[u8], before: u32) -> u32 {
    bytes.as_chunks().0.iter().fold(before, |before, word| digest(before, u32::from_le_bytes(*word)))
}

/// The longest model, 13 KB of loops, and three slices of firmware whose hash is not known.
fn check<'a>(
    parts: &'a RefCell<[Vec<u8>; 3]>,
    stuck: &'a RefCell<bool>,
    golden: Option<u32>,
) -> SelfCheck<'static, Memory<'a>> {
    *parts.borrow_mut() = [vec![1; 120 << 10], vec![2; 13 << 10], vec![3; 700]];
    let [model, loops, firmware] =
        parts.borrow().each_ref().map(|bytes| (bytes.len() as u32, digest_of(bytes, 0)));
    let pipeline = Pipeline::new(Model::parse(&MODEL.0).unwrap(), 1).unwrap();
    SelfCheck::new(Memory(parts, stuck), [model, loops], (firmware.0, None), pipeline, golden)
}

/// Frames in which each part has been looked at from beginning to end: RAM in 8 and 1, flash in 3.
const PASS: u32 = 9;
const _: () = assert!(SLICE_BYTES == 256 && RAM_SLICE_BYTES == 16_384);

#[test]
fn a_changed_byte_of_code_or_model_is_found_within_a_pass() {
    let (parts, stuck) = Default::default();
    for part in 0..3 {
        let mut check = check(&parts, &stuck, None);
        let last = parts.borrow()[part].len() - 1;
        // Changed in the second pass and right again in the third: for good, as it may have decided in between.
        for (passes, failed) in [(3, 0), (6, 1 << part), (9, 1 << part)] {
            let found = (0..PASS).map(|_| check.step()).last().unwrap();
            assert_eq!((found.passes, found.failed), (passes, failed));
            parts.borrow_mut()[part][last] ^= 0x40;
        }
    }
    // Wrong from the start on, where the digest is known.
    let mut check = check(&parts, &stuck, None);
    parts.borrow_mut()[1][0] = 0;
    assert_eq!((0..PASS).map(|_| check.step()).last().unwrap().failed, 2);
}

/// A flag may be wrong for 150 ms, 36 frames.
#[test]
fn a_flipped_bit_of_the_ram_that_decides_is_found_before_flags_are_wrong_for_long() {
    let (parts, stuck) = Default::default();
    for frame in 0..PASS {
        for (part, at) in [(0, 0), (0, 50_001), (0, (120 << 10) - 1), (1, 0), (1, (13 << 10) - 1)] {
            let mut check = check(&parts, &stuck, None);
            (0..frame).for_each(|_| _ = check.step());
            parts.borrow_mut()[part][at] ^= 1 << (frame % 8);
            assert!((0..2 * PASS).any(|_| check.step().failed == 1 << part), "byte {at} of part {part}");
        }
    }
}

#[test]
fn a_golden_inference_each_minute_finds_a_state_that_does_not_forget() {
    let (parts, stuck) = Default::default();
    let mut check = check(&parts, &stuck, None);
    let mut run = |frames: u32| {
        let SelfChecks { inferences, failed, .. } = (0..frames).map(|_| check.step()).last().unwrap();
        (inferences, failed)
    };
    assert_eq!(run(GOLDEN_FRAMES), (0, 0));
    assert_eq!(run(1), (1, 0));
    assert_eq!(run(60 * FRAME_RATE_HZ - 1), (1, 0));
    assert_eq!(run(1), (2, 0));
    *stuck.borrow_mut() = true;
    assert_eq!(run(60 * FRAME_RATE_HZ), (3, 8));
}

#[test]
fn every_slip_message_says_what_has_failed() {
    let mut pipeline = Pipeline::new(Model::parse(&MODEL.0).unwrap(), 1).unwrap();
    for (failed, invalid) in [
        (0, 0),
        (1, INVALID_MEMORY),
        (6, INVALID_MEMORY),
        (8, INVALID_NETWORK),
        (9, INVALID_MEMORY | INVALID_NETWORK),
    ] {
        let mut status = Status::new();
        status.self_checks.failed = failed;
        let origin = Origin::new(&status, 0, false, false);
        assert_eq!(origin.message(1, 0).invalid, invalid);
        let message = pipeline.step(&[]).slip_message(FrameStamp::default(), &origin);
        assert_eq!(message.invalid, invalid | INVALID_STARTING | INVALID_NO_SENSOR);
    }
}

#[test]
fn another_model_than_the_expected_one_makes_every_message_invalid() {
    let model = model_bytes();
    let mut hash = Model::parse(&model).unwrap().hash;
    let mut settings = Settings::new();
    let mut invalid = |expected: [u32; 2]| {
        settings.set(Setting::ExpectedModel, &expected.map(i64::from)).unwrap();
        let config = RuntimeConfig::new(&settings, Some(NODE), false);
        let ran = World { before_tick: &|shared, _| shared.set_config(config), ..World::new(9, 1) }.run();
        let bits = |slip: &SlipMessage| slip.invalid & INVALID_OTHER_MODEL != 0;
        (ran.slips.iter().all(bits), ran.slips.iter().any(bits))
    };
    assert_eq!(invalid(model_numbers(&hash)), (false, false));
    hash[7] ^= 1;
    assert_eq!(invalid(model_numbers(&hash)), (true, true));
    assert_eq!(invalid([0; 2]), (false, false), "any model");
    hash[..8].copy_from_slice(&[0x1C, 0xF6, 0x4A, 0x2C, 0, 0, 1, 2]);
    assert_eq!(model_numbers(&hash), [0x1CF6_4A2C, 0x102]);
}

/// If the model is a new one, `SHIPPED_MODEL` and `SHIPPED_GOLDEN` become what this prints.
#[test]
fn the_shipped_model_gives_its_golden_number() {
    let (parts, stuck) = Default::default();
    let failed = |golden| {
        let mut check = check(&parts, &stuck, golden);
        let found = (0..=GOLDEN_FRAMES).map(|_| check.step()).last().unwrap();
        (check.outputs(), found.failed)
    };
    let hash = Model::parse(&MODEL.0).unwrap().hash;
    println!("shipped model: hash {:02x?}, golden inference {:#010x}", &hash[..8], failed(None).0);
    let golden = known_golden(&hash);
    assert_eq!(golden.is_some(), !cfg!(feature = "cmsis-dsp"));
    assert!(golden.is_none_or(|golden| golden == failed(None).0));
    assert_eq!(failed(golden).1, 0);
    assert_eq!(failed(golden.map(|golden| golden ^ 1)).1, if golden.is_some() { 8 } else { 0 });
    assert_eq!(known_golden(&[0; 32]), None, "a model of one's own");
}
