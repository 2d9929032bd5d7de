//! Start-up, tasks and interrupts: acquisition and transmission on an interrupt executor, inference in thread mode.

use cortex_m_rt::{entry, exception};
use cortex_m_semihosting::debug;
use embassy_executor::{Executor, InterruptExecutor};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::zerocopy_channel::{Channel, Receiver, Sender};
use embassy_time::{Instant, Timer};
use heapless::Vec;
use panic_semihosting as _;
use slipsense::board::replay::FRAME_BYTES_MAX;
use slipsense::board::{CanStatus, SensedFrame};
use slipsense::net::{Aligned, Model};
use slipsense::pipeline::Pipeline;
use slipsense::tasks::{
    Controls, Inference, QUEUED_FRAMES, RAW_MESSAGES, RawQueue, Shared, Transmission, acquire,
};
use slipsense::wire::{RawTransfer, Transmitter};
use slipsense_can_sim::controller::{Bus, Timing};
use slipsense_qemu::INPUT_FILE;
use slipsense_qemu::events::{
    ARRIVED_FILE, BUS_FILE, Counters, DECIDED_FILE, DISTURBANCE_BYTES, INSTRUCTIONS_PER_US, START_US,
    STATUS_FILE, decode_disturbance,
};
use slipsense_qemu::input::{HEADER_BYTES, Header, MODEL_BYTES_MAX};
use static_cell::{ConstStaticCell, StaticCell};

use crate::board::{FrameBuffer, Frames, Hardware, Log, Sensors, Uptime};
use crate::semihosting::File;
use crate::time_driver::{ALARM_IRQ, COUNTER_IRQ, Irq, time};

/// A line that no device of the board drives: acquisition and transmission run in its handler.
const ACQUISITION_IRQ: Irq = Irq(31);
const TIME_PRIORITY: u8 = 0x20;
const ACQUISITION_PRIORITY: u8 = 0x60;
/// An instruction takes 2 ns of the emulator's clock, and the timers count every 40 ns of it: 20 instructions. So they
/// count 24 times while a core at 480 MHz does 480 instructions at one per cycle, which is what a microsecond is here.
const TIMER_TICKS_PER_US: u32 = (INSTRUCTIONS_PER_US / 20) as u32;
/// Idle instructions at a time.
const IDLE_CYCLES: u32 = 900;
/// After the last tick: time for what is under way.
const AFTERWARDS_MS: u64 = 50;

type Mutex = CriticalSectionRawMutex;
type EmulatedInference = Inference<'static, Mutex, Uptime, Frames>;
type EmulatedTransmission = Transmission<'static, Mutex, Hardware, Uptime>;

static ACQUISITION: InterruptExecutor = InterruptExecutor::new();
static EXECUTOR: StaticCell<Executor> = StaticCell::new();
static SHARED: Shared<Mutex> = Shared::new();
static BUFFERS: ConstStaticCell<[SensedFrame; QUEUED_FRAMES]> =
    ConstStaticCell::new([const { SensedFrame::new() }; QUEUED_FRAMES]);
static QUEUE: StaticCell<Channel<'static, Mutex, SensedFrame>> = StaticCell::new();
static RAW_BUFFERS: ConstStaticCell<[RawTransfer; RAW_MESSAGES]> =
    ConstStaticCell::new([const { RawTransfer::new() }; RAW_MESSAGES]);
static RAW_QUEUE: StaticCell<RawQueue<'static, Mutex>> = StaticCell::new();
static MODEL: ConstStaticCell<Aligned<[u8; MODEL_BYTES_MAX]>> =
    ConstStaticCell::new(Aligned([0; MODEL_BYTES_MAX]));
static SENSORS: StaticCell<Sensors> = StaticCell::new();
static INFERENCE: StaticCell<EmulatedInference> = StaticCell::new();
static TRANSMISSION: StaticCell<EmulatedTransmission> = StaticCell::new();

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
async fn acquisition(sensors: &'static mut Sensors, queue: Sender<'static, Mutex, SensedFrame>) {
    acquire(sensors, queue, &SHARED).await;
}

#[embassy_executor::task]
async fn transmission(transmission: &'static mut EmulatedTransmission, until: Instant) {
    embassy_futures::select::select(transmission.run(), Timer::at(until)).await;
    transmission.bus.log.flush();
    let counters = Counters::of(&SHARED.status(), transmission.waiting_raw());
    open(STATUS_FILE, File::create).write_all(&counters.encode()).expect("the host takes the output");
}

