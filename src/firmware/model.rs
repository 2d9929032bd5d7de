//! The network and what its pipeline remembers, both in AXI SRAM behind the data cache: DTCM has no room for either
//! beside the rest.

use static_cell::{ConstStaticCell, StaticCell};

use crate::net::Aligned;
use crate::params::limits::MODEL_BYTES;
use crate::pipeline::State;

/// The network, as trained and quantized.
static BUILT_IN: &[u8] =
    include_bytes!(concat!(env!("CARGO_MANIFEST_DIR"), "/model/weights/slipsense.slipnet"));
const _: () = assert!(BUILT_IN.len() <= MODEL_BYTES);

/// Room for a model.
pub type ModelBuffer = Aligned<[u8; MODEL_BYTES]>;
/// The model that runs.
#[unsafe(link_section = ".axisram")]
static RUNNING: ConstStaticCell<ModelBuffer> = ConstStaticCell::new(Aligned([0; MODEL_BYTES]));

/// All that the pipeline remembers, and the golden inference's own.
#[unsafe(link_section = ".axisram")]
static STATE: StaticCell<State> = StaticCell::new();
#[unsafe(link_section = ".sram2")]
static GOLDEN_STATE: StaticCell<State> = StaticCell::new();
/// What it remembers at first.
static FIRST_STATE: State = State::new();

/// Room for the model that runs. To be called once.
pub fn buffer() -> &'static mut [u8] {
    &mut RUNNING.take().0
}

/// The network of this program, copied to the start of `buffer`.
pub fn built_in(buffer: &'static mut [u8]) -> &'static [u8] {
    // Opaque, so that the model stays data: the optimiser would fold what it can see of it into code.
    for (to, from) in buffer.iter_mut().zip(core::hint::black_box(BUILT_IN)) {
        *to = *from;
    }
    buffer.get(..BUILT_IN.len()).unwrap_or(&[])
}

/// A state as it is before the first frame, made where it stays. To be called once.
pub fn first_state() -> &'static mut State {
    make(&STATE)
}

/// Another, for the golden inference. To be called once.
pub fn golden_state() -> &'static mut State {
    make(&GOLDEN_STATE)
}

fn make(cell: &'static StaticCell<State>) -> &'static mut State {
    let state = cell.uninit();
    // SAFETY: a state is plain numbers, so a copy of the bytes of one is another. Written as a value it would, with
    // some compilers, be made on the stack first.
    unsafe {
        state.as_mut_ptr().copy_from_nonoverlapping(&raw const FIRST_STATE, 1);
        state.assume_init_mut()
    }
}

/// Make a state what it is before the first frame.
pub fn clear(state: &mut State) {
    // SAFETY: as in `make`.
    unsafe { core::ptr::from_mut(state).copy_from_nonoverlapping(&raw const FIRST_STATE, 1) }
}
