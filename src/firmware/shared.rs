//! What the tasks of a program share, and the clock that stamps their frames.

use embassy_executor::InterruptExecutor;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::zerocopy_channel::{Channel, Receiver, Sender};
use embassy_time::Instant;
use static_cell::StaticCell;

use crate::board::{Clock, SensorFrame};
use crate::tasks::{QUEUED_FRAMES, RAW_MESSAGES, RawQueue, Shared};
use crate::wire::RawTransfer;

/// Interrupts share the queues.
pub type Mutex = CriticalSectionRawMutex;
/// To the queue of frames.
pub type FrameSender = Sender<'static, Mutex, SensorFrame>;
/// From the queue of frames.
pub type FrameReceiver = Receiver<'static, Mutex, SensorFrame>;
/// To the queue of raw messages.
pub type RawSender = Sender<'static, Mutex, RawTransfer>;
/// From the queue of raw messages.
pub type RawReceiver = Receiver<'static, Mutex, RawTransfer>;

/// The higher executor: a tick preempts inference. HDMI-CEC is unused, so its interrupt is free.
pub static ACQUISITION: InterruptExecutor = InterruptExecutor::new();
/// Counters and settings; registers and heartbeat read it.
pub static SHARED: Shared<Mutex> = Shared::new();

static RAW_QUEUE: StaticCell<RawQueue<'static, Mutex>> = StaticCell::new();
static FRAME_QUEUE: StaticCell<Channel<'static, Mutex, SensorFrame>> = StaticCell::new();
#[unsafe(link_section = ".axisram")]
static FRAME_BUFFERS: StaticCell<[SensorFrame; QUEUED_FRAMES]> = StaticCell::new();
#[unsafe(link_section = ".axisram")]
static RAW_BUFFERS: StaticCell<[RawTransfer; RAW_MESSAGES]> = StaticCell::new();

/// The queue of raw messages. Once, and apart: what its buffers take of the stack before they are in AXI SRAM is given
/// back.
#[inline(never)]
pub fn raw_queue() -> (RawSender, RawReceiver) {
    let buffers = RAW_BUFFERS.init_with(|| [const { RawTransfer::new() }; RAW_MESSAGES]);
    RAW_QUEUE.init(RawQueue::new(buffers)).split()
}

/// The queue of frames; as [`raw_queue`].
#[inline(never)]
pub fn frame_queue() -> (FrameSender, FrameReceiver) {
    let buffers = FRAME_BUFFERS.init_with(|| [const { SensorFrame::new() }; QUEUED_FRAMES]);
    FRAME_QUEUE.init(Channel::new(buffers)).split()
}

/// Time since start.
#[derive(Clone, Copy, Debug)]
pub struct Uptime;

impl Clock for Uptime {
    fn now_us(&self) -> u64 {
        Instant::now().as_micros()
    }
}
