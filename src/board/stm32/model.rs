//! Which model runs: that of the model slot if it may, else the one in the firmware; in DTCM either way.

use defmt::{Display2Format, error};
use embassy_futures::block_on;
use slipsense::net::{Aligned, Model};
use slipsense::update::{ModelSlot, PUBLIC_KEY, SlotModel};
use static_cell::ConstStaticCell;

use super::flash::Parts;
use super::memory::axi_sram_slot;
use crate::board::PARTITIONS;

/// The network, as trained and quantized.
static BUILT_IN: &[u8] =
    include_bytes!(concat!(env!("CARGO_MANIFEST_DIR"), "/model/weights/slipsense.slipnet"));
/// Bytes of the longest model that this firmware runs: what DTCM has beside the rest.
const ROOM: usize = 88 * 1024;
const _: () = assert!(BUILT_IN.len() <= ROOM);

type Place = Aligned<[u8; ROOM]>;

/// The model in DTCM, where the inner loops read it without waiting.
static IN_DTCM: ConstStaticCell<Place> = ConstStaticCell::new(Aligned([0; ROOM]));
axi_sram_slot! {
    /// Where one that comes over the bus is tried.
    TRIAL: Place
}

/// The model's slot in flash.
pub fn slot(flash: Parts) -> ModelSlot<super::flash::Part> {
    ModelSlot::new(flash.part(PARTITIONS.model), PARTITIONS, PUBLIC_KEY)
}

/// The model that runs, `None`: it is not readable, which has been reported; and where it is from.
#[inline(never)]
pub fn read(flash: Parts) -> (Option<Model<'static>>, SlotModel) {
    let Aligned(place) = IN_DTCM.take();
    let (length, from) = match block_on(slot(flash).load(place)) {
        Ok(header) => (header.length as usize, SlotModel::Slot(header.version)),
        Err(why) => {
            // Opaque, so that the model stays data: the optimiser would fold what it can see of it into code.
            for (to, from) in place.iter_mut().zip(core::hint::black_box(BUILT_IN)) {
                *to = *from;
            }
            (BUILT_IN.len(), SlotModel::BuiltIn(why))
        }
    };
    let model: &'static [u8] = place;
    let parsed = Model::parse(model.get(..length).unwrap_or(&[]));
    if let Err(error) = &parsed {
        error!("model of {=usize} bytes: {}", length, Display2Format(error));
    }
    (parsed.ok(), from)
}

/// Room to try another one, apart from the one that runs.
pub fn trial_place() -> &'static mut [u8] {
    let place = defmt::unwrap!(TRIAL.take());
    // SAFETY: zeros are bytes. Written as a value they would be made on the stack first.
    let Aligned(place) = unsafe {
        place.as_mut_ptr().write_bytes(0, 1);
        place.assume_init_mut()
    };
    place
}
