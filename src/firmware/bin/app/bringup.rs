//! For a new board on the desk: checks it part by part, prints a line for each over RTT, and sends the lines as
//! `uavcan.diagnostic.Record` where there is a bus. Nothing but the chip and its USB cable is needed.
//!
//! What is measured becomes a verdict in [`slipsense::bringup`]; pins, scan, accelerometers and bus are the firmware's.
//! No setting is read, nothing is written to flash, no watchdog runs. **It has not run on hardware**; it runs on the
//! emulated STM32H743.
#![no_std]
#![no_main]

mod accelerometers;
mod adc_scan;
mod can;
mod pins;

use core::panic::PanicInfo;

use cortex_m_rt::entry;
use defmt::{Display2Format, error, info, unwrap, warn};
use defmt_rtt as _;
use embassy_executor::Executor;
use embassy_futures::select::{Either, select};
use embassy_stm32::can::OperatingMode;
use embassy_stm32::gpio::{Level, Output, Speed};
use embassy_stm32::pac;
use embassy_stm32::pac::gpio::vals::{Moder, Pupdr};
use embassy_stm32::rcc::LsConfig;
use embassy_time::{Duration, Instant, Timer, with_timeout};
use slipsense::board::{Accelerometer, CanReceive, CanTransmit, FifoSamples, TaxelScan, TxSlot, XlFault};
use slipsense::bringup::{
    ArrayStats, Finding, Grade, Settling, Summary, Verdict, XlReadings, judge_array, judge_clock,
    judge_lines, judge_settling, judge_xl,
};
use slipsense::drivers::scan::ADDRESS_LINES;
use slipsense::firmware::{clock_check, clocks, memory};
use slipsense::node::{RECORD_BYTES, RECORD_PORT, Severity, encode_record};
use slipsense::params::{MAX_SENSORS, TAXELS};
use slipsense::wire::{CanFrame, Frames, MessageId, NodeId, Priority};
use static_cell::{ConstStaticCell, StaticCell};

use accelerometers::{PART, Xl};
use adc_scan::{AdcScan, TIMING};
use can::CanBus;
use pins::Hardware;

/// Of the bus where nothing is set yet.
const DATA_BIT_RATE: u32 = 8_000_000;
/// Longest wait for a frame to go or to come.
const FRAME_TIMEOUT: Duration = Duration::from_millis(5);
/// For a level to get through a transceiver, and shorter than the 0.8 ms after which one lets go of a dominant bus.
const ECHO_US: u64 = 20;
/// For an address pin against its pull of some 40 kΩ.
const PIN_US: u64 = 20;
/// Reads of the FIFOs, one a frame period.
const XL_READS: usize = 40;
const XL_READ_MS: u64 = 4;
/// Frames for mean and noise of each taxel, and at each trigger of the settling curve.
const FRAMES: usize = 32;
const CURVE_FRAMES: usize = 4;
/// Between the triggers of the settling curve: two of the front end's time constants.
const CURVE_TICKS: u32 = TIMING.trigger_ticks / 8;
/// Until the lines are sent again, for who comes later to the bus.
const REPEAT: Duration = Duration::from_secs(5);
const FIRST_LINE: usize = 2;

static EXECUTOR: StaticCell<Executor> = StaticCell::new();
#[unsafe(link_section = ".axisram")]
static STATS: ConstStaticCell<[ArrayStats; MAX_SENSORS]> =
    ConstStaticCell::new([const { ArrayStats::new() }; MAX_SENSORS]);

type Verdicts = heapless::Vec<Verdict, 32>;

fn tell(verdicts: &mut Verdicts, check: &'static str, sensor: Option<usize>, finding: Finding) {
    let verdict = Verdict { check, sensor, finding };
    match finding.grade() {
        Grade::Ok => info!("{}", Display2Format(&verdict)),
        Grade::Open => warn!("{}", Display2Format(&verdict)),
        Grade::Failed => error!("{}", Display2Format(&verdict)),
    }
    // There are fewer checks.
    let _ = verdicts.push(verdict);
}

