//! The firmware.
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
//! decision by at most what the services do between two waits, and a frame delays an answer by at most one step of the
//! pipeline. What takes long, such as the check of a signature, begins only where the next frame has time.
//!
//! **Nothing of it has run on hardware.**
//!
//! | interrupt | priority | who |
//! |---|---|---|
//! | FDCAN1_IT0, FDCAN1_IT1, FLASH, TIM2 (time), DMA2_STREAM0, DMA2_STREAM1 (SPI1) | 0 | embassy's drivers |
//! | SysTick | 0 | which tasks stand still |
//! | DMA1_STREAM0 (a frame's conversions are complete) | 5 | scan |
//! | CEC (its peripheral is unused) | 6 | executor of acquisition, transmission and reception |
//! | thread mode | below all | executor of inference and services |
//!
//! Without a readable model the node does not stop: it reports the reason over defmt, lights the red LED
//! and goes on sending slip messages, flagged NO_MODEL. Without its external clock it stays off the bus, reports over
//! defmt, and lights the red LED until the clock is there.
#![no_std]
#![no_main]

mod accelerometers;
mod adc_scan;
mod can;
mod crash;
mod frame_source;
mod infer;
mod pins;
mod self_check;
mod services;
mod updates;
mod watchdog;

use cortex_m_rt::entry;
use defmt::{Display2Format, error, info, unwrap, warn};
use defmt_rtt as _;
use embassy_executor::Executor;
use embassy_stm32::can::{CanRx, OperatingMode};
use embassy_stm32::flash::{self, Flash};
use embassy_stm32::gpio::{Level, Output, Speed};
use embassy_stm32::interrupt::{InterruptExt, Priority};
use embassy_stm32::{bind_interrupts, interrupt};
use slipsense::firmware;
use slipsense::firmware::flash::{FlashPartitions, OptionBytes};
use slipsense::firmware::shared::{
    ACQUISITION, FrameReceiver, FrameSender, RawReceiver, SHARED, Uptime, frame_queue, raw_queue,
};
use slipsense::params::FRAME_RATE_HZ;
use slipsense::settings::Setting;
use slipsense::tasks::{self, RuntimeConfig, Transmission};
use slipsense::update::partitions::NUCLEO_H743ZI2;
use static_cell::StaticCell;

use can::CanBus;
use frame_source::BoardSensors;
use infer::Decider;
use pins::Hardware;
use services::BoardServices;
use updates::Updates;
use watchdog::Watchdog;

bind_interrupts!(struct Irqs {
    FLASH => flash::InterruptHandler;
});

static THREAD: StaticCell<Executor> = StaticCell::new();

/// # Safety
/// Called by the hardware only, and not before `run` has started the executor.
#[interrupt]
unsafe fn CEC() {
    // SAFETY: this is the interrupt that the executor was started with.
    unsafe { ACQUISITION.on_interrupt() }
}

#[entry]
fn main() -> ! {
    let chip = firmware::try_init().unwrap_or_else(|found_hz| {
        crash::no_clock(found_hz);
        firmware::wait_for_the_clock(found_hz)
    });
    run(pins::assign(chip))
}

/// Run the firmware on a chip whose memory and clocks are set up.
fn run(hardware: Hardware) -> ! {
    let Tasks { transmit: (can, raw), receive: can_rx, acquire: (source, sender), infer: parts, services } =
        make(hardware);
    let (decider, receiver, watchdog) = parts;
    // Below the drivers' interrupts, which default to the highest priority.
    interrupt::CEC.set_priority(Priority::P6);
    let spawner = ACQUISITION.start(interrupt::CEC);
    spawner.spawn(unwrap!(transmit(can, raw)));
    spawner.spawn(unwrap!(receive(can_rx)));
    spawner.spawn(unwrap!(acquire(source, sender)));
    THREAD.init(Executor::new()).run(|spawner| {
        spawner.spawn(unwrap!(infer(decider, receiver, watchdog)));
        spawner.spawn(unwrap!(serve(services)));
    })
}

struct Tasks {
    transmit: (CanBus, RawReceiver),
    receive: CanRx<'static>,
    acquire: (&'static mut BoardSensors, FrameSender),
    infer: (Decider, FrameReceiver, Watchdog),
    services: &'static mut BoardServices,
}

/// Apart from [`run`], which never ends: what this takes of the stack is given back.
#[inline(never)]
fn make(hardware: Hardware) -> Tasks {
    let start = crash::start();
    if let Some(record) = start.crash {
        error!("restarted after {}", Display2Format(&record));
    }
    SHARED.update_status(|status| status.starts = crash::count_start());
    option_bytes();
    let flash = FlashPartitions::new(Flash::new(hardware.flash, Irqs));
    let (mut store, settings, loaded) = services::load(flash);
    let sensors = settings.sensors();
    info!(
        "slipsense {=str}, {=str}, {=u32} Hz, {=usize} sensors with {=str}; {}",
        env!("CARGO_PKG_VERSION"),
        NUCLEO_H743ZI2.label,
        FRAME_RATE_HZ,
        sensors,
        accelerometers::PART.name,
        Display2Format(&loaded)
    );

    let (_, data_bit_rate) = settings.bit_rates();
    let mode = OperatingMode::NormalOperationMode;
    let (can, can_rx, inbox) =
        CanBus::start(hardware.fdcan, hardware.can_rx, hardware.can_tx, data_bit_rate, mode);
    let (raw_sender, raw_receiver) = raw_queue();
    SHARED.set_config(RuntimeConfig::new(&settings, settings.node_id(), settings.is_on(Setting::Lock)));
    let floor = services::model_floor(&mut store);
    let (model, from) = updates::find_model(flash, floor);
    let updates = Updates::find(flash, from, floor);
    let decider = Decider::new(model, raw_sender, sensors, updates.firmware());
    let model_hash = decider.model_hash();
    let led = Output::new(hardware.fault_led, Level::from(model_hash.is_none()), Speed::Low);

    let (sender, receiver) = frame_queue();
    let order = settings.sensor_order();
    let (source, commissioning) =
        frame_source::start(hardware.scan, hardware.accelerometers, sensors, order, &mut store);
    let services =
        services::build(store, commissioning, settings, loaded, updates, model_hash, inbox, led, start);
    // SAFETY: nobody else uses its SysTick.
    let mut core = unsafe { cortex_m::Peripherals::steal() };
    crash::watch(&mut core.SYST);
    let watchdog = Watchdog::start(hardware.watchdog);
    Tasks {
        transmit: (can, raw_receiver),
        receive: can_rx,
        acquire: (source, sender),
        infer: (decider, receiver, watchdog),
        services,
    }
}

/// What of the option bytes is not as the docs demand goes into the log, and all of it into a register.
fn option_bytes() {
    let found = OptionBytes::read();
    if !found.are_set() {
        warn!(
            "option bytes: brown-out level {=u8}, need {=u8}; bootloader write-protected: {=bool}",
            found.brown_out_level,
            OptionBytes::BROWN_OUT_LEVEL,
            found.boot_is_protected
        );
    }
    SHARED.update_status(|status| {
        status.option_bytes = [found.brown_out_level, found.boot_is_protected.into()];
    });
}

#[embassy_executor::task]
async fn acquire(source: &'static mut BoardSensors, queue: FrameSender) {
    tasks::acquire(source, queue, &SHARED).await;
}

#[embassy_executor::task]
async fn transmit(can: CanBus, raw: RawReceiver) {
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
async fn infer(mut decider: Decider, queue: FrameReceiver, watchdog: Watchdog) {
    decider.run(queue, watchdog).await;
}
