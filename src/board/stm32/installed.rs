//! Which model runs: that of the model slot if it may, else the one in the firmware.

use defmt::unwrap;
use embassy_futures::block_on;
use slipsense::net::Aligned;
use slipsense::update::{ModelSlot, PUBLIC_KEY, SlotModel};

use super::flash::{Part, Parts};
use super::memory::axi_sram_slot;
use super::model;
use crate::board::PARTITIONS;

axi_sram_slot! {
    /// Where a model that comes over the bus is tried.
    TRIAL: model::Place
}

/// The model's slot in flash.
pub fn slot(flash: Parts) -> ModelSlot<Part> {
    ModelSlot::new(flash.part(PARTITIONS.model), PARTITIONS, PUBLIC_KEY)
}

/// The file of the model that runs, in DTCM, and where it is from.
#[inline(never)]
pub fn find(flash: Parts) -> (&'static [u8], SlotModel) {
    let place = model::place();
    match block_on(slot(flash).load(place)) {
        Ok(header) => {
            let whole: &'static [u8] = place;
            (whole.get(..header.length as usize).unwrap_or(&[]), SlotModel::Slot(header.version))
        }
        Err(why) => (model::built_in(place), SlotModel::BuiltIn(why)),
    }
}

/// Room to try another one, apart from the one that runs.
pub fn trial_place() -> &'static mut [u8] {
    let place = unwrap!(TRIAL.take());
    // SAFETY: zeros are bytes. Written as a value they would be made on the stack first.
    let Aligned(place) = unsafe {
        place.as_mut_ptr().write_bytes(0, 1);
        place.assume_init_mut()
    };
    place
}
