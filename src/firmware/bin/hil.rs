//! The firmware's tasks with a debug probe in place of sensors and bus: the board's side of `slipsense hil`.
//!
//! Clocks, memories, model, pipeline, tasks, executors and their priorities are the firmware's. There is no scan, no
//! accelerometer, no CAN, no setting and no watchdog: frames come through [`slipsense::board::mailbox`], and the CAN
//! frames that they lead to go back the same way. So a bare NUCLEO on its USB cable is all that the test needs.
//! **It has not run on hardware**; it runs on the emulated STM32H743.
#![no_std]
#![no_main]

use core::future::pending;
use core::panic::PanicInfo;
use core::sync::atomic::AtomicU32;

use cortex_m::peripheral::DWT;
use cortex_m_rt::{ExceptionFrame, entry, exception};
use defmt::unwrap;
use defmt_rtt as _;
use embassy_executor::Executor;
use embassy_stm32::interrupt;
use embassy_stm32::interrupt::{InterruptExt, Priority};
use embassy_time::Timer;
use slipsense::board::mailbox::{ANSWER_WORDS, BoardEnd, FRAME_WORDS, Mailbox};
use slipsense::board::replay::{FRAME_BYTES_MAX, decode_parts, decode_stamp};
use slipsense::board::{FrameSource, Observe, StoppedClock, UnlimitedBus};
use slipsense::firmware::shared::{
    ACQUISITION, FrameReceiver, FrameSender, Mutex, RawReceiver, RawSender, SHARED, frame_queue, raw_queue,
};
use slipsense::firmware::{self, model};
use slipsense::net::Model;
use slipsense::params::MAX_SENSORS;
use slipsense::pipeline::{FrameStamp, Output, Pipeline, State};
use slipsense::sensor::SensorReadings;
use slipsense::tasks::{self, Inference, Transmission};
use slipsense::update::partitions::NUCLEO_H743ZI2;
use slipsense::wire::{CanFrame, NodeId, Transmitter};
use static_cell::StaticCell;

/// How often the mailbox is looked at. A real wait on the timer, so that acquisition interrupts inference as in the
/// firmware.
const LOOK_US: u64 = 100;

type HilInference = Inference<'static, Mutex, StoppedClock, Answers, &'static mut State>;

/// Under the name [`slipsense::board::mailbox::SYMBOL`]. In DTCM, which is never cached and has its clock after reset.
#[unsafe(export_name = "SLIPSENSE_MAILBOX")]
static MAILBOX: Mailbox = Mailbox::new();
// In D2 SRAM, which is not cached: what the probe writes there, the core sees, and the other way round.
#[unsafe(link_section = ".sram_d2")]
static FRAME: [AtomicU32; FRAME_WORDS] = [const { AtomicU32::new(0) }; FRAME_WORDS];
#[unsafe(link_section = ".sram_d2")]
static ANSWER: [AtomicU32; ANSWER_WORDS] = [const { AtomicU32::new(0) }; ANSWER_WORDS];
static MAILBOX_END: BoardEnd = BoardEnd::new(&MAILBOX, &FRAME, &ANSWER);

static THREAD: StaticCell<Executor> = StaticCell::new();
static PIPELINE: StaticCell<HilInference> = StaticCell::new();
#[unsafe(link_section = ".axisram")]
static SOURCE: StaticCell<Replayed> = StaticCell::new();
/// # Safety
/// Called by the hardware only, and not before `main` has started the executor.
#[interrupt]
unsafe fn CEC() {
    // SAFETY: this is the interrupt that the executor was started with.
    unsafe { ACQUISITION.on_interrupt() }
}

