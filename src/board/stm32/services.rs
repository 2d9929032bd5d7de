//! The services task's board: settings in flash, the red light, and what only the drivers know.

use defmt::{Display2Format, unwrap, warn};
use embassy_futures::block_on;
use embassy_stm32::gpio::{Level, Output};
use embassy_stm32::{Peri, peripherals, uid};
use slipsense::board::panic_record::PanicRecord;
use slipsense::board::{Condition, StatusLed};
use slipsense::drivers::array::Mounting;
use slipsense::net::format::HASH_BYTES;
use slipsense::node::{self, COMMIT, FileSink, Identity, Node, UpdateTarget, Version};
use slipsense::settings::{LoadReport, Settings, SettingsStore, StoreError};
use slipsense::tasks::{ServiceBoard, Services};

use super::can::Inbox;
use super::flash::{BoardFlash, settings_range};
use super::memory::axi_sram_slot;
use super::{Mutex, SHARED, Uptime, sensors};
use crate::board::HARDWARE;

/// The task and all that it remembers.
pub type BoardServices = Services<'static, Mutex, Inbox, Uptime, Station>;
/// Where settings are kept.
pub type Store = SettingsStore<BoardFlash>;

axi_sram_slot! {
    /// The node, its queues and the transfers that it puts together.
    SERVICES: BoardServices
}

/// What the services do to the board.
pub struct Station {
    store: Store,
    led: Output<'static>,
}

/// The settings of the last store, or the defaults.
#[inline(never)]
pub fn load(flash: Peri<'static, peripherals::FLASH>) -> (Store, Settings, LoadReport) {
    // The memory map gives it two sectors.
    let mut store = unwrap!(SettingsStore::new(BoardFlash::new(flash), settings_range()).ok());
    let (settings, report) = block_on(store.load());
    (store, settings, report)
}

/// The task, in AXI SRAM.
#[inline(never)]
pub fn build(
    store: Store,
    settings: Settings,
    loaded: LoadReport,
    model_hash: Option<[u8; HASH_BYTES]>,
    inbox: Inbox,
    led: Output<'static>,
    panic: Option<PanicRecord>,
) -> &'static mut BoardServices {
    let mut unique_id = [0; 16];
    unique_id.iter_mut().zip(uid::uid()).for_each(|(to, from)| *to = from);
    let identity = Identity {
        hardware_version: HARDWARE,
        software_version: Version::SOFTWARE,
        vcs_revision: COMMIT,
        unique_id,
        model_hash,
        settings: loaded,
    };
    let node = Node::new(identity, settings);
    let station = Station { store, led };
    unwrap!(SERVICES.take()).write(Services::new(node, inbox, Uptime, &SHARED, station, panic))
}

impl StatusLed for Station {
    fn show(&mut self, condition: Condition) {
        self.led.set_level(Level::from(condition == Condition::Warning));
    }
}

impl FileSink for Station {
    async fn write(&mut self, _: UpdateTarget, _: u32, _: &[u8]) -> Result<(), &'static str> {
        Err(NO_UPDATES)
    }

    async fn finish(&mut self, _: UpdateTarget, _: u32) -> Result<(), &'static str> {
        Err(NO_UPDATES)
    }
}

const NO_UPDATES: &str = "this firmware takes no updates over the bus";

impl ServiceBoard for Station {
    async fn store(&mut self, settings: &Settings) -> Result<(), &'static str> {
        let stored = self.store.store(settings).await;
        if let Err(error) = &stored {
            warn!("settings not stored: {}", Display2Format(error));
        }
        stored.map_err(StoreError::text)
    }

    async fn begin_update(&mut self, _: UpdateTarget) -> Result<u32, &'static str> {
        Err(NO_UPDATES)
    }

    fn apply(&mut self, settings: &Settings) {
        sensors::mount(settings.orientation().map(|(rows_flipped, cols_flipped)| Mounting {
            transposed: false,
            rows_flipped,
            cols_flipped,
        }));
    }

    fn observe(&mut self, status: &mut node::Status) {
        if let Some(report) = sensors::report() {
            status.stuck_taxels = report.stuck_taxels.map(|mask| mask.0);
        }
    }

    fn identify(&mut self, lit: bool) {
        self.led.set_level(Level::from(lit));
    }
}
