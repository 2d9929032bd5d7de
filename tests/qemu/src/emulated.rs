//! Start-up, tasks and interrupts.

use core::cell::RefCell;

use cortex_m_rt::{entry, exception};
use cortex_m_semihosting::debug;
use embassy_executor::{Executor, InterruptExecutor};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::zerocopy_channel::{Channel, Receiver, Sender};
use embassy_time::Instant;
use heapless::Vec;
use panic_semihosting as _;
use slipsense::board::replay::FRAME_BYTES_MAX;
use slipsense::board::{SensedFrame, StoppedClock};
use slipsense::net::{Aligned, Model};
use slipsense::pipeline::Pipeline;
use slipsense::tasks::{
    Controls, Inference, QUEUED_FRAMES, RAW_MESSAGES, RawQueue, Shared, Transmission, acquire,
};
use slipsense::wire::{RawTransfer, Transmitter};
use slipsense_qemu::input::{HEADER_BYTES, Header, MODEL_BYTES_MAX};
use slipsense_qemu::record::Record;
use slipsense_qemu::{INPUT_FILE, OUTPUT_FILE};
use static_cell::{ConstStaticCell, StaticCell};

use crate::board::{Recorded, Recorder, Recording};
use crate::semihosting::File;
use crate::time_driver::{ALARM_IRQ, COUNTER_IRQ, Irq, time};

/// A line that no device of the board drives: acquisition and transmission run in its handler.
const ACQUISITION_IRQ: Irq = Irq(31);
const TIME_PRIORITY: u8 = 0x20;
const ACQUISITION_PRIORITY: u8 = 0x60;

/// Cycles of the board's timers per microsecond.
const TIMER_TICKS_PER_US: u32 = 25;

type Mutex = CriticalSectionRawMutex;
type FrameQueue = Channel<'static, Mutex, SensedFrame>;
type EmulatedInference = Inference<'static, Mutex, StoppedClock, Recorded>;

static ACQUISITION: InterruptExecutor = InterruptExecutor::new();
static EXECUTOR: StaticCell<Executor> = StaticCell::new();
static BUFFERS: ConstStaticCell<[SensedFrame; QUEUED_FRAMES]> =
    ConstStaticCell::new([const { SensedFrame::new() }; QUEUED_FRAMES]);
static QUEUE: StaticCell<FrameQueue> = StaticCell::new();
static MODEL: ConstStaticCell<Aligned<[u8; MODEL_BYTES_MAX]>> =
    ConstStaticCell::new(Aligned([0; MODEL_BYTES_MAX]));
static SHARED: Shared<Mutex> = Shared::new();
static RAW_BUFFERS: ConstStaticCell<[RawTransfer; RAW_MESSAGES]> =
    ConstStaticCell::new([const { RawTransfer::new() }; RAW_MESSAGES]);
static RAW_QUEUE: StaticCell<RawQueue<'static, Mutex>> = StaticCell::new();
static RECORDING: StaticCell<Recording> = StaticCell::new();
static RECORDER: StaticCell<critical_section::Mutex<RefCell<Recorder>>> = StaticCell::new();
static INFERENCE: StaticCell<EmulatedInference> = StaticCell::new();

#[exception]
unsafe fn DefaultHandler(irq: i16) {
    match irq as u16 {
        n if n == COUNTER_IRQ.0 => time().on_counter(),
        n if n == ALARM_IRQ.0 => time().on_alarm(),
        // SAFETY: this is the handler of the line that the executor was started with.
        n if n == ACQUISITION_IRQ.0 => unsafe { ACQUISITION.on_interrupt() },
        _ => panic!("interrupt {irq} was never enabled"),
    }
}

#[embassy_executor::task]
async fn acquisition(recording: &'static mut Recording, queue: Sender<'static, Mutex, SensedFrame>) {
    acquire(recording, queue, &SHARED).await;
}

#[embassy_executor::task]
async fn transmission(bus: Recorded, raw: Receiver<'static, Mutex, RawTransfer>) {
    Transmission::new(bus, StoppedClock, &SHARED, raw).run().await;
}

#[embassy_executor::task]
async fn inference(
    inference: &'static mut EmulatedInference,
    mut queue: Receiver<'static, Mutex, SensedFrame>,
    frames: u32,
) {
    for _ in 0..frames {
        inference.serve(&mut queue).await;
    }
    // The host closes the files when the emulator ends.
    debug::exit(debug::EXIT_SUCCESS);
}

#[entry]
fn main() -> ! {
    let mut file = open(INPUT_FILE, File::open);
    let mut header = [0; HEADER_BYTES];
    file.read_exact(&mut header).expect("the input file has a header");
    let header = Header::decode(&header).expect("the input file is one for this program");
    let (model, _) = MODEL.take().0.split_at_mut(header.model_bytes as usize);
    file.read_exact(model).expect("the input file holds a model");
    let model = Model::parse(model).expect("the model is valid");
    let pipeline = Pipeline::new(model, header.sensors as usize).expect("the header was checked");

    SHARED.control(Controls { compress_raw: header.compress_raw, ..Controls::DEFAULT });
    let recorder = Recorded(RECORDER.init(critical_section::Mutex::new(RefCell::new(Recorder {
        file: open(OUTPUT_FILE, File::create),
        began: Instant::MIN,
        record: Record::default(),
        encoded: Vec::new(),
    }))));
    let (raw_sender, raw_receiver) = RAW_QUEUE.init(RawQueue::new(RAW_BUFFERS.take())).split();
    let infer = INFERENCE.init(Inference::new(
        pipeline,
        Transmitter::new(header.node),
        StoppedClock,
        recorder,
        &SHARED,
        raw_sender,
    ));
    let recording = Recording { file, header, read: 0, record: [0; FRAME_BYTES_MAX] };
    let recording = RECORDING.init(recording);
    let (sender, receiver) = QUEUE.init(Channel::new(BUFFERS.take())).split();

    time().init(TIMER_TICKS_PER_US);
    let mut core = cortex_m::Peripherals::take().expect("taken once");
    // SAFETY: all critical sections of this program mask every priority.
    unsafe {
        core.NVIC.set_priority(COUNTER_IRQ, TIME_PRIORITY);
        core.NVIC.set_priority(ALARM_IRQ, TIME_PRIORITY);
        core.NVIC.set_priority(ACQUISITION_IRQ, ACQUISITION_PRIORITY);
    }
    let frames = header.frames;
    let spawner = ACQUISITION.start(ACQUISITION_IRQ);
    spawner.spawn(transmission(recorder, raw_receiver).expect("spawned once"));
    spawner.spawn(acquisition(recording, sender).expect("spawned once"));
    EXECUTOR
        .init(Executor::new())
        .run(|spawner| spawner.spawn(inference(infer, receiver, frames).expect("spawned once")))
}

fn open(name: &str, how: fn(&core::ffi::CStr) -> Option<File>) -> File {
    let mut with_end = Vec::<u8, 32>::new();
    with_end.extend_from_slice(name.as_bytes()).expect("a short name");
    with_end.push(0).expect("a short name");
    let name = core::ffi::CStr::from_bytes_with_nul(&with_end).expect("no zero byte inside");
    how(name).unwrap_or_else(|| panic!("cannot open {name:?} in the emulator's working directory"))
}
