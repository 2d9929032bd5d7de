//! What the boards with an STM32H7 share: everything but clocks, pins and memory map.
//!
//! ```text
//! TIM8, ADC1, DMA1, DMA2 ─ scan ─┐
//!                                ├─> acquire (interrupt executor, CEC) ─> frame queue ─> infer (thread executor)
//! SPI1, DMA2 ─ accelerometers ───┘                                                       │
//! FDCAN1 <─ transmit (interrupt executor, CEC) <─ messages <─────────────────────────────┤
//! FDCAN1 ─> receive (interrupt executor, CEC) ─> services (thread executor) <─> flash    │
//! watchdog <─ supervisor, if all four moved on <─────────────────────────────────────────┘
//! ```
//!
//! The services share the thread executor with inference: one begins only when the other waits. So a request delays a
//! decision by at most what the services do between two waits, which is one frame taken in and answered, and a frame
//! delays an answer by at most one step of the pipeline.
//!
//! **Nothing of it has run on hardware.**
//!
//! | interrupt | priority | who |
//! |---|---|---|
//! | FDCAN1_IT0, FDCAN1_IT1, FLASH, TIM2 (time), DMA2_STREAM0, DMA2_STREAM1 (SPI1) | 0 | embassy's drivers |
//! | DMA1_STREAM0 (a frame's conversions are complete) | 5 | scan |
//! | CEC (its peripheral is unused) | 6 | executor of acquisition, transmission and reception |
//! | thread mode | below all | executor of inference and services |
//!
//! Without a readable model the node does not stop: it reports the reason over defmt, lights the red LED
//! and goes on sending slip messages, flagged NO_MODEL.

pub mod accelerometers;
mod can;
mod flash;
mod flash_word;
mod installed;
pub mod memory;
mod model;
mod panic;
mod pins;
pub mod scan;
mod sensors;
mod services;
mod updates;
mod watchdog;

use defmt::{Display2Format, error, info, unwrap, warn};
use defmt_rtt as _;
use embassy_executor::{Executor, InterruptExecutor};
use embassy_stm32::can::CanRx;
use embassy_stm32::gpio::{AnyPin, Level, Output, Speed};
use embassy_stm32::interrupt;
use embassy_stm32::interrupt::{InterruptExt, Priority};
use embassy_stm32::{Peri, peripherals};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::zerocopy_channel::{Channel, Receiver, Sender};
use embassy_time::Instant;
use slipsense::board::{Clock, SensedFrame};
use slipsense::health;
use slipsense::health::CanState;
use slipsense::health::SensorHealth;
use slipsense::net::Model;
use slipsense::params::{FRAME_RATE_HZ, MAX_SENSORS};
use slipsense::pipeline::{FrameStamp, Pipeline, State};
use slipsense::tasks::{
    self, Controls, Inference, QUEUED_FRAMES, RAW_MESSAGES, RawQueue, Shared, Supervisor, Task, Transmission,
};
use slipsense::wire::{NodeId, RawTransfer, SensorContact, SlipMessage, Transmitter};
use static_cell::StaticCell;

use can::CanBus;
use flash::Parts;
use memory::axi_sram_slot;
pub(crate) use pins::nucleo_144;
use sensors::BoardSensors;
use services::BoardServices;
use updates::Updates;
use watchdog::Watchdog;

/// The higher executor: a tick preempts inference. HDMI-CEC is unused, so its interrupt is free.
static ACQUISITION: InterruptExecutor = InterruptExecutor::new();
static INFERENCE: StaticCell<Executor> = StaticCell::new();

type Mutex = CriticalSectionRawMutex;
type BoardInference = Inference<'static, Mutex, Uptime, (), &'static mut State>;
type RawSender = Sender<'static, Mutex, RawTransfer>;

/// What the tasks share; registers and heartbeat read it.
static SHARED: Shared<Mutex> = Shared::new();
static RAW_QUEUE: StaticCell<RawQueue<'static, Mutex>> = StaticCell::new();

