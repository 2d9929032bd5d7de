//! Start-up and tasks: acquisition and transmission on an interrupt executor, inference in thread mode.

use cortex_m_rt::entry;
use embassy_executor::Executor;
use embassy_sync::zerocopy_channel::{Receiver, Sender};
use embassy_time::{Instant, Timer};
use slipsense::board::SensorFrame;
use slipsense::board::replay::FRAME_BYTES_MAX;
use slipsense::health::CanStatus;
use slipsense::tasks::{Inference, Transmission, acquire};
use slipsense::wire::Transmitter;
use slipsense_can_sim::controller::{Bus, Timing};
use slipsense_qemu::emulated::semihosting::File;
use slipsense_qemu::emulated::{Mutex, SHARED, exit, pipeline, queues, read_input, start};
use slipsense_qemu::events::{
    ARRIVED_FILE, BUS_FILE, Counters, DECIDED_FILE, DISTURBANCE_BYTES, INSTRUCTIONS_PER_US, START_US,
    STATUS_FILE, decode_disturbance,
};
use static_cell::StaticCell;

use crate::board::{FrameBuffer, Frames, Hardware, Log, Sensors, Uptime};

/// An instruction takes 2 ns of the emulator's clock, and the timers count every 40 ns of it: 20 instructions. So they
/// count 24 times while a core at 480 MHz does 480 instructions at one per cycle, which is what a microsecond is here.
const TIMER_TICKS_PER_US: u32 = (INSTRUCTIONS_PER_US / 20) as u32;
/// Idle instructions at a time.
const IDLE_CYCLES: u32 = 900;
/// After the last tick: time for what is under way.
const AFTERWARDS_MS: u64 = 50;

type EmulatedInference = Inference<'static, Mutex, Uptime, Frames>;
type EmulatedTransmission = Transmission<'static, Mutex, Hardware, Uptime>;

static EXECUTOR: StaticCell<Executor> = StaticCell::new();
static SENSORS: StaticCell<Sensors> = StaticCell::new();
static INFERENCE: StaticCell<EmulatedInference> = StaticCell::new();
static TRANSMISSION: StaticCell<EmulatedTransmission> = StaticCell::new();

#[embassy_executor::task]
async fn acquisition(sensors: &'static mut Sensors, queue: Sender<'static, Mutex, SensorFrame>) {
    acquire(sensors, queue, &SHARED).await;
}

#[embassy_executor::task]
async fn transmission(transmission: &'static mut EmulatedTransmission, until: Instant) {
    embassy_futures::select::select(transmission.run(), Timer::at(until)).await;
    transmission.bus.log.flush();
    let counters = Counters::new(&SHARED.status(), transmission.waiting_raw());
    File::create(STATUS_FILE).write_all(bytemuck::bytes_of(&counters));
}

#[embassy_executor::task]
async fn inference(
    inference: &'static mut EmulatedInference,
    queue: Receiver<'static, Mutex, SensorFrame>,
    until: Instant,
) {
    embassy_futures::select::select(inference.run(queue), Timer::at(until)).await;
    inference.observer.log.flush();
    exit(true)
}

/// Passes the time when nothing else does, and adds up to 2 µs to the wait of what wakes meanwhile. The executor's own
/// way to wait is WFE, at which this emulator does not stop: it would leave its translated code at every turn of an
/// idle loop, which takes it ten times as long as everything else.
#[embassy_executor::task]
async fn idle() {
    loop {
        cortex_m::asm::delay(IDLE_CYCLES);
        embassy_futures::yield_now().await;
    }
}

#[entry]
fn main() -> ! {
    let (file, header, model) = read_input();
    let pipeline = pipeline(&header, model);
    let mut disturbance = [0; DISTURBANCE_BYTES];
    File::open(BUS_FILE).and_then(|mut file| file.read_exact(&mut disturbance)).expect("a disturbance");
    let disturbance = decode_disturbance(disturbance);
    // Kernel clock of the boards' FDCAN, 1 and 8 Mbit/s.
    let timing = Timing::new(80_000_000, 1_000_000, 8_000_000).expect("whole quanta");

    let ((sender, receiver), (raw_sender, raw_receiver)) = queues();
    let frames = Frames { log: Log::new(File::create(DECIDED_FILE)), queued_us: 0 };
    let transmitter = Transmitter::new(header.node);
    let infer = INFERENCE.init(Inference::new(pipeline, transmitter, Uptime, frames, &SHARED, raw_sender));
    let hardware = Hardware {
        bus: Bus::new(&timing, disturbance),
        log: Log::new(File::create(ARRIVED_FILE)),
        looked_ns: 0,
        seen: ([true; 3], CanStatus::default()),
    };
    let transmit = TRANSMISSION.init(Transmission::new(hardware, Uptime, &SHARED, raw_receiver));
    let last_tick_us = START_US + u64::from(header.frames) * 1_000_000 / 240;
    let sensors = SENSORS.init(Sensors { file, header, read: 0, record: FrameBuffer([0; FRAME_BYTES_MAX]) });

    let transmit_until = Instant::from_micros(last_tick_us + 1000 * AFTERWARDS_MS);
    let infer_until = Instant::from_micros(last_tick_us + 2000 * AFTERWARDS_MS);
    let spawner = start(TIMER_TICKS_PER_US);
    spawner.spawn(transmission(transmit, transmit_until).expect("spawned once"));
    spawner.spawn(acquisition(sensors, sender).expect("spawned once"));
    EXECUTOR.init(Executor::new()).run(|spawner| {
        spawner.spawn(inference(infer, receiver, infer_until).expect("spawned once"));
        spawner.spawn(idle().expect("spawned once"));
    })
}
