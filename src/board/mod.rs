//! The seam to a board: what the tasks need from it, as traits that the firmware, the emulated
//! microcontroller and the tests implement.
//!
//! A board owns pins, clocks and buses. It hands over one [`SensedFrame`] per tick and takes CAN frames
//! away; everything between is [`crate::tasks`] and the same everywhere.
#![allow(async_fn_in_trait, reason = "tasks are spawned with concrete types, which decide about Send")]

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

/// The bus.
pub trait CanTransmit {
    /// Why a frame did not go out.
    type Error;

    /// Queue one CAN FD frame with bit rate switching; waits while the queue is full. Frames of equal
    /// identifier must stay in order. An error means that this frame is lost.
    async fn transmit(&mut self, frame: &CanFrame) -> Result<(), Self::Error>;
}

/// The board's clock, the one that stamps the ticks.
pub trait Clock {
    /// Microseconds since start.
    fn now_us(&self) -> u64;
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
    /// All CAN frames of this frame have been handed to the bus.
    fn frame_sent(&mut self, _stamp: FrameStamp) {}
}

/// Nobody looks.
impl Observe for () {}
