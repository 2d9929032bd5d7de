//! Start, tasks, and the mailbox in the board's RAM.

use core::future::pending;
use core::panic::PanicInfo;
use core::sync::atomic::AtomicU32;

use cortex_m::peripheral::DWT;
use cortex_m_rt::{ExceptionFrame, exception};
use defmt::unwrap;
use defmt_rtt as _;
use embassy_executor::{Executor, InterruptExecutor};
use embassy_stm32::interrupt;
use embassy_stm32::interrupt::{InterruptExt, Priority};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::zerocopy_channel::{Channel, Receiver, Sender};
use embassy_time::Timer;
use slipsense::board::mailbox::{ANSWER_WORDS, Desk, FRAME_WORDS, Mailbox};
use slipsense::board::replay::{FRAME_BYTES_MAX, decode_parts, decode_stamp};
use slipsense::board::{CanTransmit, FrameSource, Lane, Observe, SensedFrame, SensedPart, StoppedClock};
use slipsense::health::CanStatus;
use slipsense::net::Model;
use slipsense::params::MAX_SENSORS;
use slipsense::pipeline::{FrameStamp, Output, Pipeline, State};
use slipsense::tasks::{self, Inference, QUEUED_FRAMES, RAW_MESSAGES, RawQueue, Shared, Transmission};
use slipsense::wire::{CanFrame, NodeId, RawTransfer, Transmitter};
use static_cell::StaticCell;

#[path = "../board/stm32/memory.rs"]
#[allow(unused_imports, unused_macros, reason = "the firmware uses the rest")]
pub mod memory;
#[path = "../board/stm32/model.rs"]
mod model;

use memory::axi_sram_slot;

/// How often the mailbox is looked at. A real wait on the timer, so that acquisition interrupts inference as in the
/// firmware.
const LOOK_US: u64 = 100;

type Mutex = CriticalSectionRawMutex;
type HilInference = Inference<'static, Mutex, StoppedClock, Answers, &'static mut State>;

/// Under the name [`slipsense::board::mailbox::SYMBOL`]. In DTCM, which is never cached and has its clock after reset,
#[unsafe(export_name = "SLIPSENSE_MAILBOX")]
static MAILBOX: Mailbox = Mailbox::new();
// In D2 SRAM, which is not cached: what the probe writes there, the core sees, and the other way round.
#[unsafe(link_section = ".sram_d2")]
static FRAME: [AtomicU32; FRAME_WORDS] = [const { AtomicU32::new(0) }; FRAME_WORDS];
#[unsafe(link_section = ".sram_d2")]
static ANSWER: [AtomicU32; ANSWER_WORDS] = [const { AtomicU32::new(0) }; ANSWER_WORDS];
static DESK: Desk = Desk::new(&MAILBOX, &FRAME, &ANSWER);

static ACQUISITION: InterruptExecutor = InterruptExecutor::new();
static INFERENCE: StaticCell<Executor> = StaticCell::new();
static SHARED: Shared<Mutex> = Shared::new();
static RAW_QUEUE: StaticCell<RawQueue<'static, Mutex>> = StaticCell::new();
static FRAME_QUEUE: StaticCell<Channel<'static, Mutex, SensedFrame>> = StaticCell::new();
static PIPELINE: StaticCell<HilInference> = StaticCell::new();
axi_sram_slot! {
    /// What the frame queue lends out.
    FRAME_BUFFERS: [SensedFrame; QUEUED_FRAMES]
}
axi_sram_slot! {
    /// What the queue of raw messages lends out.
    RAW_BUFFERS: [RawTransfer; RAW_MESSAGES]
}
axi_sram_slot! {
    /// Where frames come from.
    SOURCE: Replayed
}

/// # Safety
/// Called by the hardware only, and not before `main` has started the executor.
#[interrupt]
unsafe fn CEC() {
    // SAFETY: this is the interrupt that the executor was started with.
    unsafe { ACQUISITION.on_interrupt() }
}

/// What a board's entry point hands over. No pin is used.
pub struct Hardware {
    /// As on the label.
    pub board: &'static str,
    /// Clock of the core.
    pub core_hz: u32,
}

/// As the firmware's macro of this name, for [`Hardware`].
macro_rules! nucleo_144 {
    ($chip:ident, $board:literal) => {
        Hardware {
            board: $board,
            core_hz: ::embassy_stm32::rcc::clocks(&$chip.RCC).sys.to_hertz().map_or(0, |clock| clock.0),
        }
    };
}
pub(crate) use nucleo_144;