#[entry]
fn main() -> ! {
    let mut core = unwrap!(cortex_m::Peripherals::take());
    memory::init(&mut core);
    let hse_hz = clock_check::measure_hse(&mut core);
    let clock = judge_clock(hse_hz, clocks::HSE_HZ);
    let mut verdicts = Verdicts::new();
    if !clock_check::is_near(hse_hz) {
        // On the HSI, for the log's time and the LED: without the right clock the PLLs do not lock.
        let mut config = embassy_stm32::Config::default();
        config.rcc.ls = LsConfig::off();
        let chip = embassy_stm32::init(config);
        tell(&mut verdicts, "clock", None, clock);
        error!("{}", Display2Format(&Summary(&verdicts)));
        core::mem::forget(Output::new(chip.PB14, Level::High, Speed::Low));
        loop {
            cortex_m::asm::wfi();
        }
    }
    let chip = embassy_stm32::init(clocks::config());
    info!("slipsense bring-up, {=str}", PART.name);
    tell(&mut verdicts, "clock", None, clock);
    let hardware = pins::assign(chip);
    EXECUTOR.init(Executor::new()).run(|spawner| spawner.spawn(unwrap!(run(hardware, verdicts))))
}

#[embassy_executor::task]
async fn run(hardware: Hardware, mut verdicts: Verdicts) {
    let Hardware { fault_led, fdcan, can_rx, can_tx, flash, watchdog, scan, accelerometers: xl } = hardware;
    drop((flash, watchdog));
    let mut led = Output::new(fault_led, Level::Low, Speed::Low);
    let lines = address_lines().await;
    tell(&mut verdicts, "address pins", None, lines);

    // SAFETY: the instance that these copies make is gone before the next one is made.
    let (again, rx, tx) =
        unsafe { (fdcan.clone_unchecked(), can_rx.clone_unchecked(), can_tx.clone_unchecked()) };
    let inside = CanBus::start(again, rx, tx, DATA_BIT_RATE, OperatingMode::InternalLoopbackMode);
    let inside = hears_itself(inside).await;
    tell(&mut verdicts, "CAN inside", None, inside);
    let outside = transceiver().await;
    tell(&mut verdicts, "CAN transceiver", None, outside);
    // Without a transceiver no bit comes back: the node would be off the bus again and again.
    let mut bus = (outside == Finding::Transceiver)
        .then(|| CanBus::start(fdcan, can_rx, can_tx, DATA_BIT_RATE, OperatingMode::NormalOperationMode).0);

    let mut parts = accelerometers::start(xl);
    let (samples, elapsed_us) = read_accelerometers(&mut parts).await;
    let stats = STATS.take();
    let mut scan = AdcScan::start(scan, MAX_SENSORS);
    gather(&mut scan, stats, FRAMES).await;
    let arrays = [0, 1, 2].map(|sensor| judge_array(&stats[sensor]));
    let settled = settle(&mut scan, stats).await;
    let answer = |sensor: usize| !matches!(samples[sensor], Err(XlFault::WrongPart { .. } | XlFault::Bus(_)));
    let answers = (0..MAX_SENSORS).any(answer);
    let fitted = |sensor: usize| sensor == 0 || arrays[sensor] != Finding::ArrayUnplugged || answer(sensor);
    for sensor in 0..MAX_SENSORS {
        if fitted(sensor) {
            let finding = judge_xl(samples[sensor], PART, elapsed_us, answers);
            tell(&mut verdicts, "accelerometer", Some(sensor), finding);
            // What is left of the taxel before reads like pressure on the next one.
            if lines == Finding::LinesFree && !matches!(settled[sensor], Finding::NotSettled { .. }) {
                tell(&mut verdicts, "array", Some(sensor), arrays[sensor]);
            }
        } else {
            tell(&mut verdicts, "connector", Some(sensor), Finding::NotFitted);
        }
    }
    // Wrong lines would be found here once more, with other reasons.
    let delivers = |sensor: &usize| match arrays[*sensor] {
        Finding::ArrayUnplugged | Finding::ArrayShorted | Finding::ArrayFixed { .. } => false,
        _ => lines == Finding::LinesFree,
    };
    for sensor in (0..MAX_SENSORS).filter(delivers) {
        tell(&mut verdicts, "settling", Some(sensor), settled[sensor]);
    }
    if let Some(bus) = &mut bus {
        let mut transfer = 0;
        let acknowledged = send(bus, &mut transfer, Severity::Info, format_args!("slipsense bring-up")).await;
        let finding = if acknowledged { Finding::Acknowledged } else { Finding::NotAcknowledged };
        tell(&mut verdicts, "CAN outside", None, finding);
    }
    let summary = Summary(&verdicts);
    let good = summary.count(Grade::Failed) == 0;
    led.set_level(Level::from(!good));
    if good {
        info!("{}", Display2Format(&summary));
    } else {
        error!("{}", Display2Format(&summary));
    }
    let Some(mut bus) = bus else { return };
    let mut transfer = 1;
    loop {
        for verdict in &verdicts {
            let severity = match verdict.finding.grade() {
                Grade::Ok => Severity::Info,
                Grade::Open => Severity::Warning,
                Grade::Failed => Severity::Error,
            };
            send(&mut bus, &mut transfer, severity, format_args!("{verdict}")).await;
        }
        send(&mut bus, &mut transfer, Severity::Notice, format_args!("{summary}")).await;
        Timer::after(REPEAT).await;
    }
}

