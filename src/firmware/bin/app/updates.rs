//! Updates on a board: where they go in its flash, and what it says of them.

use defmt::{Display2Format, info, unwrap};
use embassy_futures::block_on;
use heapless::Deque;
use slipsense::firmware::flash::{FlashPartition, FlashPartitions};
use slipsense::firmware::model::{self, ModelBuffer};
use slipsense::net::Aligned;
use slipsense::node::UpdateTarget;
use slipsense::params::limits::MODEL_BYTES;
use slipsense::tasks::Reference;
use slipsense::update::partitions::{NUCLEO_H743ZI2 as BOARD, TRAILER_BYTES};
use slipsense::update::{
    Evidence, FirmwareSlot, IS_DEVELOPMENT_KEY, ImageVersion, ModelSlot, Notice, PUBLIC_KEYS, Refusal, Run,
    SlotModel, Trial, UpdateSink, UpdateState, find_bootloader, running_header,
};
use static_cell::ConstStaticCell;

use crate::services::Store;

/// At the start three, at the end of the trials of firmware and model one each.
const NOTICES: usize = 5;

/// Where a model that comes over the bus is tried, apart from the one that runs.
#[unsafe(link_section = ".axisram")]
static TRIAL: ConstStaticCell<ModelBuffer> = ConstStaticCell::new(Aligned([0; MODEL_BYTES]));

pub struct Updates {
    pub version: ImageVersion,
    /// Where the pieces of a file go.
    pub sink: UpdateSink<'static, FlashPartition, FlashPartition, FlashPartition>,
    trial: Trial,
    /// Of a model that is newer than the floor.
    model_trial: Trial,
    model: ImageVersion,
    confirms: [bool; 2],
    pub notices: Deque<Notice, NOTICES>,
}

impl Updates {
    /// What the flash says at the start; `from`: which model runs. `floor`: see [`ModelSlot::new`].
    #[inline(never)]
    pub fn find(flash: FlashPartitions, from: SlotModel, floor: ImageVersion) -> Self {
        let running = block_on(running_header(&mut flash.get(BOARD.active), &BOARD, PUBLIC_KEYS));
        let version = running.as_ref().map_or(ImageVersion::SOFTWARE, |header| header.version);
        let mut firmware = block_on(firmware_slot(flash));
        let run = match &mut firmware {
            Ok(slot) => block_on(slot.state.run()),
            Err(why) => Err(*why),
        };
        let firmware = run.and(firmware);
        let (slot, place) = (model_slot(flash, floor), &mut TRIAL.take().0[..]);
        let model = match from {
            SlotModel::Slot(version) => version,
            SlotModel::BuiltIn(_) => floor,
        };
        let mut updates = Self {
            version,
            sink: UpdateSink::new(&BOARD, PUBLIC_KEYS, running, firmware, slot, place),
            trial: Trial::new(run.unwrap_or(Run::Confirmed)),
            model_trial: Trial::new(if model > floor { Run::OnTrial } else { Run::Confirmed }),
            model,
            confirms: [false; 2],
            notices: Deque::new(),
        };
        if IS_DEVELOPMENT_KEY {
            updates.note(Notice::DevelopmentKey);
        }
        updates.note(match run {
            Ok(run) => Notice::Firmware(version, run),
            Err(why) => Notice::FirmwareStays(version, why),
        });
        updates.note(Notice::Model(from));
        updates
    }

    /// The firmware that runs: its bytes in flash and their hash, where it has a signed header; else all of its slot.
    pub fn firmware(&self) -> Reference {
        let slot = BOARD.active.bytes() - TRAILER_BYTES;
        self.sink.running().map_or((slot, None), |header| (header.length.min(slot), Some(header.sha256)))
    }

    /// See [`Trial::observe`]: of the firmware, of the model.
    pub fn ready_to_confirm(&mut self, evidence: Evidence) -> bool {
        self.confirms = [self.trial.observe(evidence), self.model_trial.observe(evidence)];
        self.confirms != [false; 2]
    }

    /// Keep what runs, firmware or model, and take nothing older from now on.
    pub async fn confirm(&mut self, store: &mut Store) {
        let [firmware, model] = core::mem::take(&mut self.confirms);
        // Only a board that swaps has a trial.
        if let Some(state) = self.sink.state().filter(|_| firmware) {
            let confirmed = state.confirm().await.is_ok();
            self.note_trial(UpdateTarget::Firmware, self.version, confirmed);
        }
        if model {
            let confirmed = store.store_model_floor(self.model.into()).await.is_ok();
            self.sink.model().raise_floor(self.model);
            self.note_trial(UpdateTarget::Model, self.model, confirmed);
        }
    }

    fn note_trial(&mut self, target: UpdateTarget, version: ImageVersion, confirmed: bool) {
        self.note(match confirmed {
            true => Notice::Confirmed(target, version),
            false => Notice::NotConfirmed(target, version),
        });
    }

    fn note(&mut self, notice: Notice) {
        info!("{}", Display2Format(&notice));
        unwrap!(self.notices.push_back(notice).ok());
    }
}

/// Where a new firmware goes, if something would swap it in.
async fn firmware_slot(
    flash: FlashPartitions,
) -> Result<FirmwareSlot<FlashPartition, FlashPartition>, Refusal> {
    find_bootloader(&mut flash.get(BOARD.boot), &BOARD).await?;
    Ok(FirmwareSlot { dfu: flash.get(BOARD.dfu), state: UpdateState::new(flash.get(BOARD.state)) })
}

fn model_slot(flash: FlashPartitions, floor: ImageVersion) -> ModelSlot<FlashPartition> {
    ModelSlot::new(flash.get(BOARD.model), &BOARD, PUBLIC_KEYS, floor)
}

/// The file of the model that runs, in RAM, and where it is from: the model slot if it may, else the firmware.
#[inline(never)]
pub fn find_model(flash: FlashPartitions, floor: ImageVersion) -> (&'static [u8], SlotModel) {
    let buffer = model::buffer();
    match block_on(model_slot(flash, floor).load(buffer)) {
        Ok(header) => {
            let whole: &'static [u8] = buffer;
            (whole.get(..header.length as usize).unwrap_or(&[]), SlotModel::Slot(header.version))
        }
        Err(why) => (model::built_in(buffer), SlotModel::BuiltIn(why)),
    }
}
