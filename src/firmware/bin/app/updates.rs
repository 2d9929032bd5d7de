//! Updates on a board: where they go in its flash, and what it says of them.

use defmt::{Display2Format, info, unwrap};
use embassy_futures::block_on;
use heapless::Deque;
use slipsense::firmware::flash::{FlashPartition, FlashPartitions};
use slipsense::firmware::model::{self, MODEL_BYTES_MAX, ModelBuffer};
use slipsense::net::Aligned;
use slipsense::node::UpdateTarget;
use slipsense::update::partitions::NUCLEO_H743ZI2 as BOARD;
use slipsense::update::{
    Evidence, FirmwareSlot, IS_DEVELOPMENT_KEY, ImageVersion, ModelSlot, Notice, PUBLIC_KEYS, Refusal, Run,
    SlotModel, Trial, UpdateSink, UpdateState, find_bootloader, running_header,
};
use static_cell::ConstStaticCell;

/// At the start three, at the end of a trial one.
const NOTICES: usize = 4;

/// Where a model that comes over the bus is tried, apart from the one that runs.
#[unsafe(link_section = ".axisram")]
static TRIAL: ConstStaticCell<ModelBuffer> = ConstStaticCell::new(Aligned([0; MODEL_BYTES_MAX]));

pub struct Updates {
    pub version: ImageVersion,
    /// Where the pieces of a file go.
    pub sink: UpdateSink<'static, FlashPartition, FlashPartition, FlashPartition>,
    trial: Trial,
    notices: Deque<Notice, NOTICES>,
}

impl Updates {
    /// What the flash says at the start; `from`: which model runs.
    #[inline(never)]
    pub fn find(flash: FlashPartitions, from: SlotModel) -> Self {
        let running = block_on(running_header(&mut flash.get(BOARD.active), &BOARD, PUBLIC_KEYS));
        let version = running.as_ref().map_or(ImageVersion::SOFTWARE, |header| header.version);
        let mut firmware = block_on(firmware_slot(flash));
        let run = match &mut firmware {
            Ok(slot) => block_on(slot.state.run()).map_err(|_| Refusal::Flash),
            Err(why) => Err(*why),
        };
        let firmware = run.and(firmware);
        let (model, trial) = (model_slot(flash), &mut TRIAL.take().0[..]);
        let mut updates = Self {
            version,
            sink: UpdateSink::new(&BOARD, PUBLIC_KEYS, running, firmware, model, trial),
            trial: Trial::new(run.unwrap_or(Run::Confirmed)),
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

    /// Bytes of the longest file that is taken now, or why none is.
    pub async fn begin(&mut self, target: UpdateTarget) -> Result<u32, &'static str> {
        self.sink.begin(target).await.map_err(Refusal::reason)
    }

    /// See [`Trial::observe`].
    pub fn ready_to_confirm(&mut self, evidence: Evidence) -> bool {
        self.trial.observe(evidence)
    }

    /// Keep the firmware that runs.
    pub async fn confirm(&mut self) {
        // Only a board that swaps has a trial.
        let Some(state) = self.sink.state() else { return };
        let confirmed = state.confirm().await;
        let version = self.version;
        self.note(match confirmed {
            Ok(()) => Notice::Confirmed(version),
            Err(_) => Notice::NotConfirmed(version),
        });
    }

    /// The next line for the bus.
    pub fn next_notice(&mut self) -> Option<Notice> {
        self.notices.pop_front()
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

fn model_slot(flash: FlashPartitions) -> ModelSlot<FlashPartition> {
    ModelSlot::new(flash.get(BOARD.model), &BOARD, PUBLIC_KEYS)
}

/// The file of the model that runs, in RAM, and where it is from: the model slot if it may, else the firmware.
#[inline(never)]
pub fn find_model(flash: FlashPartitions) -> (&'static [u8], SlotModel) {
    let buffer = model::buffer();
    match block_on(model_slot(flash).load(buffer)) {
        Ok(header) => {
            let whole: &'static [u8] = buffer;
            (whole.get(..header.length as usize).unwrap_or(&[]), SlotModel::Slot(header.version))
        }
        Err(why) => (model::built_in(buffer), SlotModel::BuiltIn(why)),
    }
}