/// Wait for the host, then answer its frames.
#[entry]
fn main() -> ! {
    let chip = firmware::init();
    let core_hz = embassy_stm32::rcc::clocks(&chip.RCC).sys.to_hertz().map_or(0, |clock| clock.0);
    MAILBOX_END.place((address(&FRAME), address(&ANSWER)), core_hz);
    let model = parsed_model();
    MAILBOX_END.open(&model.hash);
    let sensors = loop {
        if let Some(sensors) = MAILBOX_END.sensors() {
            break sensors;
        }
    };
    let (raw_sender, raw_receiver) = raw_queue();
    let (sender, receiver) = frame_queue();
    let inference = inference(model, sensors, raw_sender);
    let source = SOURCE.init_with(|| Replayed { taken: None, sensors, bytes: [0; FRAME_BYTES_MAX] });

    interrupt::CEC.set_priority(Priority::P6);
    let spawner = ACQUISITION.start(interrupt::CEC);
    spawner.spawn(unwrap!(transmit(raw_receiver)));
    spawner.spawn(unwrap!(acquire(source, sender)));
    THREAD.init(Executor::new()).run(|spawner| spawner.spawn(unwrap!(infer(inference, receiver))))
}

/// Apart, as what follows: what this takes of the stack is given back.
#[inline(never)]
fn parsed_model() -> Model<'static> {
    match Model::parse(model::built_in(model::buffer())) {
        Ok(model) => model,
        Err(error) => give_up(format_args!("{}: model: {error}", NUCLEO_H743ZI2.label)),
    }
}

#[inline(never)]
fn inference(model: Model<'static>, sensors: usize, raw: RawSender) -> &'static mut HilInference {
    let pipeline = match Pipeline::with_state(model::first_state(), model, sensors) {
        Ok(pipeline) => pipeline,
        Err(error) => give_up(format_args!("{}: {error}", NUCLEO_H743ZI2.label)),
    };
    let transmitter = Transmitter::new(NodeId::DEFAULT);
    PIPELINE.init(Inference::new(pipeline, transmitter, StoppedClock, Answers { began: 0 }, &SHARED, raw))
}

/// Where the host finds it.
fn address<const N: usize>(words: &'static [AtomicU32; N]) -> u32 {
    words.as_ptr().addr() as u32
}

#[embassy_executor::task]
async fn acquire(source: &'static mut Replayed, queue: FrameSender) {
    tasks::acquire(source, queue, &SHARED).await;
}

#[embassy_executor::task]
async fn transmit(raw: RawReceiver) {
    let bus = UnlimitedBus(|_, frame: &CanFrame| MAILBOX_END.sent(frame));
    Transmission::new(bus, StoppedClock, &SHARED, raw).run().await;
}

#[embassy_executor::task]
async fn infer(inference: &'static mut HilInference, queue: FrameReceiver) {
    inference.run(queue).await;
}

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
            match MAILBOX_END.waiting() {
                Some(number) if self.taken != Some(number) => break number,
                _ => Timer::after_micros(LOOK_US).await,
            }
        };
        self.taken = Some(number);
        MAILBOX_END.take(&mut self.bytes);
        decode_stamp(&self.bytes)
    }

    async fn read(&mut self, parts: &mut [SensorReadings; MAX_SENSORS]) {
        let parts = parts.get_mut(..self.sensors);
        if parts.and_then(|parts| decode_parts(&self.bytes, parts)).is_none() {
            MAILBOX_END.fail(format_args!("frame {}: no frame", self.taken.unwrap_or_default()));
            pending().await
        }
    }
}

/// Ends each frame's answer.
struct Answers {
    /// The cycle in which the pipeline took the frame. The core counts them since the check of its clock.
    began: u32,
}

impl Observe for Answers {
    fn step_begins(&mut self, _stamp: FrameStamp) {
        self.began = DWT::cycle_count();
    }

    fn step_ends(&mut self, _stamp: FrameStamp, _output: &Output) {
        MAILBOX_END.took(DWT::cycle_count().wrapping_sub(self.began));
    }

    /// Transmission interrupts inference as soon as there is something to send, so all of it has gone by now.
    fn frame_done(&mut self, _stamp: FrameStamp) {
        MAILBOX_END.answered();
    }
}

/// Tell the host why, and stand still until the next reset.
fn give_up(why: core::fmt::Arguments<'_>) -> ! {
    cortex_m::interrupt::disable();
    MAILBOX_END.fail(why);
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
