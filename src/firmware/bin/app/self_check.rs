//! What the firmware's checks of itself see of the board's memories.

use core::ptr::read_volatile;

use slipsense::firmware::{flash, memory, model};
use slipsense::net::Model;
use slipsense::net::format::HASH_BYTES;
use slipsense::pipeline::{Pipeline, SensorCountError, State};
use slipsense::tasks::{CheckedMemory, Part, Reference, SelfCheck, known_golden};
use slipsense::update::PayloadHash;
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
    fn read(&mut self, part: Part, at: u32, out: &mut [u8]) {
        let [loops, _] = memory::inner_loops();
        let bytes = match part {
            Part::Model => self.model,
            Part::Loops => loops,
            Part::Firmware => {
                // It lies in the flash, and what could not be read would differ anyway.
                let _ = flash::read(BOARD.active.start + at, out);
                return;
            }
        };
        for (to, from) in out.iter_mut().zip(bytes.get(at as usize..).unwrap_or_default()) {
            // SAFETY: a reference to a byte. Volatile, because to Rust it cannot have changed.
            *to = unsafe { read_volatile(from) };
        }
    }

    fn clear(&mut self, state: &mut State) {
        model::clear(state);
    }
}

/// `bytes`: the file of `model`.
#[inline(never)]
pub fn build(
    bytes: &'static [u8],
    model: &Model<'static>,
    firmware: Reference,
) -> Result<&'static mut BoardCheck, SensorCountError> {
    let [loops, image] = memory::inner_loops();
    let mut hash = PayloadHash::new();
    hash.update(image);
    let references = [
        // The file ends with the hash of what is before.
        ((bytes.len() - HASH_BYTES) as u32, Some(model.hash)),
        (loops.len() as u32, Some(hash.finish())),
        firmware,
    ];
    let pipeline = Pipeline::with_state(model::golden_state(), *model, 1)?;
    let memory = BoardMemory { model: bytes };
    Ok(CHECK.init(SelfCheck::new(memory, references, pipeline, known_golden(&model.hash))))
}
