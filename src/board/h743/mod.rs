//! NUCLEO-H743ZI2 (STM32H743ZI, silicon revision V): the wiring, and the entry point of the firmware.
//!
//! **A skeleton.** The drivers of the taxel array and of the accelerometer are not written yet. The frame
//! source ticks at 240 Hz and delivers frames in which every part of every sensor is missing, so the bus
//! carries slip messages (and raw messages of zeros) at 240 Hz whose health bytes say PIEZO_MISSING and
//! XL_MISSING. Everything behind the source (tasks, pipeline, messages, FDCAN, watchdog, both executors)
//! is what the product runs. It ran on an emulated STM32H743, which has no FDCAN; on a board, not yet.
//!
//! ```text
//! TIM2 ─> acquire (interrupt executor, CEC) ─> frame queue ─> infer (thread executor) ─> pipeline ─> FDCAN1
//!                                                             └─> watchdog, fed if both moved on
//! ```
//!
//! Without a readable model the node does not stop: it reports the reason over defmt, lights the red LED
//! and goes on sending slip messages, flagged NO_MODEL.

mod can;
mod clocks;
mod memory;
mod sensors;
mod watchdog;

use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m_rt::entry;
use defmt::{Display2Format, error, info, unwrap, warn};
use defmt_rtt as _;
use embassy_executor::{Executor, InterruptExecutor};
use embassy_stm32::gpio::{Output, Speed};
use embassy_stm32::interrupt;
use embassy_stm32::interrupt::{InterruptExt, Priority};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::zerocopy_channel::{Channel, Receiver, Sender};
use embassy_time::Instant;
use panic_probe as _;
use slipsense::board::{CanTransmit, Clock, SensedFrame};
use slipsense::net::{Aligned, Model};
use slipsense::params::{FRAME_RATE_HZ, MAX_SENSORS};
use slipsense::pipeline::{FrameStamp, Pipeline, State};
use slipsense::tasks::{self, Inference, QUEUED_FRAMES};
use slipsense::wire::{NodeId, SensorContact, SlipMessage, Transmitter, health};
use static_cell::{ConstStaticCell, StaticCell};

use can::CanBus;
use memory::axi_sram_slot;
use sensors::AbsentSensors;
use watchdog::Watchdog;

/// Fingertips behind this board.
const SENSORS: usize = 1;
const _: () = assert!(SENSORS >= 1 && SENSORS <= MAX_SENSORS);

/// The network, as trained and quantized.
static MODEL: &[u8] = include_bytes!(concat!(env!("CARGO_MANIFEST_DIR"), "/model/weights/slipsense.slipnet"));
/// The same in DTCM, where the inner loops read it without waiting.
static MODEL_IN_DTCM: ConstStaticCell<Aligned<[u8; MODEL.len()]>> =
    ConstStaticCell::new(Aligned([0; MODEL.len()]));

/// The higher executor: a tick preempts inference. HDMI-CEC is unused, so its interrupt is free.
static ACQUISITION: InterruptExecutor = InterruptExecutor::new();
static INFERENCE: StaticCell<Executor> = StaticCell::new();

type Mutex = CriticalSectionRawMutex;
type BoardInference = Inference<'static, CanBus, Uptime, (), &'static mut State>;

static FRAME_QUEUE: StaticCell<Channel<'static, Mutex, SensedFrame>> = StaticCell::new();
/// Ticks so far, wraps.
static TICKS: AtomicU32 = AtomicU32::new(0);
axi_sram_slot! {
    /// What the frame queue lends out.
    FRAME_BUFFERS: [SensedFrame; QUEUED_FRAMES]
}
axi_sram_slot! {
    /// All that the pipeline remembers.
    STATE: State
}
static PIPELINE: StaticCell<BoardInference> = StaticCell::new();

/// The clock that stamps the ticks.
struct Uptime;

impl Clock for Uptime {
    fn now_us(&self) -> u64 {
        Instant::now().as_micros()
    }
}

/// # Safety
/// Called by the hardware only, and not before `main` has started the executor.
#[interrupt]
unsafe fn CEC() {
    // SAFETY: this is the interrupt that the executor was started with.
    unsafe { ACQUISITION.on_interrupt() }
}

#[entry]
fn main() -> ! {
    let mut core = unwrap!(cortex_m::Peripherals::take());
    memory::init(&mut core);
    let chip = embassy_stm32::init(clocks::config());
    info!("slipsense {=str}, NUCLEO-H743ZI2, {=u32} Hz", env!("CARGO_PKG_VERSION"), FRAME_RATE_HZ);

    let can = unwrap!(CanBus::start(chip.FDCAN1, chip.PD0, chip.PD1));
    let node = build(can);
    let fault = matches!(node, Node::WithoutModel(_));
    // LD3, red. Never dropped: that would release the pin.
    core::mem::forget(Output::new(chip.PB14, fault.into(), Speed::Low));

    let buffers = unwrap!(FRAME_BUFFERS.take()).write([const { SensedFrame::new() }; QUEUED_FRAMES]);
    let (sender, receiver) = FRAME_QUEUE.init(Channel::new(buffers)).split();
    let watchdog = Watchdog::start(chip.IWDG1);

    // Below the drivers' interrupts, which default to the highest priority.
    interrupt::CEC.set_priority(Priority::P6);
    ACQUISITION.start(interrupt::CEC).spawn(unwrap!(acquire(AbsentSensors::start(&TICKS), sender)));
    INFERENCE.init(Executor::new()).run(|spawner| spawner.spawn(unwrap!(infer(node, receiver, watchdog))))
}

