//! The network and what its pipeline remembers, each where the core reaches it fastest.

use defmt::unwrap;
use slipsense::net::{Aligned, Model, ModelError};
use slipsense::pipeline::State;
use static_cell::ConstStaticCell;

use super::memory::axi_sram_slot;

/// The network, as trained and quantized.
static MODEL: &[u8] = include_bytes!(concat!(env!("CARGO_MANIFEST_DIR"), "/model/weights/slipsense.slipnet"));
/// The same in DTCM, where the inner loops read it without waiting.
static MODEL_IN_DTCM: ConstStaticCell<Aligned<[u8; MODEL.len()]>> =
    ConstStaticCell::new(Aligned([0; MODEL.len()]));

axi_sram_slot! {
    /// All that the pipeline remembers.
    STATE: State
}
/// What it remembers at first.
static FIRST_STATE: State = State::new();

/// The model, in DTCM. To be called once.
#[inline(never)]
pub fn read() -> Result<Model<'static>, ModelError> {
    let Aligned(model) = MODEL_IN_DTCM.take();
    // Opaque, so that the model stays data: the optimiser would fold what it can see of it into code.
    model.copy_from_slice(core::hint::black_box(MODEL));
    let model: &'static [u8] = model;
    Model::parse(model)
}

/// A state as it is before the first frame, made where it stays. To be called once.
pub fn first_state() -> &'static mut State {
    let state = unwrap!(STATE.take());
    // SAFETY: a state is plain numbers, so a copy of the bytes of one is another. Written as a value it would, with
    // some compilers, be made on the stack first.
    unsafe {
        state.as_mut_ptr().copy_from_nonoverlapping(&raw const FIRST_STATE, 1);
        state.assume_init_mut()
    }
}
