//! The node's checks of itself while it runs, a bounded piece after each frame that leaves time: code and model are
//! hashed, [`SLICE_BYTES`] at a time, and once a minute the network decides a made-up input, one frame of it beside one
//! of the sensors'. A check that has failed once makes every slip message invalid until the next start.

use core::borrow::BorrowMut;

use crate::health::SelfChecks;
use crate::params::{FRAME_RATE_HZ, XL_AXES, XL_RATE_HZ};
use crate::pipeline::{Output, Pipeline, State};
use crate::sensor::{PiezoFrame, SensorInput};
use crate::update::PayloadHash;

/// Bytes that are hashed after a frame: four blocks of SHA-256.
pub const SLICE_BYTES: u32 = 256;
/// Frames of a golden inference: two windows of the accelerometer.
pub const GOLDEN_FRAMES: u32 = 8;
/// Frames from one golden inference to the next.
pub const GOLDEN_PERIOD_FRAMES: u32 = 60 * FRAME_RATE_HZ;
/// First bytes of the shipped model's hash, and what it gives, computed on a computer: so a fault that was there at the
/// start is found too. Another model's number is what its first golden inference gives.
const SHIPPED_MODEL: [u8; 8] = [0x9D, 0x78, 0xBA, 0xCE, 0xBF, 0xAD, 0x97, 0x3D];
const SHIPPED_GOLDEN: u32 = 0x55E4_71DF;

/// What the golden inference of a model with this hash gives, where that is known.
pub fn known_golden(model_hash: &[u8]) -> Option<u32> {
    // CMSIS-DSP's FFT rounds in another way.
    (model_hash.starts_with(&SHIPPED_MODEL) && !cfg!(feature = "cmsis-dsp")).then_some(SHIPPED_GOLDEN)
}
/// Accelerometer samples of a frame.
const SAMPLES: usize = XL_RATE_HZ.div_ceil(FRAME_RATE_HZ) as usize;
const PARTS: usize = 3;
const SEED: u32 = 0x51D5_EE4B;
/// Bit of the golden inference in [`SelfChecks::failed`].
const GOLDEN: u8 = 1 << PARTS;

/// What is hashed, in the order of [`SELF_CHECKS`](crate::health::SELF_CHECKS).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// The model that runs.
    Model = 0,
    /// Code that was copied to RAM.
    Loops = 1,
    /// The firmware.
    Firmware = 2,
}

const ORDER: [Part; PARTS] = [Part::Model, Part::Loops, Part::Firmware];

/// How long a part is, and its SHA-256; `None`: what the first pass finds.
pub type Reference = (u32, Option<[u8; 32]>);

/// The memory that is checked.
pub trait CheckedMemory {
    /// Bytes of a part from `at` on.
    fn read(&mut self, part: Part, at: u32, out: &mut [u8]);

    /// Make this state what it is before the first frame, in place.
    fn clear(&mut self, state: &mut State);
}

/// The checks and what they have found, as the module describes.
pub struct SelfCheck<'m, B, S = State> {
    memory: B,
    references: [Reference; PARTS],
    part: usize,
    /// Bytes of the part that are hashed.
    at: u32,
    hash: PayloadHash,
    /// Apart from the one that decides.
    pipeline: Pipeline<'m, S>,
    pad: PiezoFrame,
    frame: u32,
    random: u32,
    digest: u32,
    golden: Option<u32>,
    found: SelfChecks,
}

impl<'m, B: CheckedMemory, S: BorrowMut<State>> SelfCheck<'m, B, S> {
    /// Before the first frame. `references` by [`Part`]. `pipeline`: with the model that runs and a state of its own.
    /// `golden`: what its golden inference gives; `None`: what the first one does.
    pub fn new(
        memory: B,
        references: [Reference; PARTS],
        pipeline: Pipeline<'m, S>,
        golden: Option<u32>,
    ) -> Self {
        Self {
            memory,
            references,
            part: 0,
            at: 0,
            hash: PayloadHash::new(),
            pipeline,
            pad: PiezoFrame::zeroed(),
            frame: 0,
            random: SEED,
            digest: 0,
            golden,
            found: SelfChecks::default(),
        }
    }

    /// The next piece; what has been found so far.
    pub fn step(&mut self) -> SelfChecks {
        self.hash_slice();
        match self.frame {
            0 => {
                self.memory.clear(self.pipeline.state_mut());
                (self.random, self.digest) = (SEED, 0);
            }
            1..=GOLDEN_FRAMES => self.infer(),
            _ => {}
        }
        self.frame = if self.frame + 1 < GOLDEN_PERIOD_FRAMES { self.frame + 1 } else { 0 };
        self.found
    }

    /// Of the outputs of the golden inference so far.
    pub const fn digest(&self) -> u32 {
        self.digest
    }

    fn hash_slice(&mut self) {
        let Some((&part, (bytes, expected))) = ORDER.get(self.part).zip(self.references.get_mut(self.part))
        else {
            self.part = 0;
            self.found.passes = self.found.passes.wrapping_add(1);
            return;
        };
        let mut slice = [0; SLICE_BYTES as usize];
        let length = SLICE_BYTES.min(*bytes - self.at);
        let slice = slice.get_mut(..length as usize).unwrap_or_default();
        self.memory.read(part, self.at, slice);
        self.hash.update(slice);
        self.at += length;
        if self.at == *bytes {
            let hash = self.hash.finish();
            if *expected.get_or_insert(hash) != hash {
                self.found.failed |= 1 << self.part;
            }
            (self.part, self.at) = (self.part + 1, 0);
        }
    }

    /// One frame of the golden inference; the last is compared.
    fn infer(&mut self) {
        let random = &mut self.random;
        // 10 bits of a pad, 12 of an accelerometer.
        self.pad.rescan(|counts| counts.fill_with(|| (next(random) >> 22) as u16));
        let mut xl = [[0; XL_AXES]; SAMPLES];
        xl.as_flattened_mut().fill_with(|| (next(random) as i32 >> 20) as i16);
        let input =
            SensorInput { piezo: Some(&self.pad), xl: Some(&xl), xl_end: self.frame * SAMPLES as u32 };
        let Output { logits, log_odds, log_mel: [log_mel, ..], .. } = self.pipeline.step(&[input]);
        let outputs = logits.iter().chain(&log_odds).map(|logit| logit.to_bits());
        // A difference in one number makes one in the digest: each step is a bijection.
        self.digest = outputs.chain(log_mel.ln_power).fold(self.digest, |digest, number| {
            (digest.rotate_left(5) ^ number as u32).wrapping_mul(0x9E37_79B1)
        });
        if self.frame == GOLDEN_FRAMES {
            self.found.inferences = self.found.inferences.wrapping_add(1);
            if *self.golden.get_or_insert(self.digest) != self.digest {
                self.found.failed |= GOLDEN;
            }
        }
    }
}

/// Numerical Recipes' linear congruential generator: the upper bits are used.
fn next(random: &mut u32) -> u32 {
    *random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
    *random
}