static FRAME_QUEUE: StaticCell<Channel<'static, Mutex, SensedFrame>> = StaticCell::new();
axi_sram_slot! {
    /// What the frame queue lends out.
    FRAME_BUFFERS: [SensedFrame; QUEUED_FRAMES]
}
axi_sram_slot! {
    /// What the queue of raw messages lends out.
    RAW_BUFFERS: [RawTransfer; RAW_MESSAGES]
}
axi_sram_slot! {
    /// The drivers and what they remember; DTCM is for the model.
    SOURCE: BoardSensors
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

/// Pins and peripherals in use: `docs/src/board/wiring.md` says what is behind them.
pub struct Hardware {
    /// As on the label.
    pub board: &'static str,
    /// Red.
    pub fault_led: Peri<'static, AnyPin>,
    /// The bus.
    pub fdcan: Peri<'static, peripherals::FDCAN1>,
    /// From the transceiver.
    pub can_rx: Peri<'static, peripherals::PD0>,
    /// To the transceiver.
    pub can_tx: Peri<'static, peripherals::PD1>,
    /// Settings and updates.
    pub flash: Peri<'static, peripherals::FLASH>,
    /// Whoever does not feed it is reset.
    pub watchdog: Peri<'static, peripherals::IWDG1>,
    /// Taxels.
    pub scan: scan::Hardware,
    /// Accelerometers.
    pub accelerometers: accelerometers::Hardware,
}

/// Run the firmware on a chip whose memory and clocks are set up.
pub fn run(hardware: Hardware) -> ! {
    let Tasks { transmit: (can, raw), receive: can_rx, acquire: (source, sender), infer: parts, services } =
        make(hardware);
    let (node, receiver, watchdog) = parts;
    // Below the drivers' interrupts, which default to the highest priority.
    interrupt::CEC.set_priority(Priority::P6);
    let spawner = ACQUISITION.start(interrupt::CEC);
    spawner.spawn(unwrap!(transmit(can, raw)));
    spawner.spawn(unwrap!(receive(can_rx)));
    spawner.spawn(unwrap!(acquire(source, sender)));
    INFERENCE.init(Executor::new()).run(|spawner| {
        spawner.spawn(unwrap!(infer(node, receiver, watchdog)));
        spawner.spawn(unwrap!(serve(services)));
    })
}

/// What each task starts with.
struct Tasks {
    transmit: (CanBus, Receiver<'static, Mutex, RawTransfer>),
    receive: CanRx<'static>,
    acquire: (&'static mut BoardSensors, Sender<'static, Mutex, SensedFrame>),
    infer: (Node, Receiver<'static, Mutex, SensedFrame>, Watchdog),
    services: &'static mut BoardServices,
}

/// Apart from [`run`], which never ends: what this takes of the stack is given back.
#[inline(never)]
fn make(hardware: Hardware) -> Tasks {
    let panic = panic::take();
    if let Some(record) = panic {
        error!("restarted after {}", Display2Format(&record));
    }
    let flash = Parts::of(hardware.flash);
    let (store, settings, loaded) = services::load(flash);
    let sensors = settings.sensors();
    info!(
        "slipsense {=str}, {=str}, {=u32} Hz, {=usize} sensors with {=str}; {}",
        env!("CARGO_PKG_VERSION"),
        hardware.board,
        FRAME_RATE_HZ,
        sensors,
        accelerometers::PART.name,
        Display2Format(&loaded)
    );

    let (_, data_bit_rate) = settings.bit_rates();
    let (can, can_rx, inbox) = CanBus::start(hardware.fdcan, hardware.can_rx, hardware.can_tx, data_bit_rate);
    let (raw_sender, raw_receiver) = RAW_QUEUE.init(RawQueue::new(raw_buffers())).split();
    SHARED.control(Controls::of(&settings, settings.node_id()));
    let (model, from) = installed::find(flash);
    let node = build(model, raw_sender, sensors);
    let model_hash = match &node {
        Node::Whole(inference) => Some(inference.pipeline.model().hash),
        Node::WithoutModel(_) => None,
    };
    let led = Output::new(hardware.fault_led, Level::from(model_hash.is_none()), Speed::Low);

    let (sender, receiver) = FRAME_QUEUE.init(Channel::new(frame_buffers())).split();
    let source = sense(hardware.scan, hardware.accelerometers, sensors, settings.sensor_order());
    let updates = Updates::find(flash, from);
    let services = services::build(store, settings, loaded, updates, model_hash, inbox, led, panic);
    let watchdog = Watchdog::start(hardware.watchdog);
    Tasks {
        transmit: (can, raw_receiver),
        receive: can_rx,
        acquire: (source, sender),
        infer: (node, receiver, watchdog),
        services,
    }
}

/// Apart, as [`sense`]: what these buffers take of the stack before they are in AXI SRAM would never be given back.
#[inline(never)]
fn raw_buffers() -> &'static mut [RawTransfer] {
    unwrap!(RAW_BUFFERS.take()).write([const { RawTransfer::new() }; RAW_MESSAGES])
}

/// Apart, as [`raw_buffers`].
#[inline(never)]
fn frame_buffers() -> &'static mut [SensedFrame] {
    unwrap!(FRAME_BUFFERS.take()).write([const { SensedFrame::new() }; QUEUED_FRAMES])
}

/// Apart, so that what it takes of the stack is gone when the executor runs.
#[inline(never)]
fn sense(
    scan: scan::Hardware,
    accelerometers: accelerometers::Hardware,
    sensors: usize,
    order: [usize; MAX_SENSORS],
) -> &'static mut BoardSensors {
    unwrap!(SOURCE.take()).write(sensors::start(scan, accelerometers, sensors, order))
}

