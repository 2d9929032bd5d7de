//! The accelerometers: one SPI bus with a chip select each, bytes moved by DMA, FIFOs read just before each frame tick.
//! No interrupt line: a FIFO holds the samples of 1.5 ticks (ADXL382), 3 or 7, and its level says all.
//!
//! One after the other, they take of a frame, by the bytes of 33 or 67 samples at 8 MHz: 0.31 ms for each ADXL380,
//! 0.61 ms for each ADXL382, 0.27 ms for each ICM-42688-P.
//!
//! Which part it is, a cargo feature says: `adxl382`, `icm42688`, or none of them for the ADXL380.

use defmt::unwrap;
use embassy_embedded_hal::shared_bus::asynch::spi::SpiDevice;
use embassy_stm32::gpio::{AnyPin, Level, Output, Pull, Speed};
use embassy_stm32::mode::Async;
use embassy_stm32::spi::mode::Master;
use embassy_stm32::spi::{self, Spi};
use embassy_stm32::time::Hertz;
use embassy_stm32::{Peri, bind_interrupts, dma, peripherals};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::mutex::Mutex;
use slipsense::board::{Accelerometer, XlPart};
use slipsense::drivers::{SPI_BUFFER_BYTES, SpiBuffer};
use slipsense::params::MAX_SENSORS;
use static_cell::StaticCell;

#[cfg(all(feature = "adxl382", feature = "icm42688"))]
compile_error!(
    "all sensors of a board have the same accelerometer: adxl382, icm42688, or neither for the ADXL380"
);

bind_interrupts!(struct Irqs {
    DMA2_STREAM0 => dma::InterruptHandler<peripherals::DMA2_CH0>;
    DMA2_STREAM1 => dma::InterruptHandler<peripherals::DMA2_CH1>;
});

/// What an ADXL38x takes at most.
const SPI_HZ: Hertz = Hertz::mhz(8);

type Bus = Mutex<CriticalSectionRawMutex, Spi<'static, Async, Master>>;
type Device = SpiDevice<'static, CriticalSectionRawMutex, Spi<'static, Async, Master>, Output<'static>>;

#[cfg(feature = "adxl382")]
pub type Xl = slipsense::drivers::Adxl382<'static, Device>;
#[cfg(feature = "icm42688")]
pub type Xl = slipsense::drivers::Icm42688<'static, Device>;
#[cfg(not(any(feature = "adxl382", feature = "icm42688")))]
pub type Xl = slipsense::drivers::Adxl380<'static, Device>;
/// What is particular about it.
pub const PART: XlPart = <Xl as Accelerometer>::PART;

static BUS: StaticCell<Bus> = StaticCell::new();
/// One for each accelerometer: DMA does not reach the driver's own memory.
#[unsafe(link_section = ".sram_d2")]
static mut BUFFERS: [SpiBuffer; MAX_SENSORS] = [[0; SPI_BUFFER_BYTES]; MAX_SENSORS];

pub struct Hardware {
    pub spi: Peri<'static, peripherals::SPI1>,
    pub sck: Peri<'static, peripherals::PA5>,
    pub miso: Peri<'static, peripherals::PA6>,
    pub mosi: Peri<'static, peripherals::PB5>,
    pub tx_dma: Peri<'static, peripherals::DMA2_CH1>,
    pub rx_dma: Peri<'static, peripherals::DMA2_CH0>,
    /// Low selects.
    pub chip_selects: [Peri<'static, AnyPin>; MAX_SENSORS],
}

/// All that there is room for, in order; nothing is sent yet.
pub fn start(hardware: Hardware) -> [Xl; MAX_SENSORS] {
    let mut config = spi::Config::default();
    config.frequency = SPI_HZ;
    // A part that is not there reads ones.
    config.miso_pull = Pull::Up;
    let Hardware { spi, sck, miso, mosi, tx_dma, rx_dma, chip_selects } = hardware;
    let bus: &'static Bus =
        BUS.init(Mutex::new(Spi::new(spi, sck, mosi, miso, tx_dma, rx_dma, Irqs, config)));
    // SAFETY: nothing else uses them, and this runs once: it takes the only SPI1.
    let mut buffers = unsafe { &mut *(&raw mut BUFFERS) }.iter_mut();
    chip_selects.map(|pin| {
        let device = SpiDevice::new(bus, Output::new(pin, Level::High, Speed::High));
        Xl::new(device, unwrap!(buffers.next()))
    })
}
