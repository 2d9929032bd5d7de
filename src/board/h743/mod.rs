//! NUCLEO-H743ZI2 (STM32H743ZI, silicon revision V): the wiring, and the entry point of the firmware.
//!
//! **A skeleton.** The drivers of the taxel array and of the accelerometer are not written yet. The frame
//! source ticks at 240 Hz and delivers frames in which every part of every sensor is missing, so the bus
//! carries slip messages at 240 Hz whose health bytes say PIEZO_MISSING and XL_MISSING. Everything behind
//! the source (pipeline, messages, FDCAN, watchdog, both executors) is what the product runs. Nothing here
//! ran on a board so far.
//!
//! ```text
//! TIM2 ─> acquire (interrupt executor, CEC) ─> FRAMES ─> infer (thread executor) ─> pipeline ─> FDCAN1
//!                                                         └─> watchdog, fed if both moved on
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
use embassy_stm32::gpio::{Level, Output, Speed};
use embassy_stm32::interrupt;
use embassy_stm32::interrupt::{InterruptExt, Priority};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::channel::Channel;
use panic_probe as _;
use slipsense::net::Model;
use slipsense::params::{FRAME_RATE_HZ, MAX_SENSORS};
use slipsense::pipeline::{FrameStamp, Pipeline};
use slipsense::wire::{NodeId, SensorContact, SlipMessage, Transmitter, health};
use static_cell::StaticCell;

use can::CanBus;
use sensors::AbsentSensors;
use watchdog::Watchdog;

/// Fingertips behind this board.
const SENSORS: usize = 1;
const _: () = assert!(SENSORS >= 1 && SENSORS <= MAX_SENSORS);

/// The network, as trained and quantized.
static MODEL: &[u8] = include_bytes!(concat!(env!("CARGO_MANIFEST_DIR"), "/model/weights/slipsense.slipnet"));

/// Above it, acquisition: a tick preempts inference. The CEC interrupt is free, HDMI-CEC being unused.
static ACQUISITION: InterruptExecutor = InterruptExecutor::new();
static INFERENCE: StaticCell<Executor> = StaticCell::new();

/// Frames that wait for inference. A full queue drops the newest; its sequence number is then missing.
static FRAMES: Channel<CriticalSectionRawMutex, FrameStamp, 4> = Channel::new();
/// Frames closed so far, wraps.
static FRAMES_ACQUIRED: AtomicU32 = AtomicU32::new(0);

/// # Safety
/// Called by the hardware only, which `main` starts after the executor is ready.
#[interrupt]
unsafe fn CEC() {
    // SAFETY: this is the interrupt that the executor was started with, at one priority.
    unsafe { ACQUISITION.on_interrupt() }
}

#[entry]
fn main() -> ! {
    let mut core = unwrap!(cortex_m::Peripherals::take());
    memory::init(&mut core);
    let chip = embassy_stm32::init(clocks::config());
    info!("slipsense {=str} on STM32H743, {=u32} Hz frames", env!("CARGO_PKG_VERSION"), FRAME_RATE_HZ);

    let pipeline = build_pipeline();
    let fault_level = if pipeline.is_none() { Level::High } else { Level::Low };
    // LD3, red. Leaked on purpose: dropping it would release the pin.
    core::mem::forget(Output::new(chip.PB14, fault_level, Speed::Low));

    let can = unwrap!(CanBus::start(chip.FDCAN1, chip.PD0, chip.PD1));
    let watchdog = Watchdog::start(chip.IWDG1);

    // Below the drivers' interrupts, which default to the highest priority.
    interrupt::CEC.set_priority(Priority::P6);
    ACQUISITION.start(interrupt::CEC).spawn(unwrap!(acquire(AbsentSensors::start())));
    INFERENCE.init(Executor::new()).run(|spawner| spawner.spawn(unwrap!(infer(pipeline, can, watchdog))))
}

/// The pipeline in its place, or `None` after the reason was reported.
///
/// Not inlined: the pipeline passes through this function's stack frame, which must not stay.
#[inline(never)]
fn build_pipeline() -> Option<&'static mut Pipeline<'static>> {
    let model = match Model::parse(MODEL) {
        Ok(model) => model,
        Err(error) => {
            error!("model of {=usize} bytes: {}", MODEL.len(), Display2Format(&error));
            return None;
        }
    };
    match Pipeline::new(model, SENSORS) {
        Ok(pipeline) => Some(memory::pipeline_slot()?.write(pipeline)),
        Err(error) => {
            error!("{}", Display2Format(&error));
            None
        }
    }
}

#[embassy_executor::task]
async fn acquire(mut source: AbsentSensors) {
    loop {
        let stamp = source.next_frame().await;
        FRAMES_ACQUIRED.fetch_add(1, Ordering::Relaxed);
        // A refused frame shows as a gap in the sequence numbers on the bus.
        let _ = FRAMES.try_send(stamp);
    }
}

#[embassy_executor::task]
async fn infer(
    mut pipeline: Option<&'static mut Pipeline<'static>>,
    mut can: CanBus,
    mut watchdog: Watchdog,
) {
    let mut transmitter = Transmitter::new(NodeId::DEFAULT);
    let mut late_frames = 0u16;
    let mut unsent_frames = 0u32;
    loop {
        let stamp = FRAMES.receive().await;
        let message = match &mut pipeline {
            Some(pipeline) => pipeline.step(&AbsentSensors::INPUTS).slip_message(stamp, late_frames),
            None => without_model(stamp, late_frames),
        };
        if can.send(&transmitter.slip(&message)).is_err() {
            unsent_frames = unsent_frames.saturating_add(1);
        }
        if !FRAMES.is_empty() {
            late_frames = late_frames.saturating_add(1);
        }
        watchdog.feed(FRAMES_ACQUIRED.load(Ordering::Relaxed));
        if stamp.sequence.is_multiple_of(FRAME_RATE_HZ) {
            info!("frame {=u32}, late {=u16}, unsent {=u32}", stamp.sequence, late_frames, unsent_frames);
            if can.is_off() {
                warn!("the node is off the bus");
            }
        }
    }
}

/// What the node can say without a network: the time, and that nothing in it is a decision.
fn without_model(stamp: FrameStamp, late_frames: u16) -> SlipMessage {
    let flagged = SensorContact {
        health: health::NO_MODEL | health::PIEZO_MISSING | health::XL_MISSING,
        ..SensorContact::default()
    };
    let mut contact = [SensorContact::default(); MAX_SENSORS];
    contact[..SENSORS].fill(flagged);
    SlipMessage {
        timestamp_us: stamp.timestamp_us,
        sequence: stamp.sequence,
        late_frames,
        sensors: SENSORS as u8,
        contact,
        ..SlipMessage::default()
    }
}