/// What answers to a frame.
enum Node {
    Whole(&'static mut BoardInference),
    /// So many sensors wait for one.
    WithoutModel(usize),
}

/// Make the pipeline, or report why there is none. Apart, as [`sense`].
///
/// In two steps, one after the other, so that what parsing takes of the stack is gone when the pipeline is made.
#[inline(never)]
fn build(model: &'static [u8], raw: RawSender, sensors: usize) -> Node {
    match Model::parse(model) {
        Ok(model) => place(model, raw, sensors),
        Err(error) => {
            error!("model: {}", Display2Format(&error));
            Node::WithoutModel(sensors)
        }
    }
}

/// On a state that is made where it stays, in AXI SRAM.
#[inline(never)]
fn place(model: Model<'static>, raw: RawSender, sensors: usize) -> Node {
    let pipeline = match Pipeline::within(model::first_state(), model, sensors) {
        Ok(pipeline) => pipeline,
        Err(error) => {
            error!("pipeline: {}", Display2Format(&error));
            return Node::WithoutModel(sensors);
        }
    };
    let transmitter = Transmitter::new(NodeId::DEFAULT);
    Node::Whole(PIPELINE.init(Inference::new(pipeline, transmitter, Uptime, (), &SHARED, raw)))
}

#[embassy_executor::task]
async fn acquire(source: &'static mut BoardSensors, queue: Sender<'static, Mutex, SensedFrame>) {
    tasks::acquire(source, queue, &SHARED).await;
}

#[embassy_executor::task]
async fn transmit(can: CanBus, raw: Receiver<'static, Mutex, RawTransfer>) {
    Transmission::new(can, Uptime, &SHARED, raw).run().await;
}

#[embassy_executor::task]
async fn receive(can: CanRx<'static>) {
    can::receive(can).await;
}

#[embassy_executor::task]
async fn serve(services: &'static mut BoardServices) {
    services.run().await;
    info!("restart");
    cortex_m::peripheral::SCB::sys_reset()
}

#[embassy_executor::task]
async fn infer(mut node: Node, mut queue: Receiver<'static, Mutex, SensedFrame>, mut watchdog: Watchdog) {
    let mut degraded = Transmitter::new(NodeId::DEFAULT);
    let mut supervisor = Supervisor::new(&Task::ALL);
    let mut frames_until_report = FRAME_RATE_HZ;
    loop {
        match &mut node {
            Node::Whole(inference) => inference.serve(&mut queue).await,
            &mut Node::WithoutModel(sensors) => {
                let stamp = queue.receive().await.stamp;
                queue.receive_done();
                SHARED.progress.made(Task::Infer);
                let message = without_model(stamp, sensors);
                SHARED.update_status(|status| {
                    status.sensor_health = message.contact.map(|contact| SensorHealth(contact.health));
                });
                if let Some(node) = SHARED.controls().node {
                    degraded.speak_as(node);
                    SHARED.send_slip(degraded.slip(&message));
                }
            }
        }
        // A task that stands still shows in the log of the restart that the watchdog makes.
        let _ = supervisor.look(&SHARED.progress, &mut watchdog);
        frames_until_report -= 1;
        if frames_until_report == 0 {
            frames_until_report = FRAME_RATE_HZ;
            report(&node);
        }
    }
}

/// Once a second.
fn report(node: &Node) {
    let status = SHARED.status();
    info!(
        "late {=u32}, worst {=u32} us, dropped: frames {=u32}, raw messages {=u32}, slip messages {=u32}",
        status.late_frames,
        status.worst_frame_us,
        status.dropped_frames,
        status.dropped_raw,
        status.replaced_slips
    );
    let sensors = match node {
        Node::Whole(inference) => inference.pipeline.sensors(),
        &Node::WithoutModel(sensors) => {
            error!("no readable model: slip messages carry NO_MODEL");
            sensors
        }
    };
    if status.can.state == CanState::BusOff {
        warn!("the node is off the bus, {=u32} times so far", status.bus_offs);
    }
    sensors::log(sensors);
}

/// What the node can say without a network: the time, and that nothing in it is a decision.
fn without_model(stamp: FrameStamp, sensors: usize) -> SlipMessage {
    let flagged = SensorContact {
        health: health::NO_MODEL | health::PIEZO_MISSING | health::XL_MISSING,
        ..SensorContact::default()
    };
    let mut contact = [SensorContact::default(); MAX_SENSORS];
    contact.iter_mut().take(sensors).for_each(|contact| *contact = flagged);
    let FrameStamp { sequence, timestamp_us } = stamp;
    SlipMessage { timestamp_us, sequence, sensors: sensors as u8, contact, ..SlipMessage::default() }
}
