//! What the tasks share: slots, queues and counters, all of fixed size. Critical sections are copies of a few hundred
//! bytes at most.

use core::cell::{Cell, RefCell};

use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_sync::channel::Channel;
use embassy_sync::signal::Signal;
use embassy_sync::zerocopy_channel;

use super::Progress;
use crate::health::Status;
use crate::net::format::OperatingPoint;
use crate::params::{FRAME_PERIOD_US, MAX_SENSORS};
use crate::pipeline::Mountings;
use crate::sensor::TaxelMask;
use crate::settings::{Setting, Settings};
use crate::wire::{CanFrame, NodeId, RawTransfer};

/// Raw messages that wait for the bus: two frame periods of three sensors.
pub const RAW_MESSAGES: usize = 2 * MAX_SENSORS;
/// Service frames that wait for the bus: the longest answer of Cyphal's standard services, GetInfo with all its
/// fields, has 7.
pub const SERVICE_FRAMES: usize = 16;

/// Raw messages between inference and transmission, in buffers that are filled again and again.
pub type RawQueue<'a, M> = zerocopy_channel::Channel<'a, M, RawTransfer>;

/// What can be changed while the node runs; inference looks at it once per frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RuntimeConfig {
    /// Masked taxels, by sensor.
    pub masks: [TaxelMask; MAX_SENSORS],
    /// How the arrays are mounted, by sensor.
    pub mountings: Mountings,
    /// Raw messages of every n-th frame; 0: of none.
    pub raw_every: u8,
    /// Raw messages go compressed, and shorter still where the bus is behind; else plain.
    pub compress_raw: bool,
    /// The node's address; without one nothing may be sent.
    pub node: Option<NodeId>,
    /// Operating point; `None`: the model's own.
    pub point: Option<OperatingPoint>,
    /// The model that must run, by [`model_numbers`](crate::settings::model_numbers); `None`: any may.
    pub expected_model: Option<[u32; 2]>,
    /// Settings, commands and updates are refused.
    pub locked: bool,
}

impl RuntimeConfig {
    /// All taxels, plain raw messages of every frame, the default address, the model's operating point.
    pub const DEFAULT: Self = Self {
        masks: [TaxelMask::NONE; MAX_SENSORS],
        mountings: [(false, false); MAX_SENSORS],
        raw_every: 1,
        compress_raw: false,
        node: Some(NodeId::DEFAULT),
        point: None,
        expected_model: None,
        locked: false,
    };

    /// What these settings say, for a node with this address.
    pub fn new(settings: &Settings, node: Option<NodeId>, locked: bool) -> Self {
        Self {
            masks: core::array::from_fn(|sensor| settings.taxel_mask(sensor)),
            mountings: settings.orientation(),
            // A frame's rate, so that it fits.
            raw_every: settings.raw_divider() as u8,
            compress_raw: settings.is_on(Setting::CompressRaw),
            node,
            point: settings.operating_point(),
            expected_model: settings.expected_model(),
            locked,
        }
    }
}

/// One per node, usually a `static`.
pub struct Shared<M: RawMutex> {
    /// What each task has done, for the supervisor.
    pub progress: Progress,
    slip: Mutex<M, Cell<Option<CanFrame>>>,
    heartbeat: Mutex<M, Cell<Option<CanFrame>>>,
    services: Channel<M, CanFrame, SERVICE_FRAMES>,
    /// Signalled when there is something to send.
    tx_ready: Signal<M, ()>,
    config: Mutex<M, Cell<RuntimeConfig>>,
    status: Mutex<M, RefCell<Status>>,
    /// Tick of the last decided frame, µs.
    decided_us: Mutex<M, Cell<u64>>,
}