/// Wait for the host, then answer its frames. On a chip whose memory and clocks are set up.
pub fn run(hardware: Hardware) -> ! {
    DESK.place((address(&FRAME), address(&ANSWER)), hardware.core_hz);
    count_cycles();
    let model = match Model::parse(model::built_in(model::place())) {
        Ok(model) => model,
        Err(error) => give_up(format_args!("{}: model: {error}", hardware.board)),
    };
    DESK.open(&model.hash);
    let sensors = loop {
        if let Some(sensors) = DESK.sensors() {
            break sensors;
        }
    };
    let pipeline = match Pipeline::within(model::first_state(), model, sensors) {
        Ok(pipeline) => pipeline,
        Err(error) => give_up(format_args!("{}: {error}", hardware.board)),
    };
    let (raw_sender, raw_receiver) = RAW_QUEUE.init(RawQueue::new(raw_buffers())).split();
    let (sender, receiver) = FRAME_QUEUE.init(Channel::new(frame_buffers())).split();
    let transmitter = Transmitter::new(NodeId::DEFAULT);
    let answers = Answers { began: 0 };
    let inference =
        PIPELINE.init(Inference::new(pipeline, transmitter, StoppedClock, answers, &SHARED, raw_sender));
    let source = unwrap!(SOURCE.take()).write(Replayed { taken: None, sensors, bytes: [0; FRAME_BYTES_MAX] });

    interrupt::CEC.set_priority(Priority::P6);
    let spawner = ACQUISITION.start(interrupt::CEC);
    spawner.spawn(unwrap!(transmit(raw_receiver)));
    spawner.spawn(unwrap!(acquire(source, sender)));
    INFERENCE.init(Executor::new()).run(|spawner| spawner.spawn(unwrap!(infer(inference, receiver))))
}

/// Where the host finds it.
fn address<const N: usize>(words: &'static [AtomicU32; N]) -> u32 {
    words.as_ptr().addr() as u32
}

/// Apart: what these buffers take of the stack before they are in AXI SRAM is given back.
#[inline(never)]
fn raw_buffers() -> &'static mut [RawTransfer] {
    unwrap!(RAW_BUFFERS.take()).write([const { RawTransfer::new() }; RAW_MESSAGES])
}

/// Apart, as [`raw_buffers`].
#[inline(never)]
fn frame_buffers() -> &'static mut [SensedFrame] {
    unwrap!(FRAME_BUFFERS.take()).write([const { SensedFrame::new() }; QUEUED_FRAMES])
}

/// Let the core count its cycles.
fn count_cycles() {
    // SAFETY: the board's entry point is through with its own, and interrupts are not on yet.
    let mut core = unsafe { cortex_m::Peripherals::steal() };
    core.DCB.enable_trace();
    // Closed after power-on on this core: the counter would not start.
    DWT::unlock();
    core.DWT.enable_cycle_counter();
}

#[embassy_executor::task]
async fn acquire(source: &'static mut Replayed, queue: Sender<'static, Mutex, SensedFrame>) {
    tasks::acquire(source, queue, &SHARED).await;
}

#[embassy_executor::task]
async fn transmit(raw: Receiver<'static, Mutex, RawTransfer>) {
    Transmission::new(Bus, StoppedClock, &SHARED, raw).run().await;
}

#[embassy_executor::task]
async fn infer(inference: &'static mut HilInference, queue: Receiver<'static, Mutex, SensedFrame>) {
    inference.run(queue).await;
}

/// Frames from the mailbox.
struct Replayed {
    /// Number of the last one.
    taken: Option<u32>,
    sensors: usize,
    bytes: [u8; FRAME_BYTES_MAX],
}

impl FrameSource for Replayed {
    const REAL_TIME: bool = false;

    async fn tick(&mut self) -> Option<FrameStamp> {
        let number = loop {
            match DESK.waiting() {
                Some(number) if self.taken != Some(number) => break number,
                _ => Timer::after_micros(LOOK_US).await,
            }
        };
        self.taken = Some(number);
        DESK.take(&mut self.bytes);
        decode_stamp(&self.bytes)
    }

    async fn read(&mut self, parts: &mut [SensedPart; MAX_SENSORS]) {
        let parts = parts.get_mut(..self.sensors);
        if parts.and_then(|parts| decode_parts(&self.bytes, parts)).is_none() {
            DESK.fail(format_args!("frame {}: no frame", self.taken.unwrap_or_default()));
            pending().await
        }
    }

    async fn discard(&mut self) {}
}

/// The bus, which takes everything at once.
struct Bus;

impl CanTransmit for Bus {
    fn is_free(&self, _lane: Lane) -> bool {
        true
    }

    fn transmit(&mut self, _lane: Lane, frame: &CanFrame) {
        DESK.sent(frame);
    }

    fn withdraw(&mut self, _lane: Lane) {}

    fn has_sent(&self, _lane: Lane) -> bool {
        true
    }

    async fn changed(&mut self) {
        pending().await
    }

    fn status(&mut self) -> CanStatus {
        CanStatus::default()
    }
}

/// Ends each frame's answer.
struct Answers {
    /// The cycle in which the pipeline took the frame.
    began: u32,
}

impl Observe for Answers {
    fn step_begins(&mut self, _stamp: FrameStamp) {
        self.began = DWT::cycle_count();
    }

    fn step_ends(&mut self, _stamp: FrameStamp, _output: &Output) {
        DESK.took(DWT::cycle_count().wrapping_sub(self.began));
    }

    /// Transmission interrupts inference as soon as there is something to send, so all of it has gone by now.
    fn frame_done(&mut self, _stamp: FrameStamp) {
        DESK.answered();
    }
}

/// Tell the host why, and stand still until the next reset.
fn give_up(why: core::fmt::Arguments<'_>) -> ! {
    cortex_m::interrupt::disable();
    DESK.fail(why);
    loop {
        cortex_m::asm::nop();
    }
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    give_up(format_args!("{info}"))
}

#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    give_up(format_args!("hard fault at {:#010x}, called from {:#010x}", frame.pc(), frame.lr()))
}
