//! The node's checks of itself while it runs, a bounded piece after each frame that leaves time. What runs in RAM, model
//! and inner loops, is compared with a digest: where every frame leaves time, no bit that flips makes flags wrong for
//! longer than 150 ms. The firmware in flash is hashed. Once a minute the network decides a made-up input, one frame of
//! it beside one of the sensors'. A check that has failed once makes every slip message invalid until the next start.

use core::borrow::BorrowMut;

use crate::health::SelfChecks;
use crate::params::{FRAME_RATE_HZ, XL_AXES, XL_RATE_HZ};
use crate::pipeline::{Output, Pipeline, State};
use crate::sensor::{PiezoFrame, SensorInput};
use crate::update::PayloadHash;

/// Bytes that are hashed after a frame: four blocks of SHA-256.
pub const SLICE_BYTES: u32 = 256;
/// Bytes of RAM that are looked at after a frame: the longest model and 32 KB of code take 10 frames. What flips just
/// behind is found the next time, after 20 frames, 83 ms.
pub const RAM_SLICE_BYTES: u32 = 16_384;
/// Frames of a golden inference: two windows of the accelerometer.
pub const GOLDEN_FRAMES: u32 = 8;
/// Frames from one golden inference to the next.
pub const GOLDEN_PERIOD_FRAMES: u32 = 60 * FRAME_RATE_HZ;
/// First bytes of the shipped model's hash, and what it gives, computed on a computer: so a fault that was there at the
/// start is found too. Another model's number is what its first golden inference gives.
const SHIPPED_MODEL: [u8; 8] = [0xDF, 0xAD, 0x93, 0x81, 0xF2, 0xC5, 0xC3, 0xEA];
const SHIPPED_GOLDEN: u32 = 0x7F35_4E95;

/// What the golden inference of a model with this hash gives, where that is known.
pub fn known_golden(model_hash: &[u8]) -> Option<u32> {
    // CMSIS-DSP's FFT rounds in another way.
    (model_hash.starts_with(&SHIPPED_MODEL) && !cfg!(feature = "cmsis-dsp")).then_some(SHIPPED_GOLDEN)
}
/// Accelerometer samples of a frame.
const SAMPLES: usize = XL_RATE_HZ.div_ceil(FRAME_RATE_HZ) as usize;
const SEED: u32 = 0x51D5_EE4B;
/// Bit of the golden inference in [`SelfChecks::failed`].
const GOLDEN: u8 = 1 << 3;
/// Bit of the firmware in flash.
const FIRMWARE: u8 = 1 << 2;

/// What runs in RAM, by its bit of [`SelfChecks::failed`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RamPart {
    /// The model that runs.
    Model = 0,
    /// Code that was copied there.
    Loops = 1,
}

/// Bytes of the firmware, and its SHA-256; `None`: what the first pass finds.
pub type Reference = (u32, Option<[u8; 32]>);

/// One step of a digest. A bijection of both, so that one different number makes another digest for certain.
#[inline]
pub const fn digest(before: u32, number: u32) -> u32 {
    (before.rotate_left(5) ^ number).wrapping_mul(0x9E37_79B1)
}

/// The memory that is checked.
pub trait CheckedMemory {
    /// Bytes of the firmware from `at` on.
    fn read(&mut self, at: u32, out: &mut [u8]);

    /// [`digest`] on from `before` over the whole words of a part of the RAM, `bytes` from `at` on.
    fn digest(&mut self, part: RamPart, at: u32, bytes: u32, before: u32) -> u32;

    /// Make this state what it is before the first frame, in place.
    fn clear(&mut self, state: &mut State);
}

/// The checks and what they have found, as the module describes.
pub struct SelfCheck<'m, B, S = State> {
    memory: B,
    /// By [`RamPart`]: bytes and their digest.
    ram: [(u32, u32); 2],
    ram_part: RamPart,
    /// Bytes of the part that are looked at, and their digest.
    ram_at: u32,
    ram_digest: u32,
    firmware: Reference,
    /// Bytes that are hashed.
    at: u32,
    hash: PayloadHash,
    /// Apart from the one that decides.
    pipeline: Pipeline<'m, S>,
    pad: PiezoFrame,
    frame: u32,
    random: u32,
    outputs: u32,
    golden: Option<u32>,
    found: SelfChecks,
}

impl<'m, B: CheckedMemory, S: BorrowMut<State>> SelfCheck<'m, B, S> {
    /// Before the first frame. `ram`: bytes and digest by [`RamPart`]. `pipeline`: with the model that runs and a state
    /// of its own. `golden`: what its golden inference gives; `None`: what the first one does.
    pub fn new(
        memory: B,
        ram: [(u32, u32); 2],
        firmware: Reference,
        pipeline: Pipeline<'m, S>,
        golden: Option<u32>,
    ) -> Self {
        Self {
            memory,
            ram,
            ram_part: RamPart::Model,
            ram_at: 0,
            ram_digest: 0,
            firmware,
            at: 0,
            hash: PayloadHash::new(),
            pipeline,
            pad: PiezoFrame::zeroed(),
            frame: 0,
            random: SEED,
            outputs: 0,
            golden,
            found: SelfChecks::default(),
        }
    }

    /// The next piece; what has been found so far.
    pub fn step(&mut self) -> SelfChecks {
        self.compare_slice();
        self.hash_slice();
        match self.frame {
            0 => {
                self.memory.clear(self.pipeline.state_mut());
                (self.random, self.outputs) = (SEED, 0);
            }
            1..=GOLDEN_FRAMES => self.infer(),
            _ => {}
        }
        self.frame = if self.frame + 1 < GOLDEN_PERIOD_FRAMES { self.frame + 1 } else { 0 };
        self.found
    }

    /// [`digest`] of the outputs of the golden inference so far.
    pub const fn outputs(&self) -> u32 {
        self.outputs
    }

    fn compare_slice(&mut self) {
        let (part, [model, loops]) = (self.ram_part, self.ram);
        let ((bytes, expected), next) = match part {
            RamPart::Model => (model, RamPart::Loops),
            RamPart::Loops => (loops, RamPart::Model),
        };
        let length = RAM_SLICE_BYTES.min(bytes - self.ram_at);
        self.ram_digest = self.memory.digest(part, self.ram_at, length, self.ram_digest);
        self.ram_at += length;
        if self.ram_at == bytes {
            if self.ram_digest != expected {
                self.found.failed |= 1 << part as u8;
            }
            (self.ram_part, self.ram_at, self.ram_digest) = (next, 0, 0);
        }
    }

    fn hash_slice(&mut self) {
        let (bytes, expected) = &mut self.firmware;
        let mut slice = [0; SLICE_BYTES as usize];
        let length = SLICE_BYTES.min(*bytes - self.at);
        let slice = slice.get_mut(..length as usize).unwrap_or_default();
        self.memory.read(self.at, slice);
        self.hash.update(slice);
        self.at += length;
        if self.at == *bytes {
            let hash = self.hash.finish();
            if *expected.get_or_insert(hash) != hash {
                self.found.failed |= FIRMWARE;
            }
            self.at = 0;
            self.found.passes = self.found.passes.wrapping_add(1);
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
        let numbers = outputs.chain(log_mel.ln_power);
        self.outputs = numbers.fold(self.outputs, |before, number| digest(before, number as u32));
        if self.frame == GOLDEN_FRAMES {
            self.found.inferences = self.found.inferences.wrapping_add(1);
            if *self.golden.get_or_insert(self.outputs) != self.outputs {
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