#[embassy_executor::task]
async fn inference(
    inference: &'static mut EmulatedInference,
    queue: Receiver<'static, Mutex, SensedFrame>,
    until: Instant,
) {
    embassy_futures::select::select(inference.run(queue), Timer::at(until)).await;
    inference.observer.log.flush();
    // The host closes the files when the emulator ends.
    debug::exit(debug::EXIT_SUCCESS);
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
    let mut file = open(INPUT_FILE, File::open);
    let mut header = [0; HEADER_BYTES];
    file.read_exact(&mut header).expect("the input file has a header");
    let header = Header::decode(&header).expect("the input file is one for this program");
    let (model, _) = MODEL.take().0.split_at_mut(header.model_bytes as usize);
    file.read_exact(model).expect("the input file holds a model");
    let model = Model::parse(model).expect("the model is valid");
    let pipeline = Pipeline::new(model, header.sensors as usize).expect("the header was checked");
    SHARED.control(Controls { compress_raw: header.compress_raw, ..Controls::DEFAULT });
    let mut disturbance = [0; DISTURBANCE_BYTES];
    open(BUS_FILE, File::open).read_exact(&mut disturbance).expect("a disturbance");
    let disturbance = decode_disturbance(&disturbance).expect("a disturbance");
    // Kernel clock of the boards' FDCAN, 1 and 8 Mbit/s.
    let timing = Timing::new(80_000_000, 1_000_000, 8_000_000).expect("whole quanta");

    let (sender, receiver) = QUEUE.init(Channel::new(BUFFERS.take())).split();
    let (raw_sender, raw_receiver) = RAW_QUEUE.init(RawQueue::new(RAW_BUFFERS.take())).split();
    let frames = Frames { log: Log::new(open(DECIDED_FILE, File::create)), queued_us: 0 };
    let transmitter = Transmitter::new(header.node);
    let infer = INFERENCE.init(Inference::new(pipeline, transmitter, Uptime, frames, &SHARED, raw_sender));
    let hardware = Hardware {
        bus: Bus::new(&timing, disturbance),
        log: Log::new(open(ARRIVED_FILE, File::create)),
        looked_ns: 0,
        seen: ([true; 3], CanStatus::default()),
    };
    let transmit = TRANSMISSION.init(Transmission::new(hardware, Uptime, &SHARED, raw_receiver));
    let last_tick_us = START_US + u64::from(header.frames) * 1_000_000 / 240;
    let sensors = SENSORS.init(Sensors { file, header, read: 0, record: FrameBuffer([0; FRAME_BYTES_MAX]) });

    time().init(TIMER_TICKS_PER_US);
    let mut core = cortex_m::Peripherals::take().expect("taken once");
    // SAFETY: all critical sections of this program mask every priority.
    unsafe {
        core.NVIC.set_priority(COUNTER_IRQ, TIME_PRIORITY);
        core.NVIC.set_priority(ALARM_IRQ, TIME_PRIORITY);
        core.NVIC.set_priority(ACQUISITION_IRQ, ACQUISITION_PRIORITY);
    }
    let transmit_until = Instant::from_micros(last_tick_us + 1000 * AFTERWARDS_MS);
    let infer_until = Instant::from_micros(last_tick_us + 2000 * AFTERWARDS_MS);
    let spawner = ACQUISITION.start(ACQUISITION_IRQ);
    spawner.spawn(transmission(transmit, transmit_until).expect("spawned once"));
    spawner.spawn(acquisition(sensors, sender).expect("spawned once"));
    EXECUTOR.init(Executor::new()).run(|spawner| {
        spawner.spawn(inference(infer, receiver, infer_until).expect("spawned once"));
        spawner.spawn(idle().expect("spawned once"));
    })
}

fn open(name: &str, how: fn(&core::ffi::CStr) -> Option<File>) -> File {
    let mut with_end = Vec::<u8, 32>::new();
    with_end.extend_from_slice(name.as_bytes()).expect("a short name");
    with_end.push(0).expect("a short name");
    let name = core::ffi::CStr::from_bytes_with_nul(&with_end).expect("no zero byte inside");
    how(name).unwrap_or_else(|| panic!("cannot open {name:?} in the emulator's working directory"))
}
