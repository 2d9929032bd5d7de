//! Start-up and tasks.

use core::cell::RefCell;

use cortex_m_rt::entry;
use embassy_executor::Executor;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::zerocopy_channel::{Channel, Receiver, Sender};
use embassy_time::Instant;
use heapless::Vec;
use slipsense::board::replay::FRAME_BYTES_MAX;
use slipsense::board::{SensorFrame, StoppedClock};
use slipsense::pipeline::Pipeline;
use slipsense::tasks::{
    Inference, QUEUED_FRAMES, RAW_MESSAGES, RawQueue, RuntimeConfig, Shared, Transmission, acquire,
};
use slipsense::wire::{RawTransfer, Transmitter};
use slipsense_qemu::OUTPUT_FILE;
use slipsense_qemu::emulated::semihosting::File;
use slipsense_qemu::emulated::{exit, read_input, start};
use slipsense_qemu::record::Record;

use static_cell::{ConstStaticCell, StaticCell};

use crate::board::{Recorded, Recorder, Recording};

/// Cycles of the board's timers per microsecond.
const TIMER_TICKS_PER_US: u32 = 25;

type Mutex = CriticalSectionRawMutex;
type FrameQueue = Channel<'static, Mutex, SensorFrame>;
type EmulatedInference = Inference<'static, Mutex, StoppedClock, Recorded>;

static EXECUTOR: StaticCell<Executor> = StaticCell::new();
static BUFFERS: ConstStaticCell<[SensorFrame; QUEUED_FRAMES]> =
    ConstStaticCell::new([const { SensorFrame::new() }; QUEUED_FRAMES]);
static QUEUE: StaticCell<FrameQueue> = StaticCell::new();
static SHARED: Shared<Mutex> = Shared::new();
static RAW_BUFFERS: ConstStaticCell<[RawTransfer; RAW_MESSAGES]> =
    ConstStaticCell::new([const { RawTransfer::new() }; RAW_MESSAGES]);
static RAW_QUEUE: StaticCell<RawQueue<'static, Mutex>> = StaticCell::new();
static RECORDING: StaticCell<Recording> = StaticCell::new();
static RECORDER: StaticCell<critical_section::Mutex<RefCell<Recorder>>> = StaticCell::new();
static INFERENCE: StaticCell<EmulatedInference> = StaticCell::new();

#[embassy_executor::task]
async fn acquisition(recording: &'static mut Recording, queue: Sender<'static, Mutex, SensorFrame>) {
    acquire(recording, queue, &SHARED).await;
}

#[embassy_executor::task]
async fn transmission(bus: Recorded, raw: Receiver<'static, Mutex, RawTransfer>) {
    Transmission::new(bus, StoppedClock, &SHARED, raw).run().await;
}

#[embassy_executor::task]
async fn inference(
    inference: &'static mut EmulatedInference,
    mut queue: Receiver<'static, Mutex, SensorFrame>,
    frames: u32,
) {
    for _ in 0..frames {
        inference.serve(&mut queue).await;
    }
    exit(true)
}

#[entry]
fn main() -> ! {
    let (file, header, model) = read_input();
    let pipeline = Pipeline::new(model, header.sensors as usize).expect("the header was checked");

    SHARED.set_config(RuntimeConfig { compress_raw: header.compress_raw, ..RuntimeConfig::DEFAULT });
    let recorder = Recorded(RECORDER.init(critical_section::Mutex::new(RefCell::new(Recorder {
        file: File::create(OUTPUT_FILE),
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

    let frames = header.frames;
    let spawner = start(TIMER_TICKS_PER_US);
    spawner.spawn(transmission(recorder, raw_receiver).expect("spawned once"));
    spawner.spawn(acquisition(recording, sender).expect("spawned once"));
    EXECUTOR
        .init(Executor::new())
        .run(|spawner| spawner.spawn(inference(infer, receiver, frames).expect("spawned once")))
}
