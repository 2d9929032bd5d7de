//! What the programs on the emulated board (QEMU's mps2-an500) share: files of the host, time, interrupts, the end.

pub mod semihosting;
mod time_driver;

use cortex_m_rt::exception;
use cortex_m_semihosting::debug;
use embassy_executor::{InterruptExecutor, SendSpawner};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::zerocopy_channel::{Channel, Receiver, Sender};
use panic_semihosting as _;
use slipsense::board::SensorFrame;
use slipsense::net::{Aligned, Model};
use slipsense::pipeline::Pipeline;
use slipsense::tasks::{QUEUED_FRAMES, RAW_MESSAGES, RawQueue, RuntimeConfig, Shared};
use slipsense::wire::RawTransfer;
use static_cell::{ConstStaticCell, StaticCell};

use crate::INPUT_FILE;
use crate::input::{HEADER_BYTES, Header, MODEL_BYTES_MAX};
use semihosting::File;
use time_driver::{ALARM_IRQ, COUNTER_IRQ, Irq, time};

/// A line that no device of the board drives: acquisition and transmission run in its handler.
const ACQUISITION_IRQ: Irq = Irq(31);
const TIME_PRIORITY: u8 = 0x20;
const ACQUISITION_PRIORITY: u8 = 0x60;

pub type Mutex = CriticalSectionRawMutex;
type Ends<T> = (Sender<'static, Mutex, T>, Receiver<'static, Mutex, T>);

pub static SHARED: Shared<Mutex> = Shared::new();
static ACQUISITION: InterruptExecutor = InterruptExecutor::new();
static MODEL: ConstStaticCell<Aligned<[u8; MODEL_BYTES_MAX]>> =
    ConstStaticCell::new(Aligned([0; MODEL_BYTES_MAX]));

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

pub fn read_input() -> (File, Header, Model<'static>) {
    let mut file = File::open(INPUT_FILE).expect("the input file is there");
    let mut header = [0; HEADER_BYTES];
    file.read_exact(&mut header).expect("the input file has a header");
    let header = Header::decode(&header).expect("the input file is one for this program");
    let (model, _) = MODEL.take().0.split_at_mut(header.model_bytes as usize);
    file.read_exact(model).expect("the input file holds a model");
    (file, header, Model::parse(model).expect("the model is valid"))
}

/// What inference decides with, as the header asks.
pub fn pipeline(header: &Header, model: Model<'static>) -> Pipeline<'static> {
    SHARED.set_config(RuntimeConfig { compress_raw: header.compress_raw, ..RuntimeConfig::DEFAULT });
    Pipeline::new(model, header.sensors as usize).expect("the header was checked")
}

/// The ends of the queues of frames and of raw messages. Once.
pub fn queues() -> (Ends<SensorFrame>, Ends<RawTransfer>) {
    static FRAMES: ConstStaticCell<[SensorFrame; QUEUED_FRAMES]> =
        ConstStaticCell::new([const { SensorFrame::new() }; QUEUED_FRAMES]);
    static QUEUE: StaticCell<Channel<'static, Mutex, SensorFrame>> = StaticCell::new();
    static RAW: ConstStaticCell<[RawTransfer; RAW_MESSAGES]> =
        ConstStaticCell::new([const { RawTransfer::new() }; RAW_MESSAGES]);
    static RAW_QUEUE: StaticCell<RawQueue<'static, Mutex>> = StaticCell::new();
    let (frames, raw) = (Channel::new(FRAMES.take()), RawQueue::new(RAW.take()));
    (QUEUE.init(frames).split(), RAW_QUEUE.init(raw).split())
}

/// Start the clock, whose timer has `ticks_per_us`, and the executor of acquisition and transmission, which
/// interrupts thread mode. Once.
pub fn start(ticks_per_us: u32) -> SendSpawner {
    time().init(ticks_per_us);
    let mut core = cortex_m::Peripherals::take().expect("taken once");
    // SAFETY: all critical sections of the programs mask every priority.
    unsafe {
        core.NVIC.set_priority(COUNTER_IRQ, TIME_PRIORITY);
        core.NVIC.set_priority(ALARM_IRQ, TIME_PRIORITY);
        core.NVIC.set_priority(ACQUISITION_IRQ, ACQUISITION_PRIORITY);
    }
    ACQUISITION.start(ACQUISITION_IRQ)
}

/// End the emulator, which closes the files.
pub fn exit(success: bool) -> ! {
    debug::exit(if success { debug::EXIT_SUCCESS } else { debug::EXIT_FAILURE });
    loop {
        cortex_m::asm::wfi();
    }
}
