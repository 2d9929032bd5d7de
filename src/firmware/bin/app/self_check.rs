//! What the firmware's checks of itself see of the board's memories.

use core::ptr::read_volatile;

use slipsense::firmware::{flash, memory, model};
use slipsense::net::Model;
use slipsense::pipeline::{Pipeline, SensorCountError, State};
use slipsense::tasks::{CheckedMemory, RamPart, Reference, SelfCheck, digest, known_golden};
use slipsense::update::partitions::NUCLEO_H743ZI2 as BOARD;
use static_cell::StaticCell;

pub type BoardCheck = SelfCheck<'static, BoardMemory, &'static mut State>;
#[unsafe(link_section = ".axisram")]
static CHECK: StaticCell<BoardCheck> = StaticCell::new();

pub struct BoardMemory {
    /// The file of the model that runs.
    model: &'static [u8],
}

impl CheckedMemory for BoardMemory {
    fn read(&mut self, at: u32, out: &mut [u8]) {
        // What could not be read would differ anyway.
        let _ = flash::read(BOARD.active.start + at, out);
    }

    fn digest(&mut self, part: RamPart, at: u32, bytes: u32, before: u32) -> u32 {
        let part = match part {
            RamPart::Model => self.model,
            RamPart::Loops => memory::inner_loops()[0],
        };
        digest_of(part.get(at as usize..(at + bytes) as usize).unwrap_or_default(), before)
    }

    fn clear(&mut self, state: &mut State) {
        model::clear(state);
    }
}

/// Of the whole words. A model's file ends with its hash, which nothing reads any more.
#[inline(never)]
fn digest_of(bytes: &[u8], before: u32) -> u32 {
    // SAFETY: any bits are a word.
    let (_, words, _) = unsafe { bytes.align_to::<u32>() };
    // SAFETY: references. Volatile, because to Rust the words cannot have changed.
    words.iter().fold(before, |before, word| digest(before, unsafe { read_volatile(word) }))
}

/// `bytes`: the file of `model`.
#[inline(never)]
pub fn build(
    bytes: &'static [u8],
    model: &Model<'static>,
    firmware: Reference,
) -> Result<&'static mut BoardCheck, SensorCountError> {
    let [_, image] = memory::inner_loops();
    let ram = [bytes, image].map(|bytes| (bytes.len() as u32, digest_of(bytes, 0)));
    let pipeline = Pipeline::with_state(model::golden_state(), *model, 1)?;
    let memory = BoardMemory { model: bytes };
    Ok(CHECK.init(SelfCheck::new(memory, ram, firmware, pipeline, known_golden(&model.hash))))
}
