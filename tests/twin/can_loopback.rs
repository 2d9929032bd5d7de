//! Frames to oneself through embassy-stm32's own driver, on both FDCANs of an STM32H743: what its example
//! `examples/stm32h7/src/bin/can.rs` does, written anew, in the two loop-back modes, with CAN FD frames too, and with
//! an end that says whether all came back. For the board twin: it shows that the driver and our model of the
//! peripheral understand one another.
#![no_std]
#![no_main]

use core::future::pending;
use core::panic::PanicInfo;

use cortex_m_rt::entry;
use defmt::{Display2Format, error, info, unwrap};
use defmt_rtt as _;
use embassy_executor::{Executor, task};
use embassy_stm32::can::frame::{FdFrame, Frame, Header};
use embassy_stm32::can::{Can, CanConfigurator, IT0InterruptHandler, IT1InterruptHandler, OperatingMode};
use embassy_stm32::peripherals::{FDCAN1, FDCAN2};
use embassy_stm32::rcc::mux::Fdcansel;
use embassy_stm32::rcc::{Hse, HseMode, LsConfig};
use embassy_stm32::time::Hertz;
use embassy_stm32::{Config, Peripherals, bind_interrupts};
use embassy_time::{Duration, Timer, with_timeout};
use embedded_can::ExtendedId;
use slipsense::firmware::memory;
use static_cell::StaticCell;

bind_interrupts!(struct Irqs {
    FDCAN1_IT0 => IT0InterruptHandler<FDCAN1>;
    FDCAN1_IT1 => IT1InterruptHandler<FDCAN1>;
    FDCAN2_IT0 => IT0InterruptHandler<FDCAN2>;
    FDCAN2_IT1 => IT1InterruptHandler<FDCAN2>;
});

/// The ST-LINK's clock on a NUCLEO, here also the FDCANs' kernel clock.
const HSE: Hertz = Hertz(8_000_000);
const BIT_RATE: u32 = 250_000;
const DATA_BIT_RATE: u32 = 1_000_000;
const ID: u32 = 0x0123_456F;
/// Of each kind in each mode.
const FRAMES: u8 = 4;
/// A frame of 64 bytes takes 1 ms.
const TIMEOUT: Duration = Duration::from_millis(10);
static EXECUTOR: StaticCell<Executor> = StaticCell::new();

/// One frame came back as it was sent. Their data distinguish the frames.
async fn classic(can: &mut Can<'_>, number: u8) -> bool {
    let sent = unwrap!(Frame::new_extended(ID, &[number; 8]).ok());
    can.write(&sent).await;
    let Ok(Ok(envelope)) = with_timeout(TIMEOUT, can.read()).await else { return false };
    let (frame, _) = envelope.parts();
    frame.id() == sent.id() && frame.data() == sent.data()
}

async fn fd(can: &mut Can<'_>, number: u8) -> bool {
    let mut data = [0; 64];
    (number..).zip(&mut data).for_each(|(value, byte)| *byte = value);
    let id = unwrap!(ExtendedId::new(ID));
    let sent = unwrap!(FdFrame::new(Header::new_fd(id.into(), 64, false, true), &data).ok());
    can.write_fd(&sent).await;
    let Ok(Ok(envelope)) = with_timeout(TIMEOUT, can.read_fd()).await else { return false };
    let (frame, _) = envelope.parts();
    frame.id() == sent.id() && frame.data() == sent.data()
}

/// Frames that came back, and the driver, which stops the peripheral's clock when it is dropped: classic ones whole, then with the driver split in its halves, then CAN FD ones.
async fn loop_back(
    name: &str,
    mut can: CanConfigurator<'static>,
    mode: OperatingMode,
) -> (u32, Can<'static>) {
    can.set_bitrate(BIT_RATE);
    can.set_fd_data_bitrate(DATA_BIT_RATE, false);
    let mut can = can.start(mode);
    let mut good = 0;
    for number in 0..FRAMES {
        good += u32::from(classic(&mut can, number).await);
        Timer::after_millis(1).await;
    }
    let (mut tx, mut rx, _) = can.split();
    for number in 0..FRAMES {
        let sent = unwrap!(Frame::new_extended(ID, &[0x80 | number; 8]).ok());
        tx.write(&sent).await;
        if let Ok(Ok(envelope)) = with_timeout(TIMEOUT, rx.read()).await {
            let (frame, _) = envelope.parts();
            good += u32::from(frame.data() == sent.data());
        }
    }
    let mut can = Can::join(tx, rx);
    for number in 0..FRAMES {
        good += u32::from(fd(&mut can, number).await);
    }
    info!("{} loop back: {} of {} frames came back", name, good, 3 * u32::from(FRAMES));
    (good, can)
}

#[task]
async fn run(chip: Peripherals) {
    let one = CanConfigurator::new(chip.FDCAN1, chip.PA11, chip.PA12, Irqs);
    let two = CanConfigurator::new(chip.FDCAN2, chip.PB12, chip.PB13, Irqs);
    let (internal, _one) = loop_back("internal", one, OperatingMode::InternalLoopbackMode).await;
    let (external, _two) = loop_back("external", two, OperatingMode::ExternalLoopbackMode).await;
    if internal + external == 6 * u32::from(FRAMES) {
        info!("loop back passed");
    } else {
        error!("loop back failed");
    }
    pending().await
}

#[entry]
fn main() -> ! {
    let mut config = Config::default();
    config.rcc.hse = Some(Hse { freq: HSE, mode: HseMode::Bypass });
    // No real-time clock.
    config.rcc.ls = LsConfig::off();
    config.rcc.mux.fdcansel = Fdcansel::HSE;
    memory::init(&mut unwrap!(cortex_m::Peripherals::take()));
    let chip = embassy_stm32::init(config);
    EXECUTOR.init(Executor::new()).run(|spawner| spawner.spawn(unwrap!(run(chip))))
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    error!("{}", Display2Format(info));
    loop {
        cortex_m::asm::bkpt();
    }
}
