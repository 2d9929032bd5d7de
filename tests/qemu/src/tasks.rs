//! Start-up and tasks.

use core::cell::RefCell;

use cortex_m_rt::entry;
use embassy_executor::Executor;
use embassy_sync::zerocopy_channel::{Receiver, Sender};
use embassy_time::Instant;
use heapless::Vec;
use slipsense::board::replay::FRAME_BYTES_MAX;
use slipsense::board::{SensorFrame, StoppedClock, UnlimitedBus};
use slipsense::tasks::{Inference, Transmission, acquire};
use slipsense::wire::{CanFrame, RawTransfer, Transmitter};
use slipsense_qemu::OUTPUT_FILE;
use slipsense_qemu::emulated::semihosting::File;
use slipsense_qemu::emulated::{Mutex, SHARED, exit, pipeline, queues, read_input, start};
use slipsense_qemu::record::Record;

use static_cell::StaticCell;

use crate::board::{Recorded, Recorder, Recording};

/// Cycles of the board's timers per microsecond.
const TIMER_TICKS_PER_US: u32 = 25;

type EmulatedInference = Inference<'static, Mutex, StoppedClock, Recorded>;

static EXECUTOR: StaticCell<Executor> = StaticCell::new();
static RECORDING: StaticCell<Recording> = StaticCell::new();
static RECORDER: StaticCell<critical_section::Mutex<RefCell<Recorder>>> = StaticCell::new();
static INFERENCE: StaticCell<EmulatedInference> = StaticCell::new();

#[embassy_executor::task]
async fn acquisition(recording: &'static mut Recording, queue: Sender<'static, Mutex, SensorFrame>) {
    acquire(recording, queue, &SHARED).await;
}

#[embassy_executor::task]
async fn transmission(recorded: Recorded, raw: Receiver<'static, Mutex, RawTransfer>) {
    let bus = UnlimitedBus(|_, frame: &CanFrame| recorded.send(frame));
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
    let recorder = Recorded(RECORDER.init(critical_section::Mutex::new(RefCell::new(Recorder {
        file: File::create(OUTPUT_FILE),
        began: Instant::MIN,
        record: Record::default(),
        encoded: Vec::new(),
    }))));
    let ((sender, receiver), (raw_sender, raw_receiver)) = queues();
    let infer = INFERENCE.init(Inference::new(
        pipeline(&header, model),
        Transmitter::new(header.node),
        StoppedClock,
        recorder,
        &SHARED,
        raw_sender,
    ));
    let recording = Recording { file, header, read: 0, record: [0; FRAME_BYTES_MAX] };
    let recording = RECORDING.init(recording);
    let frames = header.frames;
    let spawner = start(TIMER_TICKS_PER_US);
    spawner.spawn(transmission(recorder, raw_receiver).expect("spawned once"));
    spawner.spawn(acquisition(recording, sender).expect("spawned once"));
    EXECUTOR
        .init(Executor::new())
        .run(|spawner| spawner.spawn(inference(infer, receiver, frames).expect("spawned once")))
}
