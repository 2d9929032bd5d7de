//! The seam to a board: what the tasks need from it, as traits that the firmware, the emulated
//! microcontroller and the tests implement.
//!
//! A board owns pins, clocks and buses. It hands over one [`SensorFrame`] per tick and takes CAN frames
//! away; everything between is [`crate::tasks`] and the same everywhere.
//!
//! Storage is not here: settings and updates take any flash that has the traits of `embedded-storage`.
#![allow(async_fn_in_trait, reason = "tasks are spawned with concrete types, which decide about Send")]

pub mod mailbox;
pub mod crash_record;
pub mod replay;
mod sensing;

pub use sensing::{Accelerometer, FIFO_SAMPLES_MAX, FifoSamples, FifoStatus, TaxelScan, XlFault, XlPart};

use crate::health::{CanStatus, Condition};
use crate::params::MAX_SENSORS;
use crate::pipeline::{FrameStamp, Output};
use crate::sensor::SensorReadings;
use crate::wire::CanFrame;

/// Everything that one tick closed.
#[derive(Clone, Debug)]
pub struct SensorFrame {
    /// Number and time of the tick.
    pub stamp: FrameStamp,
    /// In sensor order; entries of sensors that the board does not have are not looked at.
    pub parts: [SensorReadings; MAX_SENSORS],
    /// Frames dropped since start, up to this one; written by [`crate::tasks::acquire`].
    pub dropped_frames: u32,
}

impl SensorFrame {
    /// Nothing arrived.
    pub const fn new() -> Self {
        Self {
            stamp: FrameStamp { sequence: 0, timestamp_us: 0 },
            parts: [const { SensorReadings::new() }; MAX_SENSORS],
            dropped_frames: 0,
        }
    }
}

/// Where frames come from.
pub trait FrameSource {
    /// What the source does when nobody has room for a frame. `true`: it lives in real time, its frames
    /// do not wait, so one without room is dropped whole and counted. `false`: a recording, which waits.
    const REAL_TIME: bool;

    /// Wait for the tick that closes the next frame. `None`: there are no more.
    async fn tick(&mut self) -> Option<FrameStamp>;

    /// Write into `parts` what the tick just waited for has closed. Called at most once per tick.
    async fn read(&mut self, parts: &mut [SensorReadings; MAX_SENSORS]);
}

/// The three kinds of CAN frame that a node sends. The hardware holds at most one of each, and of those that it
/// holds the one with the smallest identifier goes first, as on the bus. So the slip message never waits behind a
/// frame of its own node that other traffic keeps from the bus, and the frames of a transfer, which have one
/// identifier, cannot change their order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TxSlot {
    /// The slip message.
    Slip,
    /// Heartbeat, answers, and whatever else the node's services say.
    Service,
    /// Raw messages.
    Raw,
}

impl TxSlot {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Slip, Self::Service, Self::Raw];
}

/// The hardware's end of the bus: one frame for each [`TxSlot`]. What waits is
/// [`crate::tasks::Transmission`]'s to choose.
pub trait CanTransmit {
    /// Has the slot's frame gone, so that another can be handed over?
    fn is_free(&self, slot: TxSlot) -> bool;

    /// Send one CAN FD frame with bit rate switching, again and again until it is acknowledged. Called for a free
    /// slot only; a frame for one that is not free is lost.
    fn transmit(&mut self, slot: TxSlot, frame: &CanFrame);

    /// Take the slot's frame back, if it is not on the wire just now: it need not be free at once.
    fn withdraw(&mut self, slot: TxSlot);

    /// Of a slot that is free: has its last frame gone over the bus? `false`: it was taken back before it could, or
    /// there was none.
    fn has_sent(&self, slot: TxSlot) -> bool;

    /// Wait until a slot may have become free or the state may have changed; may return early. Dropping the future
    /// loses nothing.
    async fn changed(&mut self);

    /// State and error counters now. A node that drops off the bus rejoins by itself.
    fn status(&mut self) -> CanStatus;
}

/// A bus that takes every frame at once: hands each to a function.
pub struct UnlimitedBus<F>(pub F);

impl<F: FnMut(TxSlot, &CanFrame)> CanTransmit for UnlimitedBus<F> {
    fn is_free(&self, _slot: TxSlot) -> bool {
        true
    }

    fn transmit(&mut self, slot: TxSlot, frame: &CanFrame) {
        self.0(slot, frame);
    }

    fn withdraw(&mut self, _slot: TxSlot) {}

    fn has_sent(&self, _slot: TxSlot) -> bool {
        true
    }

    async fn changed(&mut self) {
        core::future::pending().await
    }

    fn status(&mut self) -> CanStatus {
        CanStatus::default()
    }
}

/// What arrives from the bus for the node's services.
pub trait CanReceive {
    /// Wait for the next frame and the time of its arrival, µs of the board's [`Clock`]; `None` if there was none until
    /// `until_us`. Dropping the future loses nothing.
    async fn receive(&mut self, until_us: u64) -> Option<(CanFrame, u64)>;

    /// Let no frames through from now on but those of which `identifier & mask == identifier` for one of these pairs
    /// of identifier and mask.
    fn accept_only(&mut self, filters: &[(u32, u32)]);
}

/// The board's clock, the one that stamps the ticks.
pub trait Clock {
    /// Microseconds since start.
    fn now_us(&self) -> u64;
}

impl<C: Clock> Clock for &C {
    fn now_us(&self) -> u64 {
        (**self).now_us()
    }
}

/// The clock of a replayed recording: it stands at 0, so that no decision is late.
#[derive(Clone, Copy, Debug, Default)]
pub struct StoppedClock;

impl Clock for StoppedClock {
    fn now_us(&self) -> u64 {
        0
    }
}

/// Looks at results beside the bus: a display, a log, a test. By default it does nothing.
pub trait Observe {
    /// The pipeline is about to take this frame.
    fn step_begins(&mut self, _stamp: FrameStamp) {}
    /// The pipeline has made this of it.
    fn step_ends(&mut self, _stamp: FrameStamp, _output: &Output) {}
    /// The raw messages wait for the bus, or have been given up.
    fn frame_done(&mut self, _stamp: FrameStamp) {}
}

/// Nobody looks.
impl Observe for () {}

/// Resets the node unless it is fed in time.
pub trait Watchdog {
    /// Begin the time anew. Only [`crate::tasks::Supervisor`] calls it.
    fn feed(&mut self);
}

/// One light on the board.
pub trait StatusLed {
    /// Show how the node is; called about once a second, and at once when it changes.
    fn show(&mut self, condition: Condition);
}
