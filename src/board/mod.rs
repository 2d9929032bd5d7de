//! The seam to a board: what the tasks need from it, as traits that the firmware, the emulated
//! microcontroller and the tests implement.
//!
//! A board owns pins, clocks and buses. It hands over one [`SensedFrame`] per tick and takes CAN frames
//! away; everything between is [`crate::tasks`] and the same everywhere.
//!
//! Storage is not here: settings and updates take any flash that has the traits of `embedded-storage`.
#![allow(async_fn_in_trait, reason = "tasks are spawned with concrete types, which decide about Send")]

pub mod mailbox;
pub mod panic_record;
pub mod replay;
mod sensing;

pub use sensing::{Accelerometer, Drained, FIFO_SAMPLES_MAX, FifoSamples, TaxelScan, XlFault, XlPart};

use crate::health::{CanStatus, Condition};
use crate::params::{MAX_SENSORS, XL_BATCH_MAX};
use crate::pipeline::{FrameStamp, Output};
use crate::sensor::{PiezoFrame, SensorInput, XlSample};
use crate::wire::CanFrame;

/// What one sensor delivered for one frame, in a buffer that is filled again and again.
#[derive(Clone, Debug)]
pub struct SensedPart {
    /// The array scan; believed only if `piezo_arrived`.
    pub piezo: PiezoFrame,
    /// Did the array deliver for this frame?
    pub piezo_arrived: bool,
    /// Samples since the previous tick, oldest first; believed only if `xl_arrived`.
    pub xl: heapless::Vec<XlSample, XL_BATCH_MAX>,
    /// Did the accelerometer deliver for this frame? It may have delivered zero samples.
    pub xl_arrived: bool,
    /// Index of the sample after the last of `xl`, counted since start, wraps.
    pub xl_end: u32,
}

impl SensedPart {
    /// Nothing arrived.
    pub const fn new() -> Self {
        Self {
            piezo: PiezoFrame::zeroed(),
            piezo_arrived: false,
            xl: heapless::Vec::new(),
            xl_arrived: false,
            xl_end: 0,
        }
    }

    /// The readings as the pipeline takes them.
    pub fn input(&self) -> SensorInput<'_> {
        SensorInput {
            piezo: self.piezo_arrived.then_some(&self.piezo),
            xl: self.xl_arrived.then_some(self.xl.as_slice()),
        }
    }
}

impl Default for SensedPart {
    fn default() -> Self {
        Self::new()
    }
}

/// Everything that one tick closed.
#[derive(Clone, Debug)]
pub struct SensedFrame {
    /// Number and time of the tick.
    pub stamp: FrameStamp,
    /// In sensor order; entries of sensors that the board does not have are not looked at.
    pub parts: [SensedPart; MAX_SENSORS],
    /// Frames dropped since start, up to this one; written by [`crate::tasks::acquire`].
    pub dropped_frames: u32,
}

impl SensedFrame {
    /// Nothing arrived.
    pub const fn new() -> Self {
        Self {
            stamp: FrameStamp { sequence: 0, timestamp_us: 0 },
            parts: [const { SensedPart::new() }; MAX_SENSORS],
            dropped_frames: 0,
        }
    }
}

impl Default for SensedFrame {
    fn default() -> Self {
        Self::new()
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
    async fn read(&mut self, parts: &mut [SensedPart; MAX_SENSORS]);

    /// Throw away what the tick just waited for has closed. Called instead of [`read`](Self::read), by
    /// [`crate::tasks::acquire`] for real-time sources only.
    async fn discard(&mut self);
}

/// The three kinds of CAN frame that a node sends. The hardware holds at most one of each, and of those that it
/// holds the one with the smallest identifier goes first, as on the bus. So the slip message never waits behind a
/// frame of its own node that other traffic keeps from the bus, and the frames of a transfer, which have one
/// identifier, cannot change their order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lane {
    /// The slip message.
    Slip,
    /// Heartbeat, answers, and whatever else the node's services say.
    Service,
    /// Raw messages.
    Raw,
}

impl Lane {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Slip, Self::Service, Self::Raw];
}

/// The hardware's end of the bus: a slot for each [`Lane`]. What waits for a slot is
/// [`crate::tasks::Transmission`]'s to choose.
pub trait CanTransmit {
    /// Has the lane's frame gone, so that another can be handed over?
    fn is_free(&self, lane: Lane) -> bool;

    /// Send one CAN FD frame with bit rate switching, again and again until it is acknowledged. Called for a free
    /// lane only; a frame for one that is not free is lost.
    fn transmit(&mut self, lane: Lane, frame: &CanFrame);

    /// Take the lane's frame back, if it is not on the wire just now: it need not be free at once.
    fn withdraw(&mut self, lane: Lane);

    /// Of a lane that is free: has its last frame gone over the bus? `false`: it was taken back before it could, or
    /// there was none.
    fn has_sent(&self, lane: Lane) -> bool;

    /// Wait until a lane may have become free or the state may have changed; may return early. Dropping the future
    /// loses nothing.
    async fn changed(&mut self);

    /// State and error counters now. A node that drops off the bus rejoins by itself.
    fn status(&mut self) -> CanStatus;
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

/// Looks at results beside the bus: a display, a log, a test. Does nothing unless told to.
pub trait Observe {
    /// The pipeline is about to take this frame.
    fn step_begins(&mut self, _stamp: FrameStamp) {}
    /// The pipeline has made this of it.
    fn step_ends(&mut self, _stamp: FrameStamp, _output: &Output) {}
    /// The slip message waits for the bus, ahead of everything else.
    fn slip_queued(&mut self, _stamp: FrameStamp) {}
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