impl<M: RawMutex> Shared<M> {
    /// Before the first frame.
    pub const fn new() -> Self {
        Self {
            progress: Progress::new(),
            slip: Mutex::new(Cell::new(None)),
            heartbeat: Mutex::new(Cell::new(None)),
            services: Channel::new(),
            tx_ready: Signal::new(),
            config: Mutex::new(Cell::new(RuntimeConfig::DEFAULT)),
            status: Mutex::new(RefCell::new(Status::new())),
            decided_us: Mutex::new(Cell::new(0)),
        }
    }

    /// The counters now.
    pub fn status(&self) -> Status {
        self.status.lock(|status| status.borrow().clone())
    }

    /// Change the counters, in place; `change` must not use what is shared.
    pub fn update_status(&self, change: impl FnOnce(&mut Status)) {
        self.status.lock(|status| change(&mut status.borrow_mut()));
    }

    /// The frame of this tick is decided.
    pub fn decided(&self, tick_us: u64) {
        self.decided_us.lock(|cell| cell.set(tick_us));
    }

    /// Work of up to a frame's time may begin: the last frame is decided, and the next one is not late if it is decided
    /// after the work. Where no frame comes, none can be late.
    pub fn has_time(&self, now_us: u64) -> bool {
        let since_us = now_us.saturating_sub(self.decided_us.lock(Cell::get));
        !(FRAME_PERIOD_US * 3 / 4..2 * FRAME_PERIOD_US).contains(&since_us)
    }

    /// The settings in use.
    pub fn config(&self) -> RuntimeConfig {
        self.config.lock(Cell::get)
    }

    /// Use these settings from the next frame on.
    pub fn set_config(&self, config: RuntimeConfig) {
        self.config.lock(|cell| cell.set(config));
    }

    /// Send this slip message before anything else, and instead of an older one that still waits.
    pub fn send_slip(&self, frame: CanFrame) {
        if self.slip.lock(|cell| cell.replace(Some(frame))).is_some() {
            self.update_status(|status| status.replaced_slips = status.replaced_slips.saturating_add(1));
        }
        self.wake_transmission();
    }

    /// Wake transmission: a raw message has been put into the [`RawQueue`]; or there is no slip message for a frame, as
    /// the node has no address, and what stands still starves the watchdog.
    #[inline(never)]
    pub fn wake_transmission(&self) {
        self.tx_ready.signal(());
    }

    /// Send this frame of a service, after those that wait already. `false`: there is no room; it is not sent, and
    /// counted. A transfer of several frames is refused whole by asking [`service_room`](Self::service_room) first.
    pub fn send_service(&self, frame: CanFrame) -> bool {
        let sent = self.services.try_send(frame).is_ok();
        self.count_service(sent);
        sent
    }

    #[inline(never)]
    fn count_service(&self, sent: bool) {
        let refused = u32::from(!sent);
        self.update_status(|status| {
            status.refused_services = status.refused_services.saturating_add(refused)
        });
        self.wake_transmission();
    }

    /// Send this heartbeat before every other service frame, and instead of an older one that still waits. `false`: one
    /// did.
    pub fn send_heartbeat(&self, frame: CanFrame) -> bool {
        let first = self.heartbeat.lock(|cell| cell.replace(Some(frame))).is_none();
        self.count_service(first);
        first
    }

    /// Service frames for which there is room.
    pub fn service_room(&self) -> usize {
        self.services.free_capacity()
    }

    pub(super) fn take_slip(&self) -> Option<CanFrame> {
        self.slip.lock(Cell::take)
    }

    pub(super) fn slip_waits(&self) -> bool {
        self.slip.lock(Cell::get).is_some()
    }

    pub(super) fn take_heartbeat(&self) -> Option<CanFrame> {
        self.heartbeat.lock(Cell::take)
    }

    pub(super) fn heartbeat_waits(&self) -> bool {
        self.heartbeat.lock(Cell::get).is_some()
    }

    pub(super) fn take_service(&self) -> Option<CanFrame> {
        self.services.try_receive().ok()
    }

    /// Wait until there is something new to send.
    pub(super) async fn wait_tx(&self) {
        self.tx_ready.wait().await;
    }
}