/// A line onto the bus. `false`: not all of it went in time; what waits is taken back.
async fn send(
    bus: &mut CanBus,
    transfer: &mut u8,
    severity: Severity,
    text: core::fmt::Arguments<'_>,
) -> bool {
    let mut record = [0; RECORD_BYTES];
    let length = encode_record(0, severity, text, &mut record);
    let id = MessageId { priority: Priority::Optional, port: RECORD_PORT, node: NodeId::DEFAULT };
    *transfer = transfer.wrapping_add(1);
    for frame in Frames::new(id, *transfer, record.get(..length).unwrap_or_default()) {
        bus.transmit(TxSlot::Service, &frame);
        if !gone(bus).await {
            bus.withdraw(TxSlot::Service);
            return false;
        }
    }
    true
}

async fn gone(bus: &mut CanBus) -> bool {
    let free = async {
        while !bus.is_free(TxSlot::Service) {
            bus.changed().await;
        }
    };
    with_timeout(FRAME_TIMEOUT, free).await.is_ok()
}

/// Each address pin alone drives, the others are pulled down; afterwards all are inputs without a pull.
async fn address_lines() -> Finding {
    const LINES: usize = ADDRESS_LINES as usize;
    let port = pac::GPIOE;
    let pins = FIRST_LINE..FIRST_LINE + LINES;
    let all = |mode: Moder, pull: Pupdr| {
        port.moder().modify(|w| pins.clone().for_each(|pin| w.set_moder(pin, mode)));
        port.pupdr().modify(|w| pins.clone().for_each(|pin| w.set_pupdr(pin, pull)));
    };
    let read = || (port.idr().read().0 >> FIRST_LINE) as u16 & ((1 << LINES) - 1);
    all(Moder::INPUT, Pupdr::PULL_DOWN);
    Timer::after_micros(PIN_US).await;
    let idle = read();
    let mut driven = [0; LINES];
    for (line, driven) in driven.iter_mut().enumerate() {
        let pin = FIRST_LINE + line;
        port.bsrr().write(|w| w.set_bs(pin, true));
        port.moder().modify(|w| w.set_moder(pin, Moder::OUTPUT));
        Timer::after_micros(PIN_US).await;
        *driven = read();
        port.moder().modify(|w| w.set_moder(pin, Moder::INPUT));
        port.bsrr().write(|w| w.set_br(pin, true));
        Timer::after_micros(PIN_US).await;
    }
    all(Moder::INPUT, Pupdr::FLOATING);
    judge_lines(idle, &driven)
}