/// What answers to a frame.
enum Node {
    Whole(&'static mut BoardInference),
    WithoutModel(CanBus),
}

/// Make the pipeline, or report why there is none.
///
/// In two steps, one after the other, so that what parsing takes of the stack is gone when the pipeline is made.
fn build(can: CanBus) -> Node {
    match read_model() {
        Some(model) => place(model, can),
        None => Node::WithoutModel(can),
    }
}

/// The model, in DTCM; `None`: it is not readable, which has been reported.
#[inline(never)]
fn read_model() -> Option<Model<'static>> {
    let Aligned(model) = MODEL_IN_DTCM.take();
    // Opaque, so that the model stays data: the optimiser would fold what it can see of it into code.
    model.copy_from_slice(core::hint::black_box(MODEL));
    let model: &'static [u8] = model;
    let parsed = Model::parse(model);
    if let Err(error) = &parsed {
        error!("model of {=usize} bytes: {}", model.len(), Display2Format(error));
    }
    parsed.ok()
}

/// What the pipeline remembers at first.
static FIRST_STATE: State = State::new();

/// On a state that is made where it stays, in AXI SRAM.
#[inline(never)]
fn place(model: Model<'static>, can: CanBus) -> Node {
    let state = unwrap!(STATE.take());
    // SAFETY: a state is plain numbers, so a copy of the bytes of one is another. Written as a value it would, with
    // some compilers, be made on the stack first.
    let state = unsafe {
        state.as_mut_ptr().copy_from_nonoverlapping(&raw const FIRST_STATE, 1);
        state.assume_init_mut()
    };
    let pipeline = match Pipeline::within(state, model, SENSORS) {
        Ok(pipeline) => pipeline,
        Err(error) => {
            error!("pipeline: {}", Display2Format(&error));
            return Node::WithoutModel(can);
        }
    };
    let transmitter = Transmitter::new(NodeId::DEFAULT);
    Node::Whole(PIPELINE.init(Inference::new(pipeline, transmitter, can, Uptime, ())))
}

#[embassy_executor::task]
async fn acquire(mut source: AbsentSensors, queue: Sender<'static, Mutex, SensedFrame>) {
    tasks::acquire(&mut source, queue).await;
}

#[embassy_executor::task]
async fn infer(mut node: Node, mut queue: Receiver<'static, Mutex, SensedFrame>, mut watchdog: Watchdog) {
    let mut degraded = Transmitter::new(NodeId::DEFAULT);
    let mut frames_until_report = FRAME_RATE_HZ;
    loop {
        match &mut node {
            Node::Whole(inference) => inference.serve(&mut queue).await,
            Node::WithoutModel(can) => {
                let stamp = queue.receive().await.stamp;
                queue.receive_done();
                // A refused frame shows at the receiver as a gap in the sequence numbers.
                let _ = can.transmit(&degraded.slip(&without_model(stamp))).await;
            }
        }
        watchdog.feed(TICKS.load(Ordering::Relaxed));
        frames_until_report -= 1;
        if frames_until_report == 0 {
            frames_until_report = FRAME_RATE_HZ;
            report(&node);
        }
    }
}

/// Once a second.
fn report(node: &Node) {
    let can = match node {
        Node::Whole(inference) => {
            let losses = inference.losses;
            info!("late {=u32}, refused by the bus {=u32}", losses.late_frames, losses.refused_can_frames);
            &inference.bus
        }
        Node::WithoutModel(can) => {
            error!("no readable model: slip messages carry NO_MODEL");
            can
        }
    };
    if can.is_off() {
        warn!("the node is off the bus");
    }
}

/// What the node can say without a network: the time, and that nothing in it is a decision.
fn without_model(stamp: FrameStamp) -> SlipMessage {
    let flagged = SensorContact {
        health: health::NO_MODEL | health::PIEZO_MISSING | health::XL_MISSING,
        ..SensorContact::default()
    };
    let mut contact = [SensorContact::default(); MAX_SENSORS];
    contact[..SENSORS].fill(flagged);
    let FrameStamp { sequence, timestamp_us } = stamp;
    SlipMessage { timestamp_us, sequence, sensors: SENSORS as u8, contact, ..SlipMessage::default() }
}
