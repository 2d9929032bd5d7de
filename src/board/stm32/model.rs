//! The network and what its pipeline remembers, each where the core reaches it fastest.

use defmt::unwrap;
use slipsense::net::Aligned;
use slipsense::pipeline::State;
use static_cell::ConstStaticCell;

use super::memory::axi_sram_slot;

/// The network, as trained and quantized.
static BUILT_IN: &[u8] =
    include_bytes!(concat!(env!("CARGO_MANIFEST_DIR"), "/model/weights/slipsense.slipnet"));
/// Bytes of the longest model that is run: what DTCM has beside the rest.
const ROOM: usize = 88 * 1024;
const _: () = assert!(BUILT_IN.len() <= ROOM);

/// Where a model lies.
pub type Place = Aligned<[u8; ROOM]>;
/// In DTCM, where the inner loops read it without waiting.
static IN_DTCM: ConstStaticCell<Place> = ConstStaticCell::new(Aligned([0; ROOM]));

axi_sram_slot! {
    /// All that the pipeline remembers.
    STATE: State
}
/// What it remembers at first.
static FIRST_STATE: State = State::new();

/// Room in DTCM for the model that runs. To be called once.
pub fn place() -> &'static mut [u8] {
    &mut IN_DTCM.take().0
}

/// The network of this program, copied to the begin of `place`.
pub fn built_in(place: &'static mut [u8]) -> &'static [u8] {
    // Opaque, so that the model stays data: the optimiser would fold what it can see of it into code.
    for (to, from) in place.iter_mut().zip(core::hint::black_box(BUILT_IN)) {
        *to = *from;
    }
    place.get(..BUILT_IN.len()).unwrap_or(&[])
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