/// A frame to itself, TX recessive and RX not read.
async fn hears_itself(bus: (CanBus, embassy_stm32::can::CanRx<'static>, can::Inbox)) -> Finding {
    let (mut bus, rx, mut inbox) = bus;
    inbox.accept_only(&[(0, 0)]);
    let Ok(frame) = CanFrame::new(1, &[0xA5; 64]) else { return Finding::CanInsideSilent };
    bus.transmit(TxSlot::Service, &frame);
    let until = Instant::now() + FRAME_TIMEOUT;
    let heard = match select(can::receive(rx), inbox.receive(until.as_micros())).await {
        Either::Second(Some((heard, _))) => heard.id() == frame.id() && heard.data() == frame.data(),
        _ => false,
    };
    // Off the bus before the driver's end takes its clock.
    pac::FDCAN1.cccr().modify(|w| w.set_init(true));
    if heard { Finding::CanInside } else { Finding::CanInsideSilent }
}

/// Does RX follow TX? The controller lets software set the one and read the other (RM0433, FDCAN_TEST). Its own
/// external loop back reads no pin.
async fn transceiver() -> Finding {
    const RECESSIVE: u8 = 0b11;
    const DOMINANT: u8 = 0b10;
    // Clock and pins are on from here to the end.
    let can = pac::FDCAN1;
    pac::RCC.apb1henr().modify(|w| w.set_fdcanen(true));
    can.cccr().modify(|w| w.set_init(true));
    can.cccr().modify(|w| w.set_cce(true));
    can.cccr().modify(|w| w.set_test(true));
    let mut levels = [false; 3];
    for (level, tx) in levels.iter_mut().zip([RECESSIVE, DOMINANT, RECESSIVE]) {
        can.test().write(|w| w.set_tx(tx));
        Timer::after_micros(ECHO_US).await;
        *level = can.test().read().rx();
    }
    can.test().write(|w| w.set_tx(0));
    can.cccr().modify(|w| w.set_test(false));
    match levels {
        [true, false, true] => Finding::Transceiver,
        [_, true, _] => Finding::NoTransceiver,
        _ => Finding::BusDominant,
    }
}

/// What each accelerometer gave, and over how many microseconds.
async fn read_accelerometers(
    parts: &mut [Xl; MAX_SENSORS],
) -> ([Result<XlReadings, XlFault>; MAX_SENSORS], u64) {
    let mut readings = [Ok(XlReadings::default()); MAX_SENSORS];
    for (part, reading) in parts.iter_mut().zip(&mut readings) {
        *reading = part.reset().await.map(|()| XlReadings::default());
    }
    Timer::after_millis(XL_READ_MS * u64::from(PART.reset_ticks)).await;
    for (part, reading) in parts.iter_mut().zip(&mut readings).filter(|(_, reading)| reading.is_ok()) {
        if let Err(fault) = part.configure().await {
            *reading = Err(fault);
        }
    }
    let mut samples = FifoSamples::new();
    let settling = PART.settling_ticks as usize;
    let mut from = Instant::now();
    let mut until = from;
    for read in 0..settling + XL_READS {
        Timer::after_millis(XL_READ_MS).await;
        until = Instant::now();
        for (part, reading) in parts.iter_mut().zip(&mut readings) {
            let Ok(sums) = reading else { continue };
            match part.drain(&mut samples).await {
                Ok(_) if read >= settling => sums.add(&samples),
                Ok(_) => {}
                Err(fault) => *reading = Err(fault),
            }
        }
        if read + 1 == settling {
            from = until;
        }
    }
    (readings, (until - from).as_micros())
}

/// So many whole frames of every array.
async fn gather(scan: &mut AdcScan, stats: &mut [ArrayStats; MAX_SENSORS], frames: usize) {
    stats.iter_mut().for_each(ArrayStats::clear);
    // Frames that are lost do not count; a scan that stands gives none, and ends all the same.
    let (mut taken, mut ticks) = (0, 0);
    while taken < frames && ticks < 2 * frames {
        ticks += 1;
        scan.tick().await;
        let Some(codes) = scan.codes().filter(|codes| codes.len() == TAXELS * MAX_SENSORS) else { continue };
        for (index, stats) in stats.iter_mut().enumerate() {
            stats.add(codes, index, MAX_SENSORS);
        }
        taken += 1;
    }
}

/// One transition of each array, the largest, with the trigger earlier and earlier.
async fn settle(scan: &mut AdcScan, stats: &mut [ArrayStats; MAX_SENSORS]) -> [Finding; MAX_SENSORS] {
    let steps = [0, 1, 2].map(|sensor| stats[sensor].largest_step());
    let mut curves = steps.map(|(_, step_codes)| Settling { codes: [0; 3], step_codes });
    let noise = [0, 1, 2].map(|sensor| stats[sensor].noise(steps[sensor].0));
    for point in 0..3 {
        scan.trigger_at(TIMING.trigger_ticks - (2 - point) as u32 * CURVE_TICKS);
        gather(scan, stats, CURVE_FRAMES).await;
        for (sensor, curve) in curves.iter_mut().enumerate() {
            curve.codes[point] = stats[sensor].mean(steps[sensor].0);
        }
    }
    [0, 1, 2].map(|sensor| judge_settling(curves[sensor], noise[sensor]))
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    error!("{}", Display2Format(info));
    loop {
        cortex_m::asm::bkpt();
    }
}
