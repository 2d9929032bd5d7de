//! The services task's board: settings in flash, updates, the red light, and what only the drivers know.

use defmt::{Display2Format, unwrap, warn};
use embassy_futures::block_on;
use embassy_stm32::gpio::{Level, Output};
use embassy_stm32::{pac, uid};
use slipsense::board::StatusLed;
use slipsense::board::crash_record::Start;
use slipsense::calibration::{Request, Summary};
use slipsense::drivers::Failure;
use slipsense::drivers::array::Mounting;
use slipsense::firmware::flash::{FlashPartition, FlashPartitions, count_ecc_errors};
use slipsense::firmware::ram_errors;
use slipsense::firmware::shared::{Mutex, SHARED, Uptime};
use slipsense::health::{Condition, Status};
use slipsense::net::format::HASH_BYTES;
use slipsense::node::{
    CHALLENGE_BYTES, COMMIT, FileSink, Identity, Node, SIGNATURE_BYTES, UpdateTarget, Version,
};
use slipsense::settings::{LoadReport, SCRATCH, Scratch, Settings, SettingsStore, StoreError};
use slipsense::tasks::{ServiceBoard, Services};
use slipsense::update::partitions::NUCLEO_H743ZI2;
use slipsense::update::{Evidence, ImageVersion, Notice, PUBLIC_KEYS, Refusal, unlocks};
use static_cell::{ConstStaticCell, StaticCell};

use crate::can::{self, Inbox};
use crate::frame_source::{BoardCommissioning, LINK};
use crate::updates::Updates;

/// What GetInfo reports; the major number is the board's.
const HARDWARE: Version = Version { major: 1, minor: 0 };
/// Reads of the random number generator's state until a number must be there: microseconds.
const RNG_SPINS: u32 = 10_000;

/// The task and all that it remembers.
pub type BoardServices = Services<'static, Mutex, Inbox, Uptime, Station>;
pub type Store = SettingsStore<FlashPartition, &'static mut Scratch>;
#[unsafe(link_section = ".axisram")]
static STORE_SCRATCH: ConstStaticCell<Scratch> = ConstStaticCell::new(SCRATCH);

/// The node, its queues and the transfers that it puts together.
#[unsafe(link_section = ".axisram")]
static SERVICES: StaticCell<BoardServices> = StaticCell::new();

pub struct Station {
    store: Store,
    commissioning: BoardCommissioning,
    updates: Updates,
    led: Output<'static>,
}

/// The settings of the last store, or the defaults.
#[inline(never)]
pub fn load(flash: FlashPartitions) -> (Store, Settings, LoadReport) {
    let span = NUCLEO_H743ZI2.settings;
    // It has two sectors.
    let mut store = unwrap!(SettingsStore::new(flash.get(span), 0..span.bytes(), STORE_SCRATCH.take()).ok());
    let (settings, report) = block_on(store.load());
    (store, settings, report)
}

/// The version that no model may be below.
#[inline(never)]
pub fn model_floor(store: &mut Store) -> ImageVersion {
    block_on(store.model_floor()).into()
}

/// The task, in AXI SRAM.
#[inline(never)]
pub fn build(
    store: Store,
    commissioning: BoardCommissioning,
    settings: Settings,
    loaded: LoadReport,
    updates: Updates,
    model_hash: Option<[u8; HASH_BYTES]>,
    inbox: Inbox,
    led: Output<'static>,
    start: Start,
) -> &'static mut BoardServices {
    let mut unique_id = [0; 16];
    unique_id.iter_mut().zip(uid::uid()).for_each(|(to, from)| *to = from);
    let identity = Identity {
        hardware_version: HARDWARE,
        software_version: updates.version.into(),
        vcs_revision: COMMIT,
        unique_id,
        model_hash,
        settings: loaded,
        entropy: entropy(),
    };
    let node = Node::new(identity, settings);
    let station = Station { store, commissioning, updates, led };
    SERVICES.init_with(|| Services::new(node, inbox, Uptime, &SHARED, station, start))
}

/// A random number of this start, from the generator (RM0433, RNG); `None` if it does not deliver.
fn entropy() -> Option<u64> {
    pac::RCC.ahb2enr().modify(|w| w.set_rngen(true));
    pac::RNG.cr().modify(|w| w.set_rngen(true));
    let word = || {
        let ready = (0..RNG_SPINS).any(|_| pac::RNG.sr().read().drdy());
        // The generator gives 0 after an error.
        Some(pac::RNG.dr().read()).filter(|&word| ready && word != 0)
    };
    Some(u64::from(word()?) << 32 | u64::from(word()?))
}

impl StatusLed for Station {
    fn show(&mut self, condition: Condition) {
        self.led.set_level(Level::from(condition == Condition::Warning));
    }
}

impl FileSink for Station {
    async fn write(&mut self, target: UpdateTarget, offset: u32, bytes: &[u8]) -> Result<(), &'static str> {
        self.updates.sink.write(target, offset, bytes).await
    }

    async fn finish(&mut self, target: UpdateTarget, length: u32) -> Result<(), &'static str> {
        self.updates.sink.finish(target, length).await
    }
}

impl ServiceBoard for Station {
    async fn store(&mut self, settings: &Settings) -> Result<(), &'static str> {
        let stored = self.store.store(settings).await;
        if let Err(error) = &stored {
            warn!("settings not stored: {}", Display2Format(error));
        }
        stored.map_err(StoreError::text)
    }

    async fn begin_update(&mut self, target: UpdateTarget) -> Result<u32, &'static str> {
        self.updates.sink.begin(target).await.map_err(Refusal::reason)
    }

    fn unlocks(&mut self, challenge: &[u8; CHALLENGE_BYTES], signature: &[u8; SIGNATURE_BYTES]) -> bool {
        unlocks(challenge, signature, PUBLIC_KEYS)
    }

    fn next_notice(&mut self) -> Option<Notice> {
        self.updates.notices.pop_front()
    }

    fn ready_to_confirm(&mut self, evidence: Evidence) -> bool {
        self.updates.ready_to_confirm(evidence)
    }

    async fn confirm(&mut self) {
        self.updates.confirm(&mut self.store).await;
    }

    fn apply(&mut self, settings: &Settings) {
        let mounting = |(rows_flipped, cols_flipped)| Mounting { rows_flipped, cols_flipped };
        LINK.mount(settings.orientation().map(mounting));
        LINK.switch_off(core::array::from_fn(|sensor| settings.taxel_mask(sensor)));
    }

    fn observe(&mut self, status: &mut Status) {
        status.lost_received = can::lost_received();
        status.flash_errors = count_ecc_errors();
        status.ram_errors = ram_errors::count();
        if let Some(report) = LINK.report() {
            status.stuck_taxels = report.stuck_taxels;
        }
        status.calibrations = *self.commissioning.summaries();
        status.measurement = self.commissioning.progress();
    }

    fn calibrate(&mut self, request: Request) -> Result<(), &'static str> {
        self.commissioning.begin(request)
    }

    fn calibration_ends(&mut self) -> bool {
        self.commissioning.is_ready()
    }

    async fn end_calibration(&mut self) -> Option<(u8, Result<Summary, Failure>)> {
        self.commissioning.finish(&mut self.store).await
    }

    fn identify(&mut self, lit: bool) {
        self.led.set_level(Level::from(lit));
    }
}
