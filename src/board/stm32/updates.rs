//! Updates on a board: where they go in its flash, and what it says of them.

use defmt::{Display2Format, info, unwrap};
use embassy_futures::block_on;
use heapless::Deque;
use slipsense::node::UpdateTarget;
use slipsense::update::{
    FirmwareSlot, IS_DEVELOPMENT_KEY, ImageVersion, Notice, PUBLIC_KEY, Refusal, Run, SlotModel, Trial,
    UpdateSink, UpdateState, find_bootloader, running_version,
};

use super::flash::{Part, Parts};
use super::installed;
use crate::board::PARTITIONS;

/// At the start three, at the end of a trial one.
const NOTICES: usize = 4;

/// What the services know of updates.
pub struct Updates {
    /// The version of the firmware that runs.
    pub version: ImageVersion,
    /// Where the pieces of a file go.
    pub sink: UpdateSink<'static, Part, Part, Part>,
    trial: Trial,
    notices: Deque<Notice, NOTICES>,
}

impl Updates {
    /// What the flash says at the start; `from`: which model runs.
    #[inline(never)]
    pub fn find(flash: Parts, from: SlotModel) -> Self {
        let version = block_on(running_version(&mut flash.part(PARTITIONS.active), PARTITIONS, &PUBLIC_KEY));
        let mut firmware = block_on(firmware_slot(flash));
        let run = match &mut firmware {
            Ok(slot) => block_on(slot.state.run()).map_err(|_| Refusal::Flash),
            Err(why) => Err(*why),
        };
        let firmware = run.and(firmware);
        let (model, place) = (installed::slot(flash), installed::trial_place());
        let mut updates = Self {
            version,
            sink: UpdateSink::new(PARTITIONS, PUBLIC_KEY, version, firmware, model, place),
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
    pub fn has_shown(&mut self, frames: u32, heartbeats: u32) -> bool {
        self.trial.observe(frames, heartbeats)
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
    pub fn take_notice(&mut self) -> Option<Notice> {
        self.notices.pop_front()
    }

    fn note(&mut self, notice: Notice) {
        info!("{}", Display2Format(&notice));
        unwrap!(self.notices.push_back(notice).ok());
    }
}

/// Where a new firmware goes, if something would swap it in.
async fn firmware_slot(flash: Parts) -> Result<FirmwareSlot<Part, Part>, Refusal> {
    find_bootloader(&mut flash.part(PARTITIONS.boot), PARTITIONS).await?;
    Ok(FirmwareSlot {
        dfu: flash.part(PARTITIONS.dfu),
        state: UpdateState::new(flash.part(PARTITIONS.state)),
    })
}
